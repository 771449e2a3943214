//! The order of the stages: the one file that knows it.
//!
//! Two tasks share the work. [`FrameTask`] takes every frame through *frame* and *track*, and collects the views of a key
//! frame in a [`KeyFrameJob`]. [`KeyFrameTask`] takes a job through *map*, *priors*, *segmentation*, *crf* and *grid*; its
//! [`KeyFrameOutput`] goes to the publisher, its [`Lesson`] back to the frame task. Jobs and outputs are boxes that
//! circulate: the caller owns them, so the tasks may run on two threads or, for a reproducible replay, on one.
//!
//! Bound: nothing is allocated after construction; refinement stops at its slice of [`Slices`] or at its cap in
//! [`crate::budget`]. A full batch takes no further view until the next key frame, and counts it.

mod emit_task;
mod frame_task;
mod key_frame_output;
mod key_frame_task;
mod publish_task;
mod stopwatch;

pub use emit_task::EmitTask;
pub use frame_task::{FrameOutcome, FrameTask, KeyFrameJob};
pub use key_frame_output::KeyFrameOutput;
pub use key_frame_task::{KeyFrameTask, Lesson};
pub use publish_task::{PublishTask, Workers};

use crate::crf::CrfConfig;
use crate::deadline::Slices;
use crate::frame::Camera;
use crate::grid::GridConfig;
use crate::map::MapConfig;
use crate::priors::PriorsConfig;
use crate::segmentation::ColourConfig;
use crate::track::{TrackConfig, WheelConfig};

/// Everything the stages are built from.
#[derive(Clone, Debug)]
pub struct PipelineConfig {
    /// Lens, image size and mount.
    pub camera: Camera,
    /// Width and height in pixels that segmentation's output and the CRF work at.
    pub working_size: (usize, usize),
    /// Wheel encoders; none where the scale comes from the camera height.
    pub wheels: Option<WheelConfig>,
    /// When a frame becomes a key frame.
    pub cadence: Cadence,
    /// Where the refinement of each stage ends.
    pub slices: Slices,
    /// Settings of stage 2.
    pub track: TrackConfig,
    /// Settings of stage 3.
    pub map: MapConfig,
    /// Settings of stage 4.
    pub priors: PriorsConfig,
    /// Settings of the colour lines of stage 5.
    pub colour: ColourConfig,
    /// Settings of stage 6.
    pub crf: CrfConfig,
    /// Settings of stage 7.
    pub grid: GridConfig,
}

/// When a frame becomes a key frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cadence {
    /// The first frame at or after each multiple of this time, whatever the frame rate.
    Micros(u64),
    /// Only frames for which the caller wants it.
    OnDemand,
}

/// Whether the clock may cut refinement short.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Slices end by the clock.
    Real,
    /// Slices end by their work caps only, so that the same input gives the same output.
    Reproducible,
}
