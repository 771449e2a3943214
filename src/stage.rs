//! The stages: their order, their names, the time they took, and who watches a task pass through them.
//!
//! Invariant: a stage has one name, in modules, timing columns, config tables, messages and reports.

use core::sync::atomic::{AtomicU32, Ordering};

/// The stages, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Stage {
    /// Stage 1.
    Frame,
    /// Stage 2.
    Track,
    /// Stage 3.
    Map,
    /// Stage 4.
    Priors,
    /// Stage 5.
    Segmentation,
    /// Stage 6.
    Crf,
    /// Stage 7.
    Grid,
    /// Stage 8.
    Emit,
}

impl Stage {
    /// All stages, in their order.
    pub const ALL: [Self; 8] = [
        Self::Frame,
        Self::Track,
        Self::Map,
        Self::Priors,
        Self::Segmentation,
        Self::Crf,
        Self::Grid,
        Self::Emit,
    ];

    /// The stage's one name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame",
            Self::Track => "track",
            Self::Map => "map",
            Self::Priors => "priors",
            Self::Segmentation => "segmentation",
            Self::Crf => "crf",
            Self::Grid => "grid",
            Self::Emit => "emit",
        }
    }
}

/// Microseconds spent in each stage for one key frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageTimes(pub [u64; Stage::ALL.len()]);

impl StageTimes {
    /// Adds to a stage.
    pub const fn add(&mut self, stage: Stage, micros: u64) {
        self.0[stage as usize] += micros;
    }

    /// Microseconds of a stage.
    #[must_use]
    pub const fn of(&self, stage: Stage) -> u64 {
        self.0[stage as usize]
    }
}

/// Where the clock cut the work on a key frame short; what a replay needs to cut it at the same places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cuts {
    /// Stages that might not start, for it was too late: one bit each.
    pub refused: u8,
    /// Quanta of refinement after which each stage was stopped; none where it came to its own end.
    pub stopped_after: [Option<u16>; Stage::ALL.len()],
}

impl Cuts {
    /// Whether a stage might not start.
    #[must_use]
    pub const fn is_refused(&self, stage: Stage) -> bool {
        self.refused & (1 << stage as u8) != 0
    }

    /// Notes that a stage may not start.
    pub const fn refuse(&mut self, stage: Stage) {
        self.refused |= 1 << stage as u8;
    }
}

/// Sees a task enter its stages: live so that the publisher knows whom to blame, in tests so that stages can be made to
/// fail, hang or panic.
pub trait StageProbe {
    /// The task is about to run `stage`; false makes the stage fail, and its stand-in takes over.
    fn enter(&self, stage: Stage) -> bool;
    /// The task waits for work.
    fn rest(&self);
    /// Whether `stage` may start, where that was decided before: in a replay, by the drive that was recorded. None where the
    /// clock decides.
    fn may_start(&self, stage: Stage) -> Option<bool> {
        let _ = stage;
        None
    }
    /// Whether the refinement of `stage` is over, `quanta` of it made; as [`StageProbe::may_start`].
    fn is_over(&self, stage: Stage, quanta: u16) -> Option<bool> {
        let _ = (stage, quanta);
        None
    }
}

/// Nobody watches.
impl StageProbe for () {
    fn enter(&self, _stage: Stage) -> bool {
        true
    }

    fn rest(&self) {}
}

/// Where a task is, for another thread to read; one relaxed store a stage.
///
/// The low byte is the stage, the others count entries, so that two readings tell whether the task moved between them.
#[derive(Debug)]
pub struct Progress(AtomicU32);

const RESTING: u32 = 0xFF;
const ENTRY: u32 = 0x100;

/// One reading of a [`Progress`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place(u32);

impl Place {
    /// The stage that the task is in; none while it waits for work.
    #[must_use]
    pub fn stage(self) -> Option<Stage> {
        Stage::ALL.get((self.0 & 0xFF) as usize).copied()
    }
}

impl Default for Progress {
    fn default() -> Self {
        Self(AtomicU32::new(RESTING))
    }
}

impl Progress {
    /// Where the task is now.
    #[must_use]
    pub fn place(&self) -> Place {
        Place(self.0.load(Ordering::Relaxed))
    }

    fn go(&self, code: u32) {
        let entries = self.0.load(Ordering::Relaxed) & !0xFF;
        self.0
            .store(entries.wrapping_add(ENTRY) | code, Ordering::Relaxed);
    }
}

impl StageProbe for Progress {
    fn enter(&self, stage: Stage) -> bool {
        self.go(stage as u32);
        true
    }

    fn rest(&self) {
        self.go(RESTING);
    }
}

impl<P: StageProbe + ?Sized> StageProbe for &P {
    fn enter(&self, stage: Stage) -> bool {
        (**self).enter(stage)
    }

    fn rest(&self) {
        (**self).rest();
    }

    fn may_start(&self, stage: Stage) -> Option<bool> {
        (**self).may_start(stage)
    }

    fn is_over(&self, stage: Stage, quanta: u16) -> Option<bool> {
        (**self).is_over(stage, quanta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_readings_tell_whether_a_task_moved() {
        let progress = Progress::default();
        assert_eq!(progress.place().stage(), None);
        progress.enter(Stage::Map);
        let place = progress.place();
        assert_eq!(place.stage(), Some(Stage::Map));
        assert_eq!(progress.place(), place);
        progress.rest();
        progress.enter(Stage::Map);
        assert_ne!(progress.place(), place);
    }
}
