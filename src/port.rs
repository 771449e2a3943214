//! Ports: what the core asks of the outside, as small traits.
//!
//! Each port is a folder of the platform, each technology a file there.

use alloc::vec::Vec;

use crate::emit::CanFrame;
use crate::frame::{PixelFormat, RawFrame, RgbImage};
use crate::health::Faults;
use crate::segmentation::RoadProbability;
use crate::space::Micros;
use crate::track::WheelReading;

/// The time now, on the clock of the capture stamps.
pub trait Clock {
    /// Reads the clock.
    fn now(&self) -> Micros;
}

/// Why a network gave no fresh answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetworkMiss {
    /// Its slice ran out: the last probabilities are moved by the pose instead.
    Late,
    /// It failed or gave garbage (a probability outside 0..1): treated as late, and counted apart.
    Failed,
    /// It is still busy with an earlier key frame.
    Busy,
}

/// A segmentation network that may run beside the other stages.
pub trait RoadNetwork {
    /// Hands over an image; returns at once where the network has a thread of its own.
    fn begin(&mut self, image: &RgbImage);

    /// Waits until `until` at the latest and writes the probabilities at the CRF resolution; returns the microseconds
    /// that the network ran.
    ///
    /// # Errors
    /// [`NetworkMiss`], and `out` is as it was.
    fn finish(&mut self, until: Option<Micros>, out: &mut RoadProbability) -> Result<u64, NetworkMiss>;
}

/// A frame as a camera delivers it, in a buffer that is used again and again.
#[derive(Clone, Debug)]
pub struct FrameBuffer {
    /// Number of the frame in its source, from 0; a gap is a lost frame.
    pub index: u64,
    /// Capture stamp.
    pub stamp: Micros,
    /// Layout of `bytes`.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// The pixels.
    pub bytes: Vec<u8>,
    /// Whether this frame must be a key frame, whatever the cadence.
    pub key_frame_wanted: bool,
}

impl Default for FrameBuffer {
    fn default() -> Self {
        Self {
            index: 0,
            stamp: Micros(0),
            format: PixelFormat::Grey,
            width: 0,
            height: 0,
            bytes: Vec::new(),
            key_frame_wanted: false,
        }
    }
}

impl FrameBuffer {
    /// The frame as the *frame* stage takes it.
    #[must_use]
    pub fn raw(&self) -> RawFrame<'_> {
        RawFrame {
            stamp: self.stamp,
            format: self.format,
            width: self.width,
            height: self.height,
            bytes: &self.bytes,
        }
    }
}

/// What a camera answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraAnswer {
    /// The buffer holds the next frame.
    Frame,
    /// A frame was lost or could not be decoded; the next one may come.
    Lost,
    /// No frame came while it was waited for; one may come yet.
    Silent,
    /// No frame will come any more.
    End,
}

/// A source of frames.
pub trait CameraPort {
    /// Waits for the next frame for a bounded time and writes it to `buffer`.
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer;

    /// A source that makes its frames itself leaves out those that a camera would have given to nobody: all but the newest that
    /// was captured before `now`. Returns how many. A real camera's driver sees to that.
    fn skip_before(&mut self, now: Micros) -> u64 {
        let _ = now;
        0
    }
}

/// A source of wheel readings.
pub trait WheelPort {
    /// Hands over, in order, each reading with a stamp of at most `until` that was not handed over yet.
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading));
}

/// Why a sink did not take a publication.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SinkMiss {
    /// Its queue is full, its bus is off, or an earlier message did not get through: counted, and said in the next message.
    Refused,
}

/// Where publications go.
pub trait SinkPort {
    /// Takes a message and its CAN frames, or refuses; it must not wait.
    ///
    /// # Errors
    /// [`SinkMiss`]; what was sent of the publication until then stays sent.
    fn publish(&mut self, message: &[u8], frames: &[CanFrame]) -> Result<(), SinkMiss>;

    /// What a message says where this sink refused the one before it.
    fn fault(&self) -> Faults {
        Faults::CAN_SEND_FAILED
    }

    /// A message is being made: a sink that hands over to another thread may wake it now, so that it is awake when
    /// [`SinkPort::publish`] comes, about a tenth of a millisecond later. It must not wait either; nothing may come after all.
    fn prepare(&mut self) {}
}
