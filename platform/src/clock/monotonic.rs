//! The monotonic clock: as it is for devices, whose stamps are its own, or set to read a recording's first stamp when the run starts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use freespace::port::Clock;
use freespace::space::Micros;
use rustix::time::{ClockId, clock_gettime};

/// Reads `CLOCK_MONOTONIC`, shifted to the stamps of the source.
#[derive(Clone, Debug)]
pub struct MonotonicClock {
    /// Added to `CLOCK_MONOTONIC`.
    offset_micros: Arc<AtomicU64>,
    is_settable: bool,
}

impl Default for MonotonicClock {
    /// A clock for sources with stamps of their own: it reads 0 now, until [`MonotonicClock::start_at`] sets it.
    fn default() -> Self {
        Self {
            offset_micros: Arc::new(AtomicU64::new(0_u64.wrapping_sub(monotonic_micros()))),
            is_settable: true,
        }
    }
}

impl MonotonicClock {
    /// `CLOCK_MONOTONIC` itself, for devices that stamp with it.
    #[must_use]
    pub fn of_devices() -> Self {
        Self {
            offset_micros: Arc::new(AtomicU64::new(0)),
            is_settable: false,
        }
    }

    /// Whether it is the clock that devices stamp with, and runs before their first stamp.
    #[must_use]
    pub const fn is_of_devices(&self) -> bool {
        !self.is_settable
    }

    /// Sets a recording's clock to read `stamp` now; the clock of devices stays as it is.
    pub fn start_at(&self, stamp: Micros) {
        if self.is_settable {
            let offset = stamp.0.wrapping_sub(monotonic_micros());
            self.offset_micros.store(offset, Ordering::Release);
        }
    }

    /// Sleeps until the clock reads `stamp`.
    pub fn sleep_until(&self, stamp: Micros) {
        let left = stamp.since(self.now());
        if left > 0 {
            std::thread::sleep(Duration::from_micros(left));
        }
    }

    /// How long from now until `stamp`.
    #[must_use]
    pub fn until(&self, stamp: Micros) -> Duration {
        Duration::from_micros(stamp.since(self.now()))
    }
}

impl Clock for MonotonicClock {
    fn now(&self) -> Micros {
        Micros(monotonic_micros().wrapping_add(self.offset_micros.load(Ordering::Acquire)))
    }
}

fn monotonic_micros() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    // Never negative: it counts from the start of the machine.
    let seconds = u64::try_from(now.tv_sec).unwrap_or(0);
    let nanos = u64::try_from(now.tv_nsec).unwrap_or(0);
    seconds * 1_000_000 + nanos / 1_000
}
