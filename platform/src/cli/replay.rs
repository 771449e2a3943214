//! `freespace replay`: a recording through the pipeline. Everything is read and checked before anything is written.

use std::collections::BTreeMap;
use std::path::PathBuf;

use freespace::crf;
use freespace::frame::Camera;
use freespace::pipeline::Cadence;
use freespace::port::WheelPort;
use freespace::track::WheelConfig;

use super::drive::{self, DriveLog, Ports, Progress, Recorded, Recorder, ViewFeed, Watch};
use super::{Ablation, Failure, Pace, ReplayArgs, Timing, replay_drive, table};
use crate::bad_input::BadInput;
use crate::camera::replay::drive::is_drive;
use crate::camera::replay::{KeyFrameRule, KeyFrameSchedule, ReplayCamera, ReplayFrames};
use crate::config::{Config, Wheels};
use crate::eval::reference::Reference;
use crate::runtime::RunSummary;
use crate::sink::recording::{Recording, Report, RunTitle, ScoreOf};
use crate::wheels::{CandumpOptions, CandumpWheels, WheelDecoder};

/// The checked inputs of a replay; network and CAN log are checked by their own readers.
#[derive(Debug)]
pub struct ReplayInputs {
    /// Configuration.
    pub config: Config,
    /// Frames.
    pub frames: ReplayCamera,
    /// Lens, size and mount.
    pub camera: Camera,
    /// Which frames are key frames.
    pub key_frames: KeyFrameSchedule,
    /// Truth to compare with.
    pub reference: Reference,
}

/// Opens and checks configuration, frames, lens, key-frame list and truth.
///
/// # Errors
/// The first of them that is missing or malformed; nothing has been written then.
pub fn open_inputs(args: &ReplayArgs) -> Result<ReplayInputs, Failure> {
    let path = config_path(args);
    let config = Config::load(&path)?;
    if let Some(log) = &args.can
        && !matches!(config.wheels(), Wheels::Can(_))
    {
        return Err(BadInput::new(
            format!("--can {} is given, but {} describes no CAN message", log.display(), path.display()),
            "add [wheels] with `source = \"can\"`, dbc, message and signals to the configuration, or leave --can out",
        )
        .into());
    }
    let rate_hz = config.camera.frame_rate_hz;
    let frames = ReplayCamera::open(&args.source, rate_hz, config.camera.size())?;
    let camera = config.camera_for(&args.source, frames.size().width, frames.size().height)?;
    let rule = args.key_frames.clone().unwrap_or(KeyFrameRule::Interval);
    let key_frames = KeyFrameSchedule::new(&rule, config.key_frames.interval_s, rate_hz, &frames)?;
    let reference = Reference::open(
        &args.source,
        args.truth.truth_poses.as_deref(),
        args.truth.truth_masks.as_deref(),
        args.truth.truth,
        frames.size(),
    )?;
    Ok(ReplayInputs {
        config,
        frames,
        camera,
        key_frames,
        reference,
    })
}

/// The configuration of a replayed folder.
fn config_path(args: &ReplayArgs) -> PathBuf {
    args.config
        .clone()
        .unwrap_or_else(|| PathBuf::from("config/kitti.toml"))
}

/// Wheel readings and what the odometer must know of them.
type WheelInputs = (Box<dyn WheelPort + Send>, WheelConfig);

/// Reads the CAN log; none where none is given.
fn open_wheels(args: &ReplayArgs, config: &Config) -> Result<Option<WheelInputs>, Failure> {
    let (Some(log), Wheels::Can(wheels)) = (&args.can, config.wheels()) else {
        return Ok(None);
    };
    let decoder = WheelDecoder::open(&wheels.dbc, &wheels.mapping()).map_err(Failure::bad_input)?;
    let options = CandumpOptions {
        interface: None,
        offset_micros: wheels.offset_micros(),
    };
    let readings = CandumpWheels::open(log, &decoder, &options).map_err(Failure::bad_input)?;
    Ok(Some((Box::new(readings), wheels.odometer)))
}

/// What is left out of the energy.
pub(super) fn ablation(args: &ReplayArgs) -> crf::Ablation {
    match args.ablate {
        None => crf::Ablation::Joint,
        Some(Ablation::Only2d) => crf::Ablation::TwoD,
        Some(Ablation::Only3d) => crf::Ablation::ThreeD,
    }
}

/// Replays a recording.
///
/// # Errors
/// Bad input, before anything is written; or a folder that cannot be written to.
pub fn run(args: &ReplayArgs) -> Result<(), Failure> {
    drive::check_apart(&args.source, &args.out)?;
    if is_drive(&args.source) {
        return replay_drive::run(args);
    }
    if args.timing == Timing::Recorded {
        return Err(BadInput::new(
            format!(
                "--timing recorded is given, but {} is no recorded drive",
                args.source.display()
            ),
            "replay a file that was recorded with --mcap, or leave --timing out",
        )
        .into());
    }
    let ReplayInputs {
        mut config,
        frames,
        camera,
        key_frames,
        reference,
    } = open_inputs(args)?;
    let (wheels, odometer) = open_wheels(args, &config)?.unzip();
    let mut network = drive::open_network(&config)?;
    config.crf.ablation = ablation(args);
    let pipeline = drive::pipeline_config(&config, camera, odometer, Cadence::OnDemand);
    let title = RunTitle {
        title: format!("freespace replay {}", args.source.display()),
        deadline_ms: config.deadline.publish_ms,
        is_reproducible: args.pace() == Pace::Fast,
        ..RunTitle::default()
    };
    let recording = Recording::create(&args.out, title)?;
    let sinks = drive::sinks(&config, args.pace(), &mut network)?;
    let engine = network.segmenter.name().to_owned();
    let names: BTreeMap<u64, String> = frames
        .listing()
        .map(|(index, name, _)| (index as u64, name.to_owned()))
        .collect();
    let mut watch = Watch::new(Progress::new(Some(frames.len())), drive::statistics(args.pace()));
    let mut log = DriveLog::open(
        &args.mcap,
        args.pace(),
        &config,
        &pipeline,
        &mut network.plan,
        &mut watch,
    )?;
    watch.show((network.plan).measure_library("view", || ViewFeed::open(&config, &pipeline, args.pace())));
    let mut recorder = Recorder::new(recording, &pipeline, names, watch);
    let ports = Ports {
        camera: Box::new(ReplayFrames::new(frames, key_frames)),
        wheels,
        sinks,
    };
    let setup = network.into_setup(&config, pipeline, ports, &mut log);
    let summary = drive::run(setup, args.pace(), &mut log.noted(&mut recorder))?;
    log.finish();
    let report = conclude(recorder, &summary, &reference)?;
    table::print(&report, &engine, Some(&args.out), args.json);
    Ok(())
}

/// Compares what was recorded with the truth, and writes the report.
pub(super) fn conclude(
    recorder: Recorder,
    summary: &RunSummary,
    reference: &Reference,
) -> Result<Report, Failure> {
    let Recorded {
        mut recording,
        counts,
        statistics,
    } = recorder.finish(summary)?;
    let poses = recording.poses()?.into_iter().enumerate();
    let judged = reference.compare(poses, &recording.mask_folder())?;
    recording.know_path(reference.poses());
    for (name, iou) in &judged.road_iou {
        recording.score(name, ScoreOf::Road, *iou)?;
    }
    Ok(recording.finish(&counts, &statistics, judged.truth)?)
}
