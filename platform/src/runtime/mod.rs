//! Running the pipeline: live on threads with the deadline, or in lockstep for a reproducible result.

pub mod allocation;
pub(crate) mod handover;
mod live;
mod lockstep;
pub mod memory;
mod network;
mod page_faults;
mod restart;
pub mod rights;
pub mod supervision;
mod trace;

pub use live::{LiveRun, SlowStage, run_live};
pub use lockstep::{
    FaultKind, FaultModel, Injection, KeyFrameTimes, RecordedTimes, Victim, run_in_lockstep, run_modelled,
    run_recorded,
};
pub use network::{InlineNetwork, ThreadedNetwork};
pub use restart::hush_real_time_panics;
pub use trace::{Event, Trace};

use freespace::health::Faults;
use freespace::pipeline::{FrameOutcome, KeyFrameJob, KeyFrameOutput, PipelineConfig};
use freespace::port::{CameraPort, SinkPort, WheelPort};
use freespace::segmentation::TileConfig;
use freespace::space::Micros;
use freespace::stage::{Cuts, StageTimes};

use crate::clock::MonotonicClock;
use crate::segmenter::Segmenter;
use crate::statistics::{Drops, Publication};
use memory::MemoryPlan;
use rights::{Lack, RealTimeConfig};

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
    /// Where publications go, besides the observer.
    pub sinks: Vec<Box<dyn SinkPort + Send>>,
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
    /// The key frame, by the index of its frame, whose lesson was learnt since the frame before.
    pub learnt: Option<u64>,
}

/// Work on a key frame that a fallback answered: it changed what later key frames build on, so a replay does it again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateWork {
    /// Number of the frame in its source.
    pub frame: u64,
    /// Capture stamp.
    pub stamp: Micros,
    /// From the capture until the publisher heard of its answer, or until it was given up.
    pub micros: u64,
    /// Time of each stage.
    pub times: StageTimes,
    /// Where the clock cut the work short; one that was given up might not start *grid*.
    pub cuts: Cuts,
    /// Its faults; those of the network count.
    pub faults: Faults,
}

impl LateWork {
    /// Of an output as the work left it, heard of at `now`.
    fn of(job: &KeyFrameJob, output: &KeyFrameOutput, now: Micros) -> Self {
        Self {
            frame: job.frame,
            stamp: job.stamp,
            micros: now.since(job.stamp),
            times: output.times,
            cuts: output.cuts,
            faults: output.faults,
        }
    }
}

/// One publication, as the observer sees it; its output says when it left, and what it is worth.
#[derive(Clone, Copy)]
pub struct KeyFrameReport<'a> {
    /// Number of the frame in its source.
    pub index: u64,
    /// The picture and the views; none where a fallback was published, for the job is still under way.
    pub job: Option<&'a KeyFrameJob>,
    /// What was published.
    pub output: &'a KeyFrameOutput,
}

/// How a run goes, as its observer is told several times a second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Frames that entered the pipeline.
    pub frames: u64,
    /// Frames lost by the camera, refused, or displaced by newer ones.
    pub dropped_frames: u64,
    /// Key frames published.
    pub key_frames: u64,
    /// Key frames that a fallback answered, or that came after their deadline.
    pub deadline_misses: u64,
    /// Key frames that their own answer answered.
    pub fresh: u64,
    /// Parts that panicked and were started anew.
    pub restarts: u32,
    /// What was lost on the way.
    pub drops: Drops,
}

/// Watches a run from a normal thread; it may allocate and block.
pub trait Observer {
    /// All is made, and the threads are about to start.
    fn started(&mut self, start: &Start<'_>) {
        let _ = start;
    }
    /// A frame was tracked.
    fn frame(&mut self, report: &FrameReport);
    /// A key frame was published; comes for every one of them.
    fn publication(&mut self, publication: &Publication) {
        let _ = publication;
    }
    /// A key frame was worked on that a fallback answered.
    fn late_work(&mut self, work: &LateWork) {
        let _ = work;
    }
    /// What was published; may be left out where the observer is slow.
    fn key_frame(&mut self, report: &KeyFrameReport<'_>);
    /// Something worth a line in a log happened.
    fn trace(&mut self, trace: &Trace) {
        let _ = trace;
    }
    /// The last message of a live run has left; no grid follows.
    fn last_word(&mut self, output: &KeyFrameOutput) {
        let _ = output;
    }
    /// How it goes, several times a second.
    fn status(&mut self, status: &Status) {
        let _ = status;
    }
}

/// Why a live run ended early.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A thread could not be started.
    #[error("a thread of the pipeline could not be started: {0}")]
    Thread(std::io::Error),
    /// A stage does not return: its thread cannot be ended, so the process must be.
    #[error("{0} hangs: the process must be started anew")]
    Hung(&'static str),
    /// Parts panicked more often than a drive survives.
    #[error("parts of the pipeline panicked too often: the process must be started anew")]
    PanickedTooOften,
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
    /// Key frames that their own answer answered.
    pub fresh: u64,
    /// What was lost on the way.
    pub drops: Drops,
    /// Parts that panicked and were started anew.
    pub restarts: u32,
    /// Allocations made by the real-time threads after their start.
    pub allocations_after_start: u64,
    /// Page faults of warm real-time threads.
    pub page_faults: u64,
    /// A signal ended it before its camera or its time did.
    pub is_cut_short: bool,
}

/// Wheel readings up to this long after a frame's stamp are taken in before the frame: a frame is delivered that much later
/// than it was captured, and interpolation wants a reading on either side.
const WHEEL_LOOKAHEAD_MICROS: u64 = 25_000;

/// What the run was built from.
pub struct Setup {
    /// The pipeline's settings.
    pub config: PipelineConfig,
    /// Its devices.
    pub devices: Devices,
    /// What each thread asks of the kernel.
    pub real_time: RealTimeConfig,
    /// What was made before the run, the network among it, by the bytes it holds.
    pub plan: MemoryPlan,
    /// Rights that were refused before the run.
    pub lacks: Vec<Lack>,
    /// What the stamps of the devices are read on.
    pub clock: MonotonicClock,
    /// A stage that a live run makes slow on purpose.
    pub slow: Option<SlowStage>,
}

/// What a live run starts with.
#[derive(Debug)]
pub struct Start<'a> {
    /// All memory, by component.
    pub plan: &'a MemoryPlan,
    /// Rights that were refused: every message says so.
    pub lacks: &'a [Lack],
}
