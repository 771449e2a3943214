//! What `freespace replay` reads and checks before it writes anything.

use freespace::frame::Camera;

use super::{Failure, ReplayArgs};
use crate::bad_input::BadInput;
use crate::camera::replay::{KeyFrameRule, KeyFrameSchedule, ReplayCamera};
use crate::config::{Config, Wheels};
use crate::eval::reference::Reference;

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
    let config = Config::load(&args.config)?;
    if let Some(log) = &args.can
        && !matches!(config.wheels(), Wheels::Can(_))
    {
        return Err(BadInput::new(
            format!("--can {} is given, but {} describes no CAN message", log.display(), args.config.display()),
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
