//! The rig's clock: `CLOCK_MONOTONIC` in microseconds, as the module stamps with.

use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// `CLOCK_MONOTONIC`, microseconds.
pub(crate) fn now_micros() -> u64 {
    let time = clock_gettime(ClockId::Monotonic);
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    seconds * 1_000_000 + u64::try_from(time.tv_nsec).unwrap_or(0) / 1_000
}

/// Sleeps until the clock reads `at`; returns at once where it does already.
pub(crate) fn sleep_until(at: u64) {
    let left = at.saturating_sub(now_micros());
    if left > 0 {
        std::thread::sleep(Duration::from_micros(left));
    }
}
