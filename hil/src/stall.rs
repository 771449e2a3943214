//! Whether the rig itself was run in time: a drive on a machine that stands still says nothing about the module.
//!
//! A thread above all others wakes every few milliseconds; what it oversleeps is time that the host gave to somebody else.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use crate::clock::{now_micros, sleep_until};
use crate::feed::spawn;

const PERIOD_MICROS: u64 = 5_000;
/// Above the feeds, which are above the module.
const PRIORITY: u8 = 70;
/// Oversleeping that a test kernel's own timers bring.
const USUAL_MICROS: u64 = 1_000;
/// Longest that a machine fit for a drive stands still: a picture's period.
const LONGEST_MICROS: u64 = 33_000;
/// Part of the time that it stands still.
const LARGEST_SHARE: f64 = 0.02;

/// How the machine stood still.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Stalls {
    /// Longest, microseconds.
    pub(crate) longest_micros: u64,
    /// Part of the time.
    pub(crate) share: f64,
}

impl Stalls {
    /// Whether what was seen may be the machine's doing.
    pub(crate) fn are_grave(&self) -> bool {
        self.longest_micros > LONGEST_MICROS || self.share > LARGEST_SHARE
    }
}

impl fmt::Display for Stalls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the machine stood still for {:.1} % of the time, at most {} ms",
            100.0 * self.share,
            self.longest_micros / 1000
        )
    }
}

#[derive(Default)]
struct Counts {
    is_over: AtomicBool,
    longest: AtomicU64,
    sum: AtomicU64,
}

/// Watches until it is asked.
pub(crate) struct StallWatch {
    counts: Arc<Counts>,
    began: u64,
    thread: Option<JoinHandle<()>>,
}

impl StallWatch {
    /// Begins; a machine without real-time rights is watched from its normal priority.
    pub(crate) fn begin() -> std::io::Result<Self> {
        let counts = Arc::new(Counts::default());
        let own = Arc::clone(&counts);
        let thread = spawn("stall-watch", PRIORITY, move || watch(&own))?;
        Ok(Self {
            counts,
            began: now_micros(),
            thread: Some(thread),
        })
    }

    /// Ends, and tells.
    #[expect(clippy::cast_precision_loss, reason = "minutes in microseconds")]
    pub(crate) fn end(mut self) -> Stalls {
        self.counts.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let all = now_micros().saturating_sub(self.began).max(1);
        Stalls {
            longest_micros: self.counts.longest.load(Ordering::Relaxed),
            share: self.counts.sum.load(Ordering::Relaxed) as f64 / all as f64,
        }
    }
}

fn watch(counts: &Counts) {
    while !counts.is_over.load(Ordering::Relaxed) {
        let wanted = now_micros() + PERIOD_MICROS;
        sleep_until(wanted);
        let late = now_micros().saturating_sub(wanted);
        if late > USUAL_MICROS {
            counts.sum.fetch_add(late, Ordering::Relaxed);
            counts.longest.fetch_max(late, Ordering::Relaxed);
        }
    }
}
