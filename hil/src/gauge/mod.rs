//! The gauge: what each stage costs in instructions, and when an answer is on the bus, on a clock that no other load can shift.
//!
//! The real-time kernel runs in an emulator that counts: one instruction is one nanosecond of its clock. The module's own
//! threads, camera and bus are driven there from a tape; the network's answers are recorded, for its own arithmetic would
//! take the emulator an hour. Caches and parallel cores do not exist there: it is a gauge for regressions, no proof of wall time.

mod limits;
mod play;
mod recorded;
mod tape;

use std::path::PathBuf;

use clap::Args;
use serde::{Deserialize, Serialize};

use crate::DeviceArgs;
use crate::bench::BenchError;

pub(crate) use limits::{CheckArgs, check};

/// What is recorded, and where.
#[derive(Args)]
pub(crate) struct RecordArgs {
    #[command(flatten)]
    devices: DeviceArgs,
    /// The tape.
    #[arg(long, value_name = "FILE")]
    tape: PathBuf,
    /// Length of the drive.
    #[arg(long, default_value_t = 8.0)]
    seconds: f64,
    /// Pictures a second: the emulated processor is slower than a real one. No key frame is due when a picture is, or a
    /// microsecond would decide which picture becomes one.
    #[arg(long, default_value_t = 9.7)]
    rate: f64,
}

/// What is played.
#[derive(Args)]
pub(crate) struct PlayArgs {
    #[command(flatten)]
    devices: DeviceArgs,
    /// The tape.
    #[arg(long, value_name = "FILE")]
    tape: PathBuf,
    /// Where the figures go.
    #[arg(long, value_name = "FILE")]
    figures: PathBuf,
}

/// What a play measured; times in microseconds of the counted clock.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Figures {
    /// Median of each stage, thousands of instructions; those of *frame* and *track* over all frames together.
    pub(crate) stages: Vec<(String, f64)>,
    /// From capture until the timing frame is read from the bus.
    pub(crate) capture_to_can_p50: f64,
    pub(crate) capture_to_can_p99: f64,
    pub(crate) capture_to_can_max: f64,
    pub(crate) key_frames: usize,
    pub(crate) misses: u64,
    /// The network's answers were recorded, and cost nothing.
    pub(crate) network_is_recorded: bool,
}

/// Records the tape; whether it could.
pub(crate) fn record(args: &RecordArgs) -> bool {
    told(tape::record(
        &args.devices.rig("gauge"),
        &args.tape,
        args.seconds,
        args.rate,
    ))
}

/// Plays the tape to the module; whether it could.
pub(crate) fn play(args: &PlayArgs) -> bool {
    let figures = play::play(&args.devices.rig("gauge"), &args.tape);
    told(figures.and_then(|figures| {
        let text = serde_json::to_string_pretty(&figures).unwrap_or_default();
        Ok(std::fs::write(&args.figures, text)?)
    }))
}

fn told(result: Result<(), BenchError>) -> bool {
    if let Err(error) = &result {
        eprintln!("gauge: {error}");
    }
    result.is_ok()
}
