//! How long to wait until an interface is tried again: from a tenth of a second, doubled each time, to a second.
//!
//! In: failures and successes. Out: the time of the next attempt. Invariant: never longer than [`LONGEST_NS`], so that an adapter
//! that was plugged in again is taken within a second; never so short that a missing one costs more than ten calls a second.

/// First wait.
pub(super) const SHORTEST_NS: u64 = 100_000_000;
/// Longest wait.
pub(super) const LONGEST_NS: u64 = 1_000_000_000;

/// Waits that grow.
#[derive(Clone, Copy, Debug)]
pub(super) struct BackOff {
    wait_ns: u64,
    next_ns: u64,
}

impl Default for BackOff {
    /// The first attempt may be made at once.
    fn default() -> Self {
        Self {
            wait_ns: SHORTEST_NS,
            next_ns: 0,
        }
    }
}

impl BackOff {
    /// When the next attempt may be made.
    pub(super) const fn next_ns(&self) -> u64 {
        self.next_ns
    }

    /// An attempt failed at `now_ns`.
    pub(super) fn failed(&mut self, now_ns: u64) {
        self.next_ns = now_ns.saturating_add(self.wait_ns);
        self.wait_ns = (2 * self.wait_ns).min(LONGEST_NS);
    }

    /// An attempt succeeded.
    pub(super) fn succeeded(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_to_a_second_and_start_over() {
        let mut back_off = BackOff::default();
        assert_eq!(back_off.next_ns(), 0);
        let mut now = 0;
        let mut waits = Vec::new();
        for _ in 0..6 {
            back_off.failed(now);
            waits.push((back_off.next_ns() - now) / 1_000_000);
            now = back_off.next_ns();
        }
        assert_eq!(waits, [100, 200, 400, 800, 1000, 1000]);
        back_off.succeeded();
        back_off.failed(now);
        assert_eq!(back_off.next_ns() - now, SHORTEST_NS);
    }
}
