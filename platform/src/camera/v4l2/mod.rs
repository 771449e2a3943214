//! Cameras of the Linux kernel, by V4L2.
//!
//! In: `[camera.device]` of the config, with the size and rate of `[camera]`. Out: frames stamped at capture by `CLOCK_MONOTONIC`, the
//! newest of those that wait, in a format that the core reads; `Silent` while the camera is away. Invariant: once opened the camera
//! never ends and never panics: what was pulled out is looked for until it is back, and stamps and indices go on rising. Cost:
//! one wait of at most 100 ms a call, one copy of the pixels; no allocation, but for what decodes MJPEG. Frames that come faster
//! than they are fetched are overtaken by newer ones, and counted.
//!
//! What no waiting heals (no camera, no right, no such format or control, stamps of another clock) is an error when the program
//! starts. A camera that is merely not there is none: a service may start before its camera.
//!
//! Below: `node` (what is asked of the kernel, as traits) ← `kernel`; `request` → `negotiate`, `controls` → `session` (one
//! connection) → `reconnect` (the port); `pixels`, `jpeg`, `stamps`; `status` (counters and events for other threads).

#[cfg_attr(not(feature = "v4l2"), path = "absent.rs")]
mod kernel;

mod controls;
mod error;
mod jpeg;
mod negotiate;
mod node;
mod pixels;
mod reconnect;
mod request;
mod session;
mod stamps;
mod status;

#[cfg(test)]
mod script;
#[cfg(test)]
mod tests;

pub use error::{OpenError, Refusal};
pub use status::{CameraCounts, CameraEvent, CameraEvents, CameraStatus, Loss};

use std::fmt;

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::space::Micros;

use crate::config::{DeviceFormat, DeviceSection, ImageSize};
use kernel::Kernel;
use reconnect::Reconnecting;
use request::Request;
use status::Teller;

/// What a driver stamps frames by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampClock {
    /// `CLOCK_MONOTONIC`.
    Monotonic,
    /// It does not say.
    Unknown,
    /// The stamps of whoever feeds it.
    Copied,
}

impl fmt::Display for StampClock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Monotonic => "by CLOCK_MONOTONIC",
            Self::Unknown => "by a clock that the driver does not name",
            Self::Copied => "by the program that writes them",
        })
    }
}

/// What instant a stamp is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampSource {
    /// The last byte came: the exposure lies a read-out and half of itself before.
    EndOfFrame,
    /// The exposure began.
    StartOfExposure,
}

impl fmt::Display for StampSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::EndOfFrame => "the end of the frame",
            Self::StartOfExposure => "the start of the exposure",
        })
    }
}

/// How a connected camera gives its frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// Format on the wire.
    pub format: DeviceFormat,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Frames in a thousand seconds; none where the driver does not say.
    pub rate_millihertz: Option<u32>,
    /// Instant of the stamps.
    pub stamps: StampSource,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let format = negotiate::four_cc(self.format);
        write!(f, "{format} {}x{}", self.width, self.height)?;
        match self.rate_millihertz {
            Some(rate) => write!(f, " at {} Hz", f64::from(rate) * 1e-3)?,
            None => f.write_str(" at its own rate")?,
        }
        write!(f, ", stamped at {}", self.stamps)
    }
}

/// A camera of this computer.
pub struct V4l2Camera {
    port: Reconnecting<Kernel>,
    status: CameraStatus,
    events: Option<CameraEvents>,
}

impl V4l2Camera {
    /// Opens a camera, or begins to look for it where it is not there.
    ///
    /// # Errors
    /// What no waiting heals; [`OpenError::fix`] says what does.
    pub fn open(device: &DeviceSection, size: ImageSize, rate_hz: f64) -> Result<Self, OpenError> {
        let request = Request::new(device, size, rate_hz);
        let (teller, status, events) = Teller::new(&request.device);
        let offset = device.stamp_offset_micros();
        Ok(Self {
            port: Reconnecting::open(Kernel::new(), request, offset, teller)?,
            status,
            events: Some(events),
        })
    }

    /// How it gives its frames; none while it is away.
    #[must_use]
    pub fn mode(&self) -> Option<Mode> {
        self.port.mode()
    }

    /// Its counters.
    #[must_use]
    pub fn status(&self) -> CameraStatus {
        self.status.clone()
    }

    /// What happens to it; one reader takes this, once.
    pub const fn take_events(&mut self) -> Option<CameraEvents> {
        self.events.take()
    }
}

impl CameraPort for V4l2Camera {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        self.port.next_frame(buffer)
    }

    fn skip_before(&mut self, now: Micros) -> u64 {
        self.port.skip_before(now)
    }
}
