//! Page faults of real-time threads once they are warm: with all memory locked there must be none.
//!
//! Cost: one system call a round, which reads counters of the thread itself.

use std::sync::atomic::{AtomicU64, Ordering};

use super::memory::PageFaults;

/// Counts the faults of the thread that looks.
pub(super) struct FaultMeter {
    rounds_to_warm: u32,
    seen: PageFaults,
}

impl FaultMeter {
    /// A thread is warm after so many rounds of its loop.
    pub(super) fn warm_after(rounds: u32) -> Self {
        Self {
            rounds_to_warm: rounds,
            seen: PageFaults::default(),
        }
    }

    /// Called once a round: adds what a warm thread faulted since the last one.
    pub(super) fn look(&mut self, counter: &AtomicU64) {
        let now = PageFaults::of_this_thread();
        if self.rounds_to_warm > 0 {
            self.rounds_to_warm -= 1;
        } else {
            counter.fetch_add(now.since(&self.seen).total(), Ordering::Relaxed);
        }
        self.seen = now;
    }
}
