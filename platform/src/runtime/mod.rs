//! Running the pipeline: live on threads with the deadline, or in lockstep for a reproducible result.

pub mod allocation;
mod live;
mod lockstep;
pub mod memory;
mod network;
pub mod rights;
pub mod supervision;

pub use live::run_live;
pub use lockstep::run_in_lockstep;
pub use network::{InlineNetwork, ThreadedNetwork};

use freespace::pipeline::{FrameOutcome, KeyFrameJob, KeyFrameOutput, PipelineConfig};
use freespace::port::{CameraPort, WheelPort};
use freespace::segmentation::TileConfig;
use freespace::space::Micros;

use crate::segmenter::Segmenter;

/// The devices of a run.
pub struct Devices {
    /// Frames.
    pub camera: Box<dyn CameraPort + Send>,
    /// Wheel readings, where there are encoders.
    pub wheels: Option<Box<dyn WheelPort + Send>>,
    /// The network.
    pub segmenter: Box<dyn Segmenter>,
    /// Tiles that the network sees a picture in.
    pub tiles: TileConfig,
}

/// One frame, as the observer sees it.
#[derive(Clone, Copy, Debug)]
pub struct FrameReport {
    /// Number of the frame in its source.
    pub index: u64,
    /// Capture stamp.
    pub stamp: Micros,
    /// What became of it.
    pub outcome: FrameOutcome,
}

/// One publication, as the observer sees it.
#[derive(Clone, Copy, Debug)]
pub struct KeyFrameReport<'a> {
    /// Number of the frame in its source.
    pub index: u64,
    /// The picture and the views; none where a fallback was published, for the job is still under way.
    pub job: Option<&'a KeyFrameJob>,
    /// What was published.
    pub output: &'a KeyFrameOutput,
    /// From capture to publication; in lockstep, the time that the work took.
    pub latency_micros: u64,
    /// Whether a fallback went out in place of the answer.
    pub is_miss: bool,
}

/// Watches a run from a normal thread; it may allocate and block.
pub trait Observer {
    /// A frame was tracked.
    fn frame(&mut self, report: &FrameReport);
    /// A key frame was published.
    fn key_frame(&mut self, report: &KeyFrameReport<'_>);
}

/// Counts of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RunSummary {
    /// Frames that entered the pipeline.
    pub frames: u64,
    /// Frames lost by the camera, refused, or displaced by newer ones.
    pub dropped_frames: u64,
    /// Key frames published.
    pub key_frames: u64,
    /// Key frames that a fallback answered, or that came after their deadline.
    pub deadline_misses: u64,
    /// Key frames that the observer was too slow to see.
    pub unobserved_key_frames: u64,
    /// Allocations made by the real-time threads after their start.
    pub allocations_after_start: u64,
}

/// Wheel readings up to this long after a frame's stamp are taken in before the frame: a frame is delivered that much later
/// than it was captured, and interpolation wants a reading on either side.
const WHEEL_LOOKAHEAD_MICROS: u64 = 25_000;

/// Boxes of each kind that circulate; each is allocated before the start.
const CIRCULATING: usize = 6;

/// What the run was built from.
pub struct Setup {
    /// The pipeline's settings.
    pub config: PipelineConfig,
    /// Its devices.
    pub devices: Devices,
}
