//! A recording to be surveyed: its frames and wheels, opened anew for each round.

use std::io::IsTerminal as _;
use std::path::Path;

use freespace::frame::Camera;
use freespace::pipeline::Cadence;
use freespace::port::WheelPort;
use freespace::space::Mount;

use crate::bad_input::BadInput;
use crate::calibrate::mount::open_minded;
use crate::calibrate::survey::{Survey, survey};
use crate::camera::replay::{KeyFrameRule, KeyFrameSchedule, ReplayCamera, ReplayFrames};
use crate::cli::Failure;
use crate::cli::drive::pipeline_config;
use crate::config::{CanWheels, Config, Wheels};
use crate::wheels::{CandumpOptions, CandumpWheels, WheelDecoder};

/// Reads the wheels' log as the configuration describes it.
///
/// # Errors
/// A configuration without a CAN message, or a log without it.
pub(super) fn open_wheels(config: &Config, log: &Path) -> Result<(CandumpWheels, Box<CanWheels>), Failure> {
    let Wheels::Can(wheels) = config.wheels() else {
        let message = format!("{} describes no CAN message", config.path.display());
        return Err(BadInput::new(
            message,
            "set source = \"can\", dbc, message and signals in [wheels]",
        )
        .into());
    };
    let decoder = WheelDecoder::open(&wheels.dbc, &wheels.mapping()).map_err(Failure::bad_input)?;
    let options = CandumpOptions {
        interface: None,
        offset_micros: wheels.offset_micros(),
    };
    let readings = CandumpWheels::open(log, &decoder, &options).map_err(Failure::bad_input)?;
    Ok((readings, wheels))
}

/// Surveys a recording; with wheels the scale is theirs, else that of the mount's height.
///
/// # Errors
/// Frames that are missing or do not fit the configuration.
pub(super) fn survey_under(
    config: &Config,
    source: &Path,
    wheels: Option<&(CandumpWheels, Box<CanWheels>)>,
    mount: &Mount,
    round: Option<usize>,
) -> Result<Survey, Failure> {
    let rate_hz = config.camera.frame_rate_hz;
    let frames = ReplayCamera::open(source, rate_hz, config.camera.size())?;
    let camera = Camera {
        mount: *mount,
        ..config.camera_for(source, frames.size().width, frames.size().height)?
    };
    let schedule = KeyFrameSchedule::new(
        &KeyFrameRule::Interval,
        config.key_frames.interval_s,
        rate_hz,
        &frames,
    )?;
    let odometer = wheels.map(|(_, can)| can.odometer);
    let mut pipeline = pipeline_config(config, camera, odometer, Cadence::OnDemand);
    if let Some(round) = round {
        pipeline.priors.plane = open_minded(&pipeline.priors.plane, round);
    }
    let port = wheels.map(|(readings, _)| -> Box<dyn WheelPort + Send> { Box::new(readings.clone()) });
    let (count, is_shown) = (frames.len(), std::io::stderr().is_terminal());
    let title = round.map_or_else(String::new, |round| format!("round {}: ", round + 1));
    let survey = survey(
        pipeline,
        Box::new(ReplayFrames::new(frames, schedule)),
        port,
        &mut |frame| {
            if is_shown && frame % 10 == 0 {
                eprint!("\r{title}frame {frame} of {count} ");
            }
        },
    );
    if is_shown {
        eprint!("\r{:60}\r", "");
    }
    Ok(survey)
}
