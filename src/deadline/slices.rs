//! Time slices of a key frame.

use crate::budget::{DEADLINE_MICROS, GUARD_MICROS, RESERVE_MICROS, SLICES};
use crate::space::Micros;
use crate::stage::{Stage, StageTimes};

/// The table of slices, for a deadline that may be shorter than the promise: all shrink alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slices {
    /// From capture to the latest publication.
    pub deadline_micros: u64,
    /// A fallback leaves this long after the capture.
    pub send_by_micros: u64,
    ends_micros: [u64; Stage::ALL.len()],
}

impl Default for Slices {
    fn default() -> Self {
        Self::within(DEADLINE_MICROS)
    }
}

impl Slices {
    /// The slices for this deadline.
    #[must_use]
    pub fn within(deadline_micros: u64) -> Self {
        let scaled = |micros: u64| micros * deadline_micros / DEADLINE_MICROS;
        let mut spent = 0;
        let ends_micros = SLICES.map(|slice| {
            spent += slice.micros;
            scaled(spent)
        });
        Self {
            deadline_micros,
            send_by_micros: deadline_micros - scaled(GUARD_MICROS),
            ends_micros,
        }
    }

    /// The instant at which the refinement of a stage ends, for a frame captured at `stamp`: as planned, and a late stage has
    /// its slice all the same.
    #[must_use]
    pub fn end(&self, stage: Stage, stamp: Micros, started: Micros) -> Micros {
        let planned = stamp.plus(self.ends_micros[stage as usize]);
        planned.max(started.plus(self.slice_micros(stage)))
    }

    /// Whether a stage may start: its own slice and those after it still fit before a fallback leaves.
    #[must_use]
    pub const fn may_start(&self, stage: Stage, stamp: Micros, now: Micros) -> bool {
        now.since(stamp) <= self.start_micros(stage) + self.reserve_micros()
    }

    /// Planned start of a stage, after capture.
    const fn start_micros(&self, stage: Stage) -> u64 {
        match (stage as usize).checked_sub(1) {
            None => 0,
            Some(before) => self.ends_micros[before],
        }
    }

    const fn reserve_micros(&self) -> u64 {
        RESERVE_MICROS * self.deadline_micros / DEADLINE_MICROS
    }

    /// Of the stages that took longer than their slices the one that did so the furthest.
    #[must_use]
    pub fn slowest(&self, times: &StageTimes) -> Option<Stage> {
        Stage::ALL
            .into_iter()
            .map(|stage| (times.of(stage).saturating_sub(self.slice_micros(stage)), stage))
            .filter(|(over_micros, _)| *over_micros > 0)
            .max()
            .map(|(_, stage)| stage)
    }

    const fn slice_micros(&self, stage: Stage) -> u64 {
        self.ends_micros[stage as usize] - self.start_micros(stage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_slice_ends_a_reserve_before_the_fallback() {
        for deadline_micros in [500_000, 250_000, 100_000] {
            let slices = Slices::within(deadline_micros);
            let end = slices.end(Stage::Emit, Micros(0), Micros(0)).0;
            assert_eq!(end + slices.reserve_micros(), slices.send_by_micros);
            assert!(slices.send_by_micros < deadline_micros);
        }
    }

    #[test]
    fn a_stage_may_be_late_by_the_reserve_and_no_more() {
        let slices = Slices::default();
        let stamp = Micros(7_000_000);
        for (index, stage) in Stage::ALL.into_iter().enumerate() {
            let planned = if index == 0 {
                stamp
            } else {
                slices.end(Stage::ALL[index - 1], stamp, stamp)
            };
            let latest = planned.plus(RESERVE_MICROS);
            assert!(slices.may_start(stage, stamp, latest));
            assert!(!slices.may_start(stage, stamp, latest.plus(1)));
        }
    }

    #[test]
    fn the_slowest_stage_is_the_one_furthest_over_its_slice() {
        let slices = Slices::default();
        let mut times = StageTimes::default();
        assert_eq!(slices.slowest(&times), None);
        times.add(Stage::Track, 35_000);
        assert_eq!(slices.slowest(&times), Some(Stage::Track));
        times.add(Stage::Map, 70_000);
        assert_eq!(slices.slowest(&times), Some(Stage::Map));
    }
}
