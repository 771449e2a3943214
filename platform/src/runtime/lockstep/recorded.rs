//! The clock of a drive that was recorded.
//!
//! In: [`RecordedTimes`]. Out: clock, probe and network that behave as that drive's did. Invariant: nothing depends on the
//! machine. What the clock decided then is decided the same way again: stages that might not start, the quanta after which
//! refinement stopped, a network that was late or failed, answers that a fallback left in place of, and work that was given up.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use freespace::frame::RgbImage;
use freespace::health::Faults;
use freespace::port::{Clock, NetworkMiss, RoadNetwork};
use freespace::segmentation::RoadProbability;
use freespace::space::Micros;
use freespace::stage::{Cuts, Stage, StageProbe, StageTimes};

use super::time::{Learning, TaskTime};

/// What one key frame took, and what the clock decided about it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KeyFrameTimes {
    /// Capture stamp.
    pub stamp: Micros,
    /// Time of each stage.
    pub stages: StageTimes,
    /// What was cut short.
    pub cuts: Cuts,
    /// Its faults; those of the network count.
    pub faults: Faults,
    /// From capture to publication.
    pub latency_micros: u64,
    /// Where a fallback left in place of its answer: from the capture until the publisher heard of the work on it, or until that was
    /// given up.
    pub heard_micros: Option<u64>,
}

/// What the frames and key frames of a drive took, by the index of the frame.
#[derive(Clone, Debug, Default)]
pub struct RecordedTimes {
    /// Time that *frame* and *track* took.
    pub frame_micros: BTreeMap<u64, u64>,
    /// Key frames.
    pub key_frames: BTreeMap<u64, KeyFrameTimes>,
    /// Before which frame the lesson of which key frame was learnt; empty where nobody noted it.
    pub lessons: BTreeMap<u64, u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Task {
    Frame,
    KeyFrame,
    Publisher,
}

/// The time of one task, shared with the network that works beside it.
#[derive(Clone)]
pub(super) struct Recorded(Rc<TaskState>);

struct TaskState {
    drive: Rc<RecordedTimes>,
    task: Task,
    now: Cell<Micros>,
    frame: Cell<Option<u64>>,
    key_frame: Cell<Option<KeyFrameTimes>>,
    /// The stages entered, and when.
    stages: RefCell<Vec<(Stage, Micros)>>,
    /// What the next reading of the clock adds: the time of the stage that was entered is over then.
    due_micros: Cell<u64>,
}

impl Recorded {
    fn new(drive: &Rc<RecordedTimes>, task: Task) -> Self {
        Self(Rc::new(TaskState {
            drive: Rc::clone(drive),
            task,
            now: Cell::default(),
            frame: Cell::default(),
            key_frame: Cell::default(),
            stages: RefCell::new(Vec::with_capacity(Stage::ALL.len())),
            due_micros: Cell::default(),
        }))
    }

    pub(super) fn frame(drive: &Rc<RecordedTimes>) -> Self {
        Self::new(drive, Task::Frame)
    }

    pub(super) fn key_frame(drive: &Rc<RecordedTimes>) -> Self {
        Self::new(drive, Task::KeyFrame)
    }

    pub(super) fn publisher(drive: &Rc<RecordedTimes>) -> Self {
        Self::new(drive, Task::Publisher)
    }

    fn spend(&self, micros: u64) {
        self.0.now.set(self.0.now.get().plus(micros));
    }

    /// Time of *frame* or *track* for the frame at work: of a key frame each is known, of others both together.
    fn frame_stage_micros(&self, stage: Stage) -> u64 {
        let both = (self.0.frame.get()).and_then(|frame| self.0.drive.frame_micros.get(&frame).copied());
        let both = both.unwrap_or(0);
        let first = (self.0.key_frame.get())
            .map_or(0, |key_frame| key_frame.stages.of(Stage::Frame))
            .min(both);
        match stage {
            Stage::Frame => first,
            Stage::Track => both - first,
            _ => 0,
        }
    }
}

impl Clock for Recorded {
    fn now(&self) -> Micros {
        self.spend(self.0.due_micros.take());
        self.0.now.get()
    }
}

impl StageProbe for Recorded {
    fn enter(&self, stage: Stage) -> bool {
        self.0.stages.borrow_mut().push((stage, self.0.now.get()));
        match self.0.task {
            Task::Frame => self.spend(self.frame_stage_micros(stage)),
            Task::KeyFrame => {
                let micros = self.0.key_frame.get().map_or(0, |times| times.stages.of(stage));
                self.0.due_micros.set(micros);
            }
            Task::Publisher => {}
        }
        true
    }

    fn rest(&self) {}

    fn may_start(&self, stage: Stage) -> Option<bool> {
        let Some(times) = self.0.key_frame.get() else {
            return Some(true);
        };
        Some(match stage {
            // It begins beside the others, and may have answered before its turn came too late: whether it did is what counts.
            Stage::Segmentation => !times.faults.contains(Faults::NETWORK_LATE),
            _ => !times.cuts.is_refused(stage),
        })
    }

    fn is_over(&self, stage: Stage, quanta: u16) -> Option<bool> {
        let cuts = self.0.key_frame.get().map_or(Cuts::default(), |times| times.cuts);
        Some(cuts.stopped_after[stage as usize].is_some_and(|most| quanta >= most))
    }
}

impl TaskTime for Recorded {
    fn begin(&self, at: Micros, frame: Option<u64>) {
        self.0.now.set(at);
        self.0.frame.set(frame);
        let key_frame = frame.and_then(|frame| self.0.drive.key_frames.get(&frame));
        self.0.key_frame.set(key_frame.copied());
        self.0.stages.borrow_mut().clear();
        self.0.due_micros.set(0);
    }

    fn end(&self, began: Micros) -> Option<Micros> {
        let done = match (self.0.task, self.0.key_frame.get()) {
            (Task::KeyFrame, Some(times)) => times
                .stamp
                .plus(times.heard_micros.unwrap_or(times.latency_micros)),
            (Task::Frame, _) => self.0.now.get(),
            (Task::KeyFrame | Task::Publisher, _) => began,
        };
        Some(done.max(began))
    }

    fn stage(&self) -> Option<Stage> {
        self.0.stages.borrow().last().map(|(stage, _)| *stage)
    }

    fn stage_at(&self, at: Micros) -> Option<Stage> {
        let stages = self.0.stages.borrow();
        let entered = stages.iter().take_while(|(_, entered)| *entered <= at);
        entered.last().map(|(stage, _)| *stage)
    }

    fn learning(&self) -> Learning {
        let lessons = &self.0.drive.lessons;
        if lessons.is_empty() {
            return Learning::AsItComes;
        }
        Learning::AsRecorded((self.0.frame.get()).and_then(|frame| lessons.get(&frame).copied()))
    }
}

/// The network as the drive found it.
pub(super) struct RecordedNetwork<N> {
    inner: N,
    task: Recorded,
}

impl<N: RoadNetwork> RecordedNetwork<N> {
    pub(super) fn new(inner: N, task: &Recorded) -> Self {
        Self {
            inner,
            task: task.clone(),
        }
    }

    fn faults(&self) -> Faults {
        (self.task.0.key_frame.get()).map_or(Faults::NONE, |times| times.faults)
    }
}

impl<N: RoadNetwork> RoadNetwork for RecordedNetwork<N> {
    fn begin(&mut self, image: &RgbImage) {
        if !self.faults().contains(Faults::NETWORK_LATE) {
            self.inner.begin(image);
        }
    }

    /// Its time is within the stage's, as the recording has it.
    fn finish(&mut self, _until: Option<Micros>, out: &mut RoadProbability) -> Result<u64, NetworkMiss> {
        if self.faults().contains(Faults::NETWORK_LATE) {
            return Err(NetworkMiss::Late);
        }
        if self.faults().contains(Faults::NETWORK_FAILED) {
            return Err(NetworkMiss::Failed);
        }
        self.inner.finish(None, out).map(|_| 0)
    }
}
