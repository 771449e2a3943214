//! What the process's memory did while a live run went on.

use std::time::{Duration, Instant};

use crate::runtime::memory::{MemoryPlan, ProcessMemory, library_heap_bytes};
use crate::sink::recording::LiveMemory;

/// By then all that is allocated once has been.
const SETTLED: Duration = Duration::from_secs(10);

/// Compares the memory after some seconds with that at the end.
pub(super) struct MemoryWatch {
    planned_bytes: u64,
    begin: Instant,
    settled: Option<(ProcessMemory, u64)>,
}

impl MemoryWatch {
    pub(super) fn new(plan: &MemoryPlan) -> Self {
        Self {
            planned_bytes: plan.total_bytes(),
            begin: Instant::now(),
            settled: None,
        }
    }

    /// To be called now and then.
    pub(super) fn look(&mut self) {
        if self.settled.is_none() && self.begin.elapsed() >= SETTLED {
            self.settled = Some((ProcessMemory::now(), library_heap_bytes()));
        }
    }

    /// The memory now, and what it grew by.
    #[expect(clippy::cast_precision_loss, reason = "megabytes")]
    pub(super) fn finish(&self, page_faults: u64) -> LiveMemory {
        let now = ProcessMemory::now();
        let (rss_growth, heap_growth) = self.settled.as_ref().map_or((0, 0), |(then, heap_then)| {
            let heap = library_heap_bytes().cast_signed() - heap_then.cast_signed();
            (now.resident_growth_since(then), heap)
        });
        LiveMemory {
            planned_mb: self.planned_bytes as f64 * 1e-6,
            locked_mb: now.locked_bytes as f64 * 1e-6,
            rss_growth_mb: rss_growth as f64 * 1e-6,
            library_heap_growth_mb: heap_growth as f64 * 1e-6,
            page_faults_after_warm_up: page_faults,
        }
    }
}
