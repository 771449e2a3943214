//! What can be said on the command line.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};

use freespace::space::Micros;
use freespace::stage::Stage;

use super::{CalibrateCommand, DrivesArgs, MergeArgs, MonitorArgs};
use crate::camera::replay::KeyFrameRule;
use crate::eval::masks::TruthKind;
use crate::runtime::SlowStage;

/// Where the road ahead is free, in metres and on time, from one camera and the wheel encoders.
#[derive(Debug, Parser)]
#[command(
    name = "freespace",
    version,
    after_help = "\
Examples:
  freespace demo
  freespace run --config car.toml
  freespace replay drive --config config/kitti.toml --can drive/wheel.candump --out out/drive
  freespace eval trajectory out/drive/trajectory.kitti drive/poses.txt

Exit codes: 0 done, 1 internal failure or a check of doctor that fails, 2 bad input."
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Drive on this computer's camera and CAN bus until SIGTERM or Ctrl-C.
    Run(RunArgs),
    /// Drive a simulated road through the full pipeline.
    Demo(DemoArgs),
    /// Run recorded frames, and a CAN log, through the full pipeline.
    Replay(ReplayArgs),
    /// Watch a module of this computer: terminal view, web page, metrics.
    Monitor(MonitorArgs),
    /// Compare results with truth.
    #[command(subcommand)]
    Eval(EvalCommand),
    /// Look at a CAN bus: frames decoded, and the module's load.
    #[command(subcommand)]
    Can(CanCommand),
    /// Find what a configuration must be told of lens, mount and wheels.
    #[command(subcommand)]
    Calibrate(CalibrateCommand),
    /// Check this computer: rights, kernel, memory, devices, network, timer; each with its fix.
    Doctor(DoctorArgs),
}

/// What to do about CAN.
#[derive(Debug, Subcommand)]
pub enum CanCommand {
    /// Print the signals of a log's or an interface's frames, and whether the module's own are whole.
    Decode(CanDecodeArgs),
    /// Print what the module's publications, and a log, cost the bus.
    Load(CanLoadArgs),
}

/// Arguments of `freespace can decode`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace can decode drive.candump --config config/toyota.toml
  freespace can decode can0 --json | jq 'select(.message == \"FREESPACE_STATUS\")'")]
pub struct CanDecodeArgs {
    /// A candump log, or an interface.
    #[arg(value_name = "FILE|INTERFACE")]
    pub source: String,
    /// DBC file that describes the frames; the shipped config/freespace.dbc without it.
    #[arg(long, value_name = "FILE")]
    pub dbc: Option<PathBuf>,
    /// Configuration whose `wheels` table describes the wheel message; its readings are printed too.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print frames that nothing describes, too.
    #[arg(long)]
    pub all: bool,
    /// How long to read an interface; until interrupted without it.
    #[arg(long, value_name = "N", value_parser = seconds, allow_negative_numbers = true)]
    pub seconds: Option<f64>,
    /// Print JSON, an object a line.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace can load`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  freespace can load --config config/kitti.toml --log drive.candump")]
pub struct CanLoadArgs {
    /// Configuration; the shipped config/demo.toml without it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// A candump log whose load is told too.
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// The interface of the log to take, where it holds several.
    #[arg(long, value_name = "NAME", requires = "log")]
    pub interface: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace run`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace run --config /etc/freespace/car.toml
  freespace run --config car.toml --seconds 60 --record out/drive
  freespace run --config car.toml --mcap /data/drives --split-s 60

A camera or bus that is not there yet is waited for, and every message says so.")]
pub struct RunArgs {
    /// Vehicle, camera and bus; config/car.toml shows all of it.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Ends after so many seconds; without it the drive goes on.
    #[arg(long, value_name = "N", value_parser = seconds, allow_negative_numbers = true)]
    pub seconds: Option<f64>,
    /// Folder for pictures, grids and report; new, empty, or of an earlier run, which is replaced.
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,
    /// Recording of the drive in MCAP.
    #[command(flatten)]
    pub mcap: McapArgs,
    /// Print the report as JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace doctor`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace doctor
  freespace doctor --config config/kitti.toml --jitter-seconds 60
  freespace doctor --json | jq '.checks[] | select(.state != \"ok\")'

Exit codes: 0 nothing fails (there may be warnings), 1 a check fails, 2 bad input.")]
pub struct DoctorArgs {
    /// Configuration whose memory, network and threads are checked; the shipped config/demo.toml without it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Length of the timer test in seconds; 0 leaves it out.
    #[arg(long, default_value_t = 10.0, value_name = "N", value_parser = test_seconds, allow_negative_numbers = true)]
    pub jitter_seconds: f64,
    /// Print JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace demo`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace demo
  freespace demo --seconds 60 --seed 7 --out out/demo7
  freespace demo --mcap out/demo.mcap
  freespace demo --seed 3 --pace fast --out out/demo3
  freespace demo --slow crf=450@10                      # watch it: freespace monitor")]
pub struct DemoArgs {
    /// Length of the drive in seconds.
    #[arg(long, default_value_t = 30.0, value_name = "N", value_parser = seconds, allow_negative_numbers = true)]
    pub seconds: f64,
    /// Seed of the road and everything on it.
    #[arg(long, default_value_t = 1, value_name = "S")]
    pub seed: u64,
    /// Folder for pictures, grids and report; new, empty, or of an earlier run, which is replaced.
    #[arg(long, default_value = "out/demo", value_name = "DIR")]
    pub out: PathBuf,
    /// Configuration; the shipped config/demo.toml without it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Frames at the pace of their stamps, or as fast as they are worked off (same seed, same bytes out).
    #[arg(long, value_enum, default_value_t = Pace::Real)]
    pub pace: Pace,
    /// Recording of the drive in MCAP.
    #[command(flatten)]
    pub mcap: McapArgs,
    /// Make a stage slow for three seconds, to see how a miss is told: its name, how much longer it takes in milliseconds, and
    /// the second of the drive from which on.
    #[arg(long, value_name = "STAGE=MS@S", value_parser = slow_stage)]
    pub slow: Option<SlowStage>,
    /// Print the report as JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace replay`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace replay drive --config config/kitti.toml --can drive/wheel.candump --out out/drive
  freespace replay clip --config config/camvid.toml --out out/clip --pace fast --truth-masks clip_truth --truth camvid
  freespace replay drive --config config/kitti.toml --out out/2d --ablate 2d --key-frames labelled.txt
  freespace replay drive.mcap --timing recorded --out out/again")]
pub struct ReplayArgs {
    /// KITTI odometry folder (image_0/ or images/, times.txt, calib.txt), a folder of PNG or JPEG files, or a drive recorded
    /// with --mcap (its first file, or the folder that holds drive.mcap).
    pub source: PathBuf,
    /// Vehicle and camera; config/kitti.toml without it, of a recorded drive the configuration that it was recorded with.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// candump log with the wheel message that the configuration describes.
    #[arg(long, value_name = "LOG")]
    pub can: Option<PathBuf>,
    /// Folder for the results; new, empty, or of an earlier run, which is replaced.
    #[arg(long, value_name = "DIR", default_value = "out/replay")]
    pub out: PathBuf,
    /// Frames at the pace of their stamps, or as fast as they are worked off (same input, same bytes out) [default: real].
    #[arg(long, value_enum)]
    pub pace: Option<Pace>,
    /// Whose time decides what it is too late for: nobody's, or that of the recorded drive, which degraded where it did; as fast
    /// as it goes then.
    #[arg(long, value_enum, default_value_t = Timing::Own)]
    pub timing: Timing,
    /// Every Nth frame, or a file of frame names that are key frames besides those of the configured interval.
    #[arg(long, value_name = "every=N|FILE")]
    pub key_frames: Option<KeyFrameRule>,
    /// Leave terms out of the energy: `2d` keeps the image alone, `3d` the geometry alone.
    #[arg(long, value_enum)]
    pub ablate: Option<Ablation>,
    /// Truth to compare with.
    #[command(flatten)]
    pub truth: TruthArgs,
    /// Recording of the drive in MCAP.
    #[command(flatten)]
    pub mcap: McapArgs,
    /// Print the report as JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

impl ReplayArgs {
    /// The pace of the replay.
    #[must_use]
    pub fn pace(&self) -> Pace {
        match self.timing {
            Timing::Recorded => Pace::Fast,
            Timing::Own => self.pace.unwrap_or(Pace::Real),
        }
    }
}

/// Truth for the report of a replay.
#[derive(Clone, Debug, Default, Args)]
pub struct TruthArgs {
    /// True poses in KITTI's format; SOURCE/poses.txt without it, where that exists.
    #[arg(long, value_name = "FILE")]
    pub truth_poses: Option<PathBuf>,
    /// Folder of true masks, NAME.png; SOURCE/labels without it, where that exists.
    #[arg(long, value_name = "DIR")]
    pub truth_masks: Option<PathBuf>,
    /// What the values of the true masks mean: camvid, kitti or world.
    #[arg(long, value_name = "KIND", default_value = "kitti")]
    pub truth: TruthKind,
}

/// Pace of a demo or a replay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Pace {
    /// That of the stamps.
    Real,
    /// As fast as it goes.
    Fast,
}

/// Whose time decides in a replay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Timing {
    /// That of this run, at its pace.
    Own,
    /// That of the recorded drive.
    Recorded,
}

/// Where a drive is recorded in MCAP.
#[derive(Clone, Debug, Default, Args)]
pub struct McapArgs {
    /// Record every frame, wheel reading and answer in MCAP: a file that ends in .mcap, or a folder. For a replay, and for
    /// Foxglove's viewer; 28 MB a second at 640x480 in colour.
    #[arg(long, value_name = "FILE|DIR")]
    pub mcap: Option<PathBuf>,
    /// Begin a new file after so many megabytes.
    #[arg(long, value_name = "N", requires = "mcap", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub split_mb: Option<u64>,
    /// Begin a new file after so many seconds.
    #[arg(long, value_name = "N", requires = "mcap", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub split_s: Option<u64>,
}

/// What an ablation keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Ablation {
    /// The network and colour lines alone.
    #[value(name = "2d")]
    Only2d,
    /// Plane and boxes alone.
    #[value(name = "3d")]
    Only3d,
}

/// What to compare.
#[derive(Debug, Subcommand)]
pub enum EvalCommand {
    /// Road masks: precision, recall and F, pooled over all pixels.
    #[command(
        after_help = "Example:\n  freespace eval masks out/drive/masks drive/labels --truth kitti --html masks.html"
    )]
    Masks {
        /// Folder of masks, NAME.png, 0 not road.
        predictions: PathBuf,
        /// Folder of truth, NAME.png.
        truth_dir: PathBuf,
        /// What the truth's values mean: camvid (3 road, 11 void), kitti (0, 1, 255 ignored) or world.
        #[arg(long, value_name = "KIND", default_value = "kitti")]
        truth: TruthKind,
        /// Print each frame too.
        #[arg(long)]
        frames: bool,
        /// Write a page with pictures, which stands alone.
        #[arg(long, value_name = "FILE")]
        html: Option<PathBuf>,
        /// Print JSON with the keys of report.json.
        #[arg(long)]
        json: bool,
    },
    /// Trajectory: position error after SE(3) and Sim(3) alignment, scale, KITTI's segment errors.
    #[command(after_help = "\
Examples:
  freespace eval trajectory out/drive/trajectory.kitti drive/poses.txt
  freespace eval trajectory out/drive/trajectory.tum drive/poses.txt --times drive/times.txt")]
    Trajectory {
        /// Estimate, KITTI or TUM format.
        estimate: PathBuf,
        /// Truth, KITTI or TUM format.
        truth: PathBuf,
        /// Times of the truth's rows, one a line in seconds; pairs them with a TUM estimate.
        #[arg(long, value_name = "FILE")]
        times: Option<PathBuf>,
        /// Write a page with pictures, which stands alone.
        #[arg(long, value_name = "FILE")]
        html: Option<PathBuf>,
        /// Print JSON with the keys of report.json.
        #[arg(long)]
        json: bool,
    },
    /// Wheels: what a CAN log's wheel message says of the drive.
    #[command(after_help = "Example:\n  freespace eval wheels drive.candump --config config/toyota.toml")]
    Wheels {
        /// candump log.
        log: PathBuf,
        /// Configuration whose `wheels` table describes the message.
        #[arg(long, value_name = "FILE")]
        config: PathBuf,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Grids: intersection over union of free cells that the truth has seen.
    #[command(after_help = "Example:\n  freespace eval grid out/demo/grids truth/grids")]
    Grid {
        /// Folder of grids, NAME.npy with NAME.json.
        predictions: PathBuf,
        /// Folder of true grids.
        truth_dir: PathBuf,
        /// Farthest row compared, metres ahead of the vehicle origin.
        #[arg(long, value_name = "METRES", default_value_t = 30.0)]
        range: f64,
        /// Write a page with pictures, which stands alone.
        #[arg(long, value_name = "FILE")]
        html: Option<PathBuf>,
        /// Print JSON with the keys of report.json.
        #[arg(long)]
        json: bool,
    },
    /// Drives of many cars, or one shard of them: deadlines, quality, latency, and truth where it is there.
    Drives(DrivesArgs),
    /// Join the parts of all shards: one table, exact totals.
    Merge(MergeArgs),
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if (1.0..=3600.0).contains(&value) => Ok(value),
        _ => Err("give a number of seconds from 1 to 3600".to_owned()),
    }
}

/// How long a stage is slow.
const SLOW_S: u64 = 3;

fn slow_stage(text: &str) -> Result<SlowStage, String> {
    let parse = || {
        let (name, rest) = text.split_once('=')?;
        let (millis, second) = rest.split_once('@')?;
        let stage = SlowStage::STAGES.into_iter().find(|stage| stage.name() == name)?;
        let millis = millis.parse().ok().filter(|millis| (1..=1000).contains(millis))?;
        let second: u64 = second.parse().ok().filter(|second| *second <= 3600)?;
        Some(SlowStage {
            stage,
            more: Duration::from_millis(millis),
            from: Micros(second * 1_000_000),
            until: Micros((second + SLOW_S) * 1_000_000),
        })
    };
    parse().ok_or_else(|| {
        let names = SlowStage::STAGES.map(Stage::name).join(", ");
        format!("give a stage ({names}), 1 to 1000 ms and a second of the drive, such as crf=450@10")
    })
}

fn test_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if (0.0..=3600.0).contains(&value) => Ok(value),
        _ => Err("give a number of seconds from 0 to 3600".to_owned()),
    }
}
