//! One key frame's way through the stages: may they start, is their slice over, how long did they take.
//!
//! Invariant: at [`Pace::Reproducible`] the clock decides nothing, it only measures. Cost: a clock reading a stage and quantum.

use super::{KeyFrameJob, Pace};
use crate::deadline::Slices;
use crate::port::Clock;
use crate::space::Micros;
use crate::stage::{Stage, StageProbe, StageTimes};

pub(super) struct Stopwatch<'a, C, P> {
    clock: &'a C,
    probe: &'a P,
    slices: Slices,
    pace: Pace,
    stamp: Micros,
    begin: Micros,
    pub(super) times: StageTimes,
}

impl<'a, C: Clock, P: StageProbe> Stopwatch<'a, C, P> {
    pub(super) fn new(clock: &'a C, probe: &'a P, slices: &Slices, pace: Pace, job: &KeyFrameJob) -> Self {
        Self {
            clock,
            probe,
            slices: *slices,
            pace,
            stamp: job.stamp,
            begin: clock.now(),
            times: job.times,
        }
    }

    /// Enters a stage; false where it fails.
    pub(super) fn enter(&mut self, stage: Stage) -> bool {
        let is_sound = self.probe.enter(stage);
        self.begin = self.clock.now();
        is_sound
    }

    /// Enters a stage; whether it may run: it does not fail, and there is time for it.
    pub(super) fn start(&mut self, stage: Stage) -> bool {
        self.enter(stage) && self.has_time_for(stage)
    }

    /// Whether a stage may still start.
    pub(super) fn has_time_for(&self, stage: Stage) -> bool {
        self.pace == Pace::Reproducible || self.slices.may_start(stage, self.stamp, self.clock.now())
    }

    /// Leaves a stage: the time since it was entered is its own.
    pub(super) fn end(&mut self, stage: Stage) {
        let now = self.clock.now();
        self.times.add(stage, now.since(self.begin));
        self.begin = now;
    }

    /// Waits for what has its own time: not counted as the stage's.
    pub(super) fn wait<T>(&mut self, waiting: impl FnOnce() -> T) -> T {
        let begin = self.clock.now();
        let result = waiting();
        self.begin = self.begin.plus(self.clock.now().since(begin));
        result
    }

    /// When the refinement of a stage that was entered last ends.
    fn end_of(&self, stage: Stage) -> Micros {
        self.slices.end(stage, self.stamp, self.begin)
    }

    /// Until when to wait for a stage that works elsewhere: its end, or no longer where it is too late; for ever where the clock
    /// decides nothing.
    pub(super) fn wait_until(&self, stage: Stage) -> Option<Micros> {
        let end = if self.has_time_for(stage) {
            self.end_of(stage)
        } else {
            self.begin
        };
        (self.pace == Pace::Real).then_some(end)
    }

    /// Whether it has ended.
    pub(super) fn is_over(&self, stage: Stage) -> bool {
        self.pace == Pace::Real && self.clock.now() >= self.end_of(stage)
    }
}
