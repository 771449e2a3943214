//! What is asked of the kernel, as two small traits: so that a script can stand in for a camera.
//!
//! Each call of [`Node`] is one request of V4L2; the answers are plain values. Nothing is decided here.
#![cfg_attr(
    not(feature = "v4l2"),
    allow(dead_code, reason = "answers that only the kernel gives")
)]

use std::path::Path;

use freespace::space::Micros;
use rustix::io::Errno;

use super::{StampClock, StampSource};

/// Where nodes are opened, and what time it is there.
pub(super) trait Devices {
    /// An open device.
    type Node: Node;

    /// Opens a node without blocking.
    fn open(&mut self, path: &Path) -> Result<Self::Node, Errno>;

    /// `CLOCK_MONOTONIC`.
    fn now(&self) -> Micros;

    /// Sleeps; a camera that is gone is not asked again and again.
    fn pause(&mut self, micros: u64);
}

/// An open device; dropping it unmaps its buffers and closes it, whatever state it is in.
pub(super) trait Node {
    /// What kind of device it is.
    fn abilities(&mut self) -> Result<Abilities, Errno>;

    /// The format with that number; `EINVAL` after the last one.
    fn format_at(&mut self, number: u32) -> Result<FourCc, Errno>;

    /// The size with that number of a format; `EINVAL` after the last one.
    fn size_at(&mut self, format: FourCc, number: u32) -> Result<SizeOffer, Errno>;

    /// Asks for a layout; the answer is what the driver made of it.
    fn set_layout(&mut self, wanted: Layout) -> Result<Layout, Errno>;

    /// Asks for a time between frames; none where the driver has nothing to say about it.
    fn set_interval(&mut self, wanted: Interval) -> Result<Option<Interval>, Errno>;

    /// The control that follows the one with that id, 0 for the first; `EINVAL` after the last one.
    fn control_after(&mut self, id: u32) -> Result<Control, Errno>;

    /// The name of a menu's item; `EINVAL` where it has no such item.
    fn menu_item(&mut self, control: &Control, number: u32) -> Result<String, Errno>;

    /// Sets a control.
    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno>;

    /// Makes and maps buffers: how many there are, and how they will be stamped.
    fn map_buffers(&mut self, wanted: u32) -> Result<Buffers, Errno>;

    /// Gives a buffer to the driver.
    fn queue(&mut self, buffer: u32) -> Result<(), Errno>;

    /// Frames begin to come.
    fn start(&mut self) -> Result<(), Errno>;

    /// Waits for a filled buffer: whether there is one. A device that hung up is an error.
    fn wait(&mut self, micros: u64) -> Result<bool, Errno>;

    /// The next filled buffer; `EAGAIN` where there is none.
    fn dequeue(&mut self) -> Result<Filled, Errno>;

    /// The first `len` bytes, or as many as there are, of a buffer that was dequeued.
    fn bytes(&self, buffer: u32, len: u32) -> &[u8];
}

/// Kind of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Abilities {
    /// Gives pictures in one plane of memory.
    pub(super) is_capture: bool,
    /// Gives pictures in several planes of memory.
    pub(super) is_multi_planar: bool,
    /// Has buffers that can be queued.
    pub(super) is_streaming: bool,
}

/// A format as the kernel names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FourCc(pub(super) [u8; 4]);

impl std::fmt::Display for FourCc {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0.escape_ascii().to_string().trim_end())
    }
}

/// Sizes of a format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SizeOffer {
    /// Width and height.
    One(u32, u32),
    /// Everything between two sizes, in some steps.
    Between((u32, u32), (u32, u32)),
}

impl std::fmt::Display for SizeOffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::One(width, height) => write!(f, "{width}x{height}"),
            Self::Between(small, large) => {
                write!(f, "{}x{} to {}x{}", small.0, small.1, large.0, large.1)
            }
        }
    }
}

/// How a frame lies in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) format: FourCc,
    pub(super) width: u32,
    pub(super) height: u32,
    /// From one row to the next; 0 where the driver does not say, or the picture is compressed.
    pub(super) bytes_per_line: u32,
    /// Largest frame.
    pub(super) image_bytes: u32,
    /// Whether a buffer holds a whole picture, and no half of its rows.
    pub(super) is_progressive: bool,
}

/// Time between frames, a fraction of a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interval {
    pub(super) numerator: u32,
    pub(super) denominator: u32,
}

/// A control of the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Control {
    pub(super) id: u32,
    pub(super) name: String,
    pub(super) kind: ControlKind,
    pub(super) minimum: i64,
    pub(super) maximum: i64,
    pub(super) step: u64,
    pub(super) is_writable: bool,
}

/// What a control takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ControlKind {
    Integer,
    Bool,
    /// Items with names.
    Menu,
    /// Items with numbers.
    NumberMenu,
    /// Text, buttons, large and compound values: not offered to the config.
    Other,
}

/// The buffers that a driver made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Buffers {
    pub(super) count: u32,
    pub(super) clock: StampClock,
    pub(super) source: StampSource,
}

/// A buffer that the driver filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Filled {
    pub(super) buffer: u32,
    /// The driver's count of frames; wraps.
    pub(super) sequence: u32,
    pub(super) stamp: Micros,
    pub(super) clock: StampClock,
    /// Bytes written.
    pub(super) len: u32,
    /// The driver says itself that the picture is damaged.
    pub(super) is_damaged: bool,
}
