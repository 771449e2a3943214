//! SIGTERM and SIGINT: the first asks for an orderly end, the second ends at once.

use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Ends the process without any destructor, for one whose threads cannot be ended.
pub fn end_at_once(code: i32) -> ! {
    // SAFETY: the call takes no pointer and does not return.
    unsafe { libc::_exit(code) }
}

/// Sets `stop` at the first SIGTERM or SIGINT; a second one, of either kind, ends the process at once with 128 + its number.
///
/// # Errors
/// The handler could not be installed.
pub fn stop_on_signals(stop: &Arc<AtomicBool>) -> io::Result<()> {
    for signal in [SIGTERM, SIGINT] {
        // Handlers run in this order: the first looks at the flag before the second sets it.
        flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(stop))?;
        flag::register(signal, Arc::clone(stop))?;
    }
    Ok(())
}
