//! The monotonic clock, set so that it reads a source's first stamp when the run starts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use freespace::port::Clock;
use freespace::space::Micros;

/// Reads `CLOCK_MONOTONIC`, shifted to the stamps of the source.
#[derive(Clone, Debug)]
pub struct MonotonicClock {
    origin: Instant,
    /// What the clock read at `origin`.
    offset_micros: Arc<AtomicU64>,
}

impl Default for MonotonicClock {
    fn default() -> Self {
        Self {
            origin: Instant::now(),
            offset_micros: Arc::new(AtomicU64::new(0)),
        }
    }
}

impl MonotonicClock {
    /// Sets the clock to read `stamp` now.
    pub fn start_at(&self, stamp: Micros) {
        let offset = stamp.0.wrapping_sub(self.elapsed());
        self.offset_micros.store(offset, Ordering::Release);
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

    fn elapsed(&self) -> u64 {
        u64::try_from(self.origin.elapsed().as_micros()).unwrap_or(u64::MAX)
    }
}

impl Clock for MonotonicClock {
    fn now(&self) -> Micros {
        Micros(
            self.elapsed()
                .wrapping_add(self.offset_micros.load(Ordering::Acquire)),
        )
    }
}
