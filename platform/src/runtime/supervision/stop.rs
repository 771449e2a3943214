//! SIGTERM and SIGINT: the first asks for an orderly end, a later one ends at once.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rustix::time::{ClockId, clock_gettime};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::low_level;

/// Ends the process without any destructor, for one whose threads cannot be ended.
pub fn end_at_once(code: i32) -> ! {
    // SAFETY: the call takes no pointer and does not return.
    unsafe { libc::_exit(code) }
}

/// Signals that come closer together than this are one: whoever ends a process group often signals its leader besides.
const ONE_REQUEST_MS: u64 = 200;

/// When a signal asked for the end.
#[derive(Debug, Default)]
struct Request {
    /// `CLOCK_MONOTONIC` in milliseconds; 0 before the first signal.
    at_ms: AtomicU64,
}

impl Request {
    /// A signal came; whether it is a second request.
    fn is_repeated(&self, now_ms: u64) -> bool {
        let first = (self.at_ms).compare_exchange(0, now_ms.max(1), Ordering::Relaxed, Ordering::Relaxed);
        first.is_err_and(|first| now_ms.saturating_sub(first) >= ONE_REQUEST_MS)
    }
}

/// Tells whether a signal asked for the end.
#[derive(Clone, Debug)]
pub struct StopRequest(Arc<Request>);

impl StopRequest {
    /// Whether one did.
    #[must_use]
    pub fn is_made(&self) -> bool {
        self.0.at_ms.load(Ordering::Relaxed) > 0
    }
}

/// Sets `stop` at the first SIGTERM or SIGINT; a second one, of either kind, that comes at least `ONE_REQUEST_MS` later ends
/// the process at once with 128 + its number.
///
/// # Errors
/// The handler could not be installed.
pub fn stop_on_signals(stop: &Arc<AtomicBool>) -> io::Result<StopRequest> {
    let request = Arc::<Request>::default();
    for signal in [SIGTERM, SIGINT] {
        let (stop, request) = (Arc::clone(stop), Arc::clone(&request));
        let asked = move || {
            stop.store(true, Ordering::Relaxed);
            if request.is_repeated(monotonic_ms()) {
                low_level::exit(128 + signal);
            }
        };
        // SAFETY: the action reads a clock, touches two atomics and calls `_exit`: all of it may be done in a signal handler.
        unsafe { low_level::register(signal, asked) }?;
    }
    Ok(StopRequest(request))
}

fn monotonic_ms() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    // Never negative: it counts from the start of the machine.
    let seconds = u64::try_from(now.tv_sec).unwrap_or(0);
    seconds * 1_000 + u64::try_from(now.tv_nsec).unwrap_or(0) / 1_000_000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_at_one_time_are_one_request() {
        let request = Request::default();
        let repeated = [10_000, 10_001, 10_199, 10_200].map(|now_ms| request.is_repeated(now_ms));
        assert_eq!(repeated, [false, false, false, true]);
    }
}
