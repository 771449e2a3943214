//! `freespace replay DRIVE.mcap`: a recorded drive through the full pipeline.
//!
//! Frames, wheel readings, camera and cadence are the drive's; so is the configuration, unless another one is given.

use std::collections::BTreeMap;
use std::path::Path;

use freespace::port::{CameraPort, WheelPort};
use freespace::track::WheelConfig;

use super::drive::{self, DriveLog, Ports, Progress, Recorder, Watch};
use super::{Failure, Pace, ReplayArgs, Timing, replay, table};
use crate::bad_input::BadInput;
use crate::camera::replay::KeyFrameRule;
use crate::camera::replay::drive::{DriveFrames, RecordedDrive};
use crate::config::{Config, Wheels};
use crate::eval::reference::Reference;
use crate::runtime;
use crate::sink::mcap::{Losses, later_part_of};
use crate::sink::recording::{Recording, Report, RunTitle};
use crate::statistics::DriveStatistics;
use crate::wheels::RecordedWheels;

/// Replays a recorded drive, and prints what it came to.
///
/// # Errors
/// As [`replay`].
pub(super) fn run(args: &ReplayArgs) -> Result<(), Failure> {
    let replayed = replay(args)?;
    table::print(&replayed.report, &replayed.engine, Some(&args.out), args.json);
    Ok(())
}

/// A recorded drive, and what its replay came to.
pub(super) struct Replayed {
    pub(super) drive: RecordedDrive,
    pub(super) report: Report,
    /// SHA-256 of the network's model.
    pub(super) network_sha256: String,
    /// Who ran the network.
    engine: String,
}

/// Replays a recorded drive.
///
/// # Errors
/// Bad input, before anything is written; or a folder that cannot be written to.
pub(super) fn replay(args: &ReplayArgs) -> Result<Replayed, Failure> {
    refuse_what_is_the_drives(args)?;
    let recorded = RecordedDrive::open(&args.source)?;
    tell_what_it_is_not(&args.source, &recorded);
    if args.timing == Timing::Recorded {
        recorded.check_notes()?;
    }
    let mut config = match &args.config {
        Some(path) => Config::load(path)?,
        None => Config::parse(&recorded.drive().config_path, &recorded.config_text)?,
    };
    let camera = match &args.config {
        Some(path) => config.camera_for(path, recorded.camera().width, recorded.camera().height)?,
        None => *recorded.camera(),
    };
    let reference = Reference::open(
        &args.source,
        args.truth.truth_poses.as_deref(),
        args.truth.truth_masks.as_deref(),
        args.truth.truth,
        crate::config::ImageSize {
            width: camera.width,
            height: camera.height,
        },
    )?;
    let mut network = drive::open_network(&config)?;
    config.crf.ablation = replay::ablation(args);
    let odometer = odometer(&config).filter(|_| recorded.drive().has_wheels);
    let pipeline = drive::pipeline_config(&config, camera, odometer, recorded.drive().cadence());
    let title = RunTitle {
        title: format!("freespace replay {}", args.source.display()),
        deadline_ms: config.deadline.publish_ms,
        is_reproducible: args.pace() == Pace::Fast,
        is_source_cut: !recorded.cut.is_empty(),
        has_recorded_times: args.timing == Timing::Recorded,
    };
    let recording = Recording::create(&args.out, title)?;
    let network_sha256 = network.sha256.clone();
    let engine = network.segmenter.name().to_owned();
    let statistics = match args.timing {
        Timing::Own => drive::statistics(args.pace()),
        // The drive's own times are told again.
        Timing::Recorded => DriveStatistics::new(),
    };
    let mut watch = Watch::new(Progress::new(Some(recorded.frames.len())), statistics);
    let mut log = DriveLog::open(
        &args.mcap,
        args.pace(),
        &config,
        &pipeline,
        &mut network.plan,
        &mut watch,
    )?;
    let mut recorder = Recorder::new(recording, &pipeline, BTreeMap::new(), watch);
    let ports = Ports {
        camera: frames(args, &recorded),
        wheels: odometer
            .map(|_| -> Box<dyn WheelPort + Send> { Box::new(RecordedWheels::new(recorded.wheels.clone())) }),
        sinks: Vec::new(),
    };
    let setup = network.into_setup(&config, pipeline, ports, &mut log);
    let summary = match args.timing {
        Timing::Recorded => runtime::run_recorded(setup, recorded.times(), &mut recorder),
        Timing::Own => drive::run(setup, args.pace(), &mut log.noted(&mut recorder))?,
    };
    log.finish();
    let report = replay::conclude(recorder, &summary, &reference)?;
    Ok(Replayed {
        drive: recorded,
        report,
        network_sha256,
        engine,
    })
}

/// Says where the recording is not all of its drive.
fn tell_what_it_is_not(source: &Path, recorded: &RecordedDrive) {
    if let Some((part, whole)) = later_part_of(source) {
        eprintln!(
            "{}: is part {part} of a drive, and replayed alone; give {} to replay all of it",
            source.display(),
            whole.display()
        );
    }
    for part in &recorded.cut {
        eprintln!(
            "{}: is cut off, and read up to its last whole chunk ({})",
            part.path.display(),
            part.cause
        );
    }
    match recorded.losses {
        Some(losses) if losses == Losses::default() => {}
        Some(losses) => eprintln!(
            "{}: while it was recorded {losses}: this is not all of the drive",
            source.display()
        ),
        None => eprintln!(
            "{}: does not say whether all of the drive was recorded",
            source.display()
        ),
    }
}

fn refuse_what_is_the_drives(args: &ReplayArgs) -> Result<(), BadInput> {
    if args.timing == Timing::Recorded && args.mcap.mcap.is_some() {
        return Err(BadInput::new(
            "--mcap is given with --timing recorded: a recording keeps the pace of the drive, and this replay has none",
            "leave --timing out, or --mcap",
        ));
    }
    if args.timing == Timing::Recorded && args.pace == Some(Pace::Real) {
        return Err(BadInput::new(
            "--pace real is given with --timing recorded: the times are the drive's, and nothing is waited for",
            "leave --pace out, or --timing",
        ));
    }
    let given = match (&args.can, &args.key_frames) {
        (Some(_), _) => "--can",
        (None, Some(KeyFrameRule::Every(_) | KeyFrameRule::Listed(_))) => "--key-frames",
        (None, Some(KeyFrameRule::Interval) | None) => return Ok(()),
    };
    Err(BadInput::new(
        format!(
            "{given} is given, but {} is a recorded drive",
            args.source.display()
        ),
        format!("leave {given} out: wheel readings and key frames are those of the drive"),
    ))
}

fn odometer(config: &Config) -> Option<WheelConfig> {
    match config.wheels() {
        Wheels::Can(wheels) => Some(wheels.odometer),
        Wheels::Sim(odometer) => Some(odometer),
        Wheels::None => None,
    }
}

fn frames(args: &ReplayArgs, recorded: &RecordedDrive) -> Box<dyn CameraPort + Send> {
    Box::new(match args.timing {
        Timing::Recorded => DriveFrames::as_driven(recorded),
        Timing::Own => DriveFrames::all(recorded),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
    use clap::Parser as _;

    use super::*;
    use crate::cli::{Cli, Command};

    #[test]
    fn the_flag_that_does_not_fit_is_named() {
        let refused = |more: &[&str]| {
            let line = [&["freespace", "replay", "drive.mcap"], more].concat();
            let Command::Replay(args) = Cli::try_parse_from(line).unwrap().command else {
                panic!("no replay");
            };
            refuse_what_is_the_drives(&args)
                .err()
                .map(|error| error.to_string())
        };
        let fault = refused(&["--timing", "recorded", "--mcap", "again.mcap"]).unwrap();
        assert!(
            fault.contains("--mcap is given with --timing recorded"),
            "{fault}"
        );
        assert!(!fault.contains("--pace"), "{fault}");
        let fault = refused(&["--timing", "recorded", "--pace", "real"]).unwrap();
        assert!(fault.contains("--pace real is given"), "{fault}");
        assert_eq!(refused(&["--timing", "recorded", "--pace", "fast"]), None);
        assert_eq!(refused(&["--timing", "recorded"]), None);
        assert_eq!(refused(&["--mcap", "again.mcap"]), None);
    }
}
