//! The guest's side: the module's own camera, bus and threads, fed from the tape, with the network's answers recorded.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use freespace::deadline::Slices;
use freespace::pipeline::Cadence;
use freespace::stage::Stage;
use freespace_platform::camera::v4l2::V4l2Camera;
use freespace_platform::can::{self, CanPlan};
use freespace_platform::clock::MonotonicClock;
use freespace_platform::runtime::{FrameReport, KeyFrameReport, Observer, run_live};
use freespace_platform::segmenter::Manifest;
use freespace_platform::statistics::Publication;

use super::Figures;
use super::recorded::RecordedNetwork;
use super::tape::Tape;
use crate::bench::{BenchError, Rig};
use crate::direct::setup;
use crate::feed::Feed;
use crate::listener::{Frame, Listener, TIMING, capture};

/// Key frames that are left out: the map begins, and buffers are touched for the first time.
const WARM: usize = 4;

/// The drive, its key frames and its deadline in slow motion: an emulated instruction takes a nanosecond, and a car's processor
/// does several in one. In time, nothing would be cut short that is not on a car; what is cut short hides what it costs.
const SLOWER: u32 = 4;

/// Plays the tape to its end.
pub(super) fn play(rig: &Rig, tape: &Path) -> Result<Figures, BenchError> {
    let tape = Tape::load(tape)?;
    let seconds = tape.seconds() * f64::from(SLOWER);
    let (config, ..) = rig.config()?;
    let words = |error: &dyn std::error::Error| BenchError::Config(error.to_string());
    let manifest = Manifest::load(&config.network.manifest).map_err(|error| words(&error))?;
    let network = RecordedNetwork::new(manifest.shape(), Arc::clone(&tape.answers));
    let device =
        (config.camera.device.as_ref()).ok_or_else(|| BenchError::Config("no [camera.device]".to_owned()))?;
    let size = (config.camera.size()).ok_or_else(|| BenchError::Config("no size in [camera]".to_owned()))?;
    let listener = Listener::start(&rig.interface)?;
    let rate_hz = tape.rate_hz() / f64::from(SLOWER);
    let mut show = tape.show();
    show.rate_hz = rate_hz;
    show.wheel_period_micros *= u64::from(SLOWER);
    let feed = Feed::start(show, &rig.device, &rig.interface)?;
    let camera = V4l2Camera::open(device, size, rate_hz).map_err(|error| words(&error))?;
    let plan = CanPlan::of(&config).map_err(|error| words(&error))?;
    let plan = plan.ok_or_else(|| BenchError::Config("no interface in [can]".to_owned()))?;
    let bus = can::open(plan).map_err(|error| words(&error))?;
    let mut setup = setup(
        rig,
        Box::new(camera),
        bus.wheels
            .map(|port| -> Box<dyn freespace::port::WheelPort + Send> { port }),
        Box::new(network),
    )?;
    setup.devices.sinks.extend(
        bus.sink
            .map(|port| -> Box<dyn freespace::port::SinkPort + Send> { port }),
    );
    setup.clock = MonotonicClock::of_devices();
    setup.config.slices = Slices::within(setup.config.slices.deadline_micros * u64::from(SLOWER));
    if let Cadence::Micros(interval) = &mut setup.config.cadence {
        *interval *= u64::from(SLOWER);
    }
    let stop = Arc::new(AtomicBool::new(false));
    let alarm = Arc::clone(&stop);
    std::thread::spawn(move || {
        std::thread::sleep(Duration::from_secs_f64(seconds));
        alarm.store(true, Ordering::Relaxed);
    });
    let mut meter = Meter::default();
    let summary = run_live(setup, &stop, &mut meter).map_err(|error| words(&error))?;
    drop(feed);
    Ok(meter.figures(&listener.frames(), summary.deadline_misses))
}

/// Collects times.
#[derive(Default)]
struct Meter {
    stages: BTreeMap<&'static str, Vec<f64>>,
    key_frames: usize,
}

impl Observer for Meter {
    fn frame(&mut self, report: &FrameReport) {
        self.note("frame and track", report.outcome.micros);
    }

    fn key_frame(&mut self, _: &KeyFrameReport<'_>) {}

    fn publication(&mut self, publication: &Publication) {
        self.key_frames += 1;
        if self.key_frames <= WARM {
            return;
        }
        for stage in Stage::ALL {
            if !matches!(stage, Stage::Frame | Stage::Track) {
                self.note(stage.name(), publication.times.of(stage));
            }
        }
    }
}

impl Meter {
    #[expect(clippy::cast_precision_loss, reason = "microseconds of a stage")]
    fn note(&mut self, name: &'static str, micros: u64) {
        self.stages.entry(name).or_default().push(micros as f64);
    }

    fn figures(&mut self, frames: &[Frame], misses: u64) -> Figures {
        let mut latencies = latencies(frames);
        let stages = self
            .stages
            .iter_mut()
            .map(|(name, times)| ((*name).to_owned(), quantile(times, 0.5)));
        Figures {
            stages: stages.collect(),
            capture_to_can_p50: quantile(&mut latencies, 0.5),
            capture_to_can_p99: quantile(&mut latencies, 0.99),
            capture_to_can_max: quantile(&mut latencies, 1.0),
            key_frames: self.key_frames,
            misses,
            network_is_recorded: true,
        }
    }
}

/// From the capture stamp in the head of each grid to the timing frame before it, microseconds.
#[expect(clippy::cast_precision_loss, reason = "microseconds of a deadline")]
fn latencies(frames: &[Frame]) -> Vec<f64> {
    let mut told = None;
    let mut latencies = Vec::new();
    for frame in frames {
        if frame.id == TIMING {
            told = Some(frame.at_micros);
        } else if let Some(capture) = capture(frame)
            && let Some(told) = told.take()
        {
            latencies.push(told.saturating_sub(capture) as f64);
        }
    }
    latencies.split_off(WARM.min(latencies.len()))
}

#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a few samples"
)]
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    // What was never measured keeps no limit.
    values.get(rank.max(1) - 1).copied().unwrap_or(f64::NAN)
}
