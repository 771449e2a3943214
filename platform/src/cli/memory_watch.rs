//! What the process's memory did while a live run went on.

use std::time::{Duration, Instant};

use crate::runtime::memory::{MemoryPlan, ProcessMemory, library_heap_bytes};
use crate::sink::recording::LiveMemory;

/// By then all that is allocated once has been.
const SETTLED: Duration = Duration::from_secs(10);
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Compares the memory after some seconds with that at the end.
pub(super) struct MemoryWatch {
    planned_bytes: u64,
    begin: Instant,
    settled: Option<Reading>,
    last: Reading,
    looked: Instant,
}

/// The process, and the heap of its libraries.
#[derive(Clone, Copy)]
struct Reading {
    process: ProcessMemory,
    library_heap_bytes: u64,
}

impl Reading {
    fn now() -> Self {
        Self {
            process: ProcessMemory::now(),
            library_heap_bytes: library_heap_bytes(),
        }
    }
}

impl MemoryWatch {
    pub(super) fn new(plan: &MemoryPlan) -> Self {
        Self {
            planned_bytes: plan.total_bytes(),
            begin: Instant::now(),
            settled: None,
            last: Reading::now(),
            looked: Instant::now(),
        }
    }

    /// To be called now and then while the run goes on; what is freed after it does not count.
    pub(super) fn look(&mut self) {
        if self.looked.elapsed() < LOOK_EVERY {
            return;
        }
        self.looked = Instant::now();
        self.last = Reading::now();
        if self.settled.is_none() && self.begin.elapsed() >= SETTLED {
            self.settled = Some(self.last);
        }
    }

    /// The memory when it was looked at last, and what it grew by.
    #[expect(clippy::cast_precision_loss, reason = "megabytes")]
    pub(super) fn finish(&self, page_faults: u64) -> LiveMemory {
        let then = self.settled.unwrap_or(self.last);
        let heap = self.last.library_heap_bytes.cast_signed() - then.library_heap_bytes.cast_signed();
        LiveMemory {
            planned_mb: self.planned_bytes as f64 * 1e-6,
            locked_mb: self.last.process.locked_bytes as f64 * 1e-6,
            rss_growth_mb: self.last.process.resident_growth_since(&then.process) as f64 * 1e-6,
            library_heap_growth_mb: heap as f64 * 1e-6,
            page_faults_after_warm_up: page_faults,
        }
    }
}
