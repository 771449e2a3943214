//! How long a task's work takes.

use freespace::port::Clock;
use freespace::space::Micros;
use freespace::stage::{Stage, StageProbe};

use crate::clock::MonotonicClock;

/// What the frame task learns of the key-frame task before it works on a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Learning {
    /// Each lesson, when it comes.
    AsItComes,
    /// As in the drive that was recorded: the lesson of this key frame, or none.
    AsRecorded(Option<u64>),
}

/// The clock that a task reads while it works, and the probe that it reports to.
pub(super) trait TaskTime: Clock + StageProbe {
    /// The task begins to work, on the frame of that index; none where it works on no frame.
    fn begin(&self, at: Micros, frame: Option<u64>);
    /// When the work that began at `began` is done; none where it hangs for ever.
    fn end(&self, began: Micros) -> Option<Micros>;
    /// The stage that the task was in last.
    fn stage(&self) -> Option<Stage>;
    /// The stage that the task, at work then, was in at that time.
    fn stage_at(&self, at: Micros) -> Option<Stage> {
        let _ = at;
        self.stage()
    }
    /// What the task learns before it works on its frame.
    fn learning(&self) -> Learning {
        Learning::AsItComes
    }
}

/// Measures the work's real time for the report, and counts it as none.
#[derive(Default)]
pub(super) struct Measured {
    clock: MonotonicClock,
    stage: std::cell::Cell<Option<Stage>>,
}

impl Clock for Measured {
    fn now(&self) -> Micros {
        self.clock.now()
    }
}

impl StageProbe for Measured {
    fn enter(&self, stage: Stage) -> bool {
        self.stage.set(Some(stage));
        true
    }

    fn rest(&self) {}
}

impl TaskTime for Measured {
    fn begin(&self, _at: Micros, _frame: Option<u64>) {}

    fn end(&self, began: Micros) -> Option<Micros> {
        Some(began)
    }

    fn stage(&self) -> Option<Stage> {
        self.stage.get()
    }
}
