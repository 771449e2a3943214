//! Why a camera cannot be used as it is configured, and what mends it.

use std::path::PathBuf;

use rustix::io::Errno;

use super::StampClock;
use crate::bad_input::BadInput;

/// What no waiting heals. A camera that is merely not there, busy or failing is waited for, and is no error.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// The program cannot open cameras: build it with the feature `v4l2`.
    #[error("{}: this program was built without the feature v4l2", device.display())]
    NotBuilt {
        /// The configured device.
        device: PathBuf,
    },
    /// The user may not open it: grant the right.
    #[error("{}: may not be opened ({errno})", device.display())]
    NotAllowed {
        /// The configured device.
        device: PathBuf,
        /// What the kernel answered.
        errno: Errno,
    },
    /// Something else stands at that path: correct the path.
    #[error("{}: {what}", device.display())]
    NotACamera {
        /// The configured device.
        device: PathBuf,
        /// What is there.
        what: &'static str,
    },
    /// Size, rate or format do not fit: ask for what the camera offers.
    #[error("{}: does not give {asked}: {answers}; it offers {offers}", device.display())]
    NoFormat {
        /// The configured device.
        device: PathBuf,
        /// Size and rate.
        asked: String,
        /// What each configured format came to.
        answers: String,
        /// Formats and sizes of the device.
        offers: String,
    },
    /// A control is unknown, or its value is not possible: correct it.
    #[error("{}: control {name}: {problem}", device.display())]
    Control {
        /// The configured device.
        device: PathBuf,
        /// The control in the config.
        name: String,
        /// What is wrong with it.
        problem: String,
        /// What mends it.
        fix: String,
    },
    /// Stamps are not of the clock of the vehicle's other devices: no distance would be right.
    #[error("{}: frames are stamped {clock}, not by CLOCK_MONOTONIC at capture", device.display())]
    Stamps {
        /// The configured device.
        device: PathBuf,
        /// What they are stamped by.
        clock: StampClock,
    },
}

impl OpenError {
    /// What mends it.
    #[must_use]
    pub fn fix(&self) -> String {
        match self {
            Self::NotBuilt { .. } => {
                "build with the default features; libclang must be there (Debian: libclang-dev)".to_owned()
            }
            Self::NotAllowed { .. } => {
                "add the user to the group `video`, or let the unit or container have the device".to_owned()
            }
            Self::NotACamera { .. } => {
                "set path of [camera.device] to a node that `v4l2-ctl --list-devices` shows; a camera may have \
                 several, the first of them gives pictures"
                    .to_owned()
            }
            Self::NoFormat { .. } => {
                "set width, height and frame_rate_hz of [camera] (and the lens with them), or formats of \
                 [camera.device], to what it offers: `v4l2-ctl --list-formats-ext` shows all"
                    .to_owned()
            }
            Self::Control { fix, .. } => fix.clone(),
            Self::Stamps { .. } => {
                "for a USB camera: echo CLOCK_MONOTONIC > /sys/module/uvcvideo/parameters/clock; for a loopback: \
                 let its writer leave the stamps to the driver; else another driver"
                    .to_owned()
            }
        }
    }

    /// The same without its texts.
    #[must_use]
    pub const fn kind(&self) -> Refusal {
        match self {
            Self::NotBuilt { .. } => Refusal::NotBuilt,
            Self::NotAllowed { .. } => Refusal::NotAllowed,
            Self::NotACamera { .. } => Refusal::NotACamera,
            Self::NoFormat { .. } => Refusal::NoFormat,
            Self::Control { .. } => Refusal::Control,
            Self::Stamps { .. } => Refusal::Stamps,
        }
    }
}

impl From<OpenError> for BadInput {
    fn from(error: OpenError) -> Self {
        Self::new(error.to_string(), error.fix())
    }
}

/// Why a camera that came back was not taken; [`OpenError`] without its texts, for a thread that may not write them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The program cannot open cameras.
    #[error("this program was built without the feature v4l2")]
    NotBuilt,
    /// The user may not open it.
    #[error("it may not be opened")]
    NotAllowed,
    /// Something else stands at its path.
    #[error("what stands at its path is no camera")]
    NotACamera,
    /// It gives another size, rate or format.
    #[error("it does not give the configured size, rate and format")]
    NoFormat,
    /// It lacks a control, or a value of it.
    #[error("a configured control is not possible")]
    Control,
    /// Its stamps are of no use.
    #[error("its frames are not stamped by CLOCK_MONOTONIC")]
    Stamps,
}

/// Why there is no connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Trouble {
    /// It may heal by itself: wait.
    Away(Errno),
    /// It does not.
    Wrong(OpenError),
}

impl From<Errno> for Trouble {
    fn from(errno: Errno) -> Self {
        Self::Away(errno)
    }
}
