//! What the benchmarks share: the processor time of this thread, medians, and where the data sets are.
#![allow(
    dead_code,
    reason = "each benchmark is a program of its own and takes what it needs"
)]

use std::path::{Path, PathBuf};

use freespace::port::Clock;
use freespace::space::Micros;

/// Processor time of the calling thread: what other programs take of a shared machine does not count.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ThreadClock;

impl Clock for ThreadClock {
    #[expect(clippy::cast_sign_loss, reason = "processor time is positive")]
    fn now(&self) -> Micros {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        Micros(time.tv_sec as u64 * 1_000_000 + time.tv_nsec as u64 / 1000)
    }
}

/// The value below which `percent` of all lie.
#[must_use]
pub(crate) fn percentile(values: &[u64], percent: usize) -> u64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable();
    let last = sorted.len().saturating_sub(1);
    sorted.get(last * percent / 100).copied().unwrap_or(0)
}

/// A data set's folder; none, and a line that says so, where it is absent.
#[must_use]
pub(crate) fn data(benchmark: &str, folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("FREESPACE_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let found = root.join(folder);
    if found.is_dir() {
        return Some(found);
    }
    println!("SKIPPED {benchmark}: {} is absent", found.display());
    None
}
