//! A stage made slow on purpose, to see what a miss looks like.

use std::time::Duration;

use freespace::port::Clock as _;
use freespace::space::Micros;
use freespace::stage::{Progress, Stage, StageProbe};

use crate::clock::MonotonicClock;

/// A stage of the key-frame task that takes longer than it needs, for a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlowStage {
    /// Which; the others are not slowed: *frame*, *track* and *emit* are not the key-frame task's.
    pub stage: Stage,
    /// How much longer.
    pub more: Duration,
    /// From when on, in the time of the drive.
    pub from: Micros,
    /// Until when.
    pub until: Micros,
}

impl SlowStage {
    /// Stages that can be slowed.
    pub const STAGES: [Stage; 5] = [
        Stage::Map,
        Stage::Priors,
        Stage::Segmentation,
        Stage::Crf,
        Stage::Grid,
    ];
}

/// The key-frame task's progress, and its slow stage where there is one.
pub(super) struct Probe<'a> {
    pub(super) progress: &'a Progress,
    pub(super) slow: Option<SlowStage>,
    pub(super) clock: &'a MonotonicClock,
}

impl StageProbe for Probe<'_> {
    fn enter(&self, stage: Stage) -> bool {
        let may_run = self.progress.enter(stage);
        if let Some(slow) = &self.slow
            && slow.stage == stage
            && (slow.from..slow.until).contains(&self.clock.now())
        {
            std::thread::sleep(slow.more);
        }
        may_run
    }

    fn rest(&self) {
        self.progress.rest();
    }
}
