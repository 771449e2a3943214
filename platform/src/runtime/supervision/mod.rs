//! What watches the program from outside: the service manager, told how it goes, and signals, that end it.
//!
//! All of it runs on the monitor's thread: nothing here is for a real-time one.

mod notify;
mod stop;
#[cfg(test)]
mod unit_tests;

pub use notify::{Notifier, STATUS_BYTES, Watchdog};
pub use stop::{StopRequest, end_at_once, stop_on_signals};
