//! What becomes of a part that panics: it is started anew, a few times, and then the process ends.
//!
//! Invariant: a panic never leaves a thread unwinding through its loop; after [`RESTARTS`] of them in a drive the next one
//! ends the drive in order, so that a supervisor can start the process anew. Cost: nothing until a panic.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use freespace::budget::RESTARTS;

use super::rights::ThreadRole;

/// Keeps the panics of real-time threads off standard error, whose lock and device they must not wait for; their events tell
/// of them. Panics of other threads are printed as ever.
pub fn hush_real_time_panics() {
    let print = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let thread = std::thread::current();
        let is_real_time = ThreadRole::REAL_TIME
            .iter()
            .any(|role| thread.name() == Some(role.name()));
        if !is_real_time {
            print(panic);
        }
    }));
}

/// Panics of a drive, counted over all threads.
#[derive(Debug, Default)]
pub(super) struct Restarts {
    panics: AtomicU32,
    is_spent: AtomicBool,
}

impl Restarts {
    /// Notes a panic; whether the part may start anew.
    pub(super) fn may_restart(&self) -> bool {
        let may = self.panics.fetch_add(1, Ordering::Relaxed) < RESTARTS;
        if !may {
            self.is_spent.store(true, Ordering::Relaxed);
        }
        may
    }

    /// Whether a part panicked once too often.
    #[must_use]
    pub(super) fn is_spent(&self) -> bool {
        self.is_spent.load(Ordering::Relaxed)
    }

    /// Panics so far.
    #[must_use]
    pub(super) fn count(&self) -> u32 {
        self.panics.load(Ordering::Relaxed)
    }
}

/// A part panicked; what it was working on must not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Panicked;

/// Runs a part's step; what the step owned is dropped on a panic, and what it borrowed must be renewed before it is used again.
///
/// # Errors
/// It panicked.
pub(super) fn guarded<T>(step: impl FnOnce() -> T) -> Result<T, Panicked> {
    catch_unwind(AssertUnwindSafe(step)).map_err(|_| Panicked)
}
