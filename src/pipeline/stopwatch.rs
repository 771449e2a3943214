//! One key frame's way through the stages: may they start, is their slice over, how long did they take.
//!
//! Invariant: at [`Pace::Reproducible`] the clock decides nothing, it only measures; what the probe knows to be decided the
//! clock does not decide either. What was cut short is noted. Cost: a clock reading a stage and quantum.

use core::cell::Cell;

use super::{KeyFrameJob, Pace};
use crate::deadline::Slices;
use crate::port::Clock;
use crate::space::Micros;
use crate::stage::{Cuts, Stage, StageProbe, StageTimes};

pub(super) struct Stopwatch<'a, C, P> {
    clock: &'a C,
    probe: &'a P,
    slices: Slices,
    pace: Pace,
    stamp: Micros,
    begin: Micros,
    /// Quanta of refinement that the stage entered last has made.
    quanta: Cell<u16>,
    cuts: Cell<Cuts>,
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
            quanta: Cell::new(0),
            cuts: Cell::new(Cuts::default()),
            times: job.times,
        }
    }

    /// Enters a stage; false where it fails.
    pub(super) fn enter(&mut self, stage: Stage) -> bool {
        self.quanta.set(0);
        self.begin = self.clock.now();
        self.probe.enter(stage)
    }

    /// Enters a stage; whether it may run: it does not fail, and there is time for it.
    pub(super) fn start(&mut self, stage: Stage) -> bool {
        let may_run = self.enter(stage) && self.has_time_for(stage);
        if !may_run {
            // What it took to find out is its own: one that stalled before it began is to blame for what it kept from its turn.
            self.end(stage);
        }
        may_run
    }

    /// Whether a stage may still start.
    pub(super) fn has_time_for(&self, stage: Stage) -> bool {
        let may = self.pace == Pace::Reproducible
            || (self.probe.may_start(stage))
                .unwrap_or_else(|| self.slices.may_start(stage, self.stamp, self.clock.now()));
        if !may {
            let mut cuts = self.cuts.get();
            cuts.refuse(stage);
            self.cuts.set(cuts);
        }
        may
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

    /// Whether the refinement of a stage has ended; asked before each quantum.
    pub(super) fn is_over(&self, stage: Stage) -> bool {
        let quanta = self.quanta.get();
        let is_over = self.pace == Pace::Real
            && (self.probe.is_over(stage, quanta)).unwrap_or_else(|| self.clock.now() >= self.end_of(stage));
        if is_over {
            let mut cuts = self.cuts.get();
            cuts.stopped_after[stage as usize] = Some(quanta);
            self.cuts.set(cuts);
        } else {
            self.quanta.set(quanta.saturating_add(1));
        }
        is_over
    }

    /// What was cut short so far.
    pub(super) const fn cuts(&self) -> Cuts {
        self.cuts.get()
    }
}
