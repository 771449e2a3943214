//! `freespace doctor`: what of this computer stands in the way of the promise, each with its fix.
//!
//! In: the files of `/proc`, `/sys` and `/dev` (under any root, so that a test can show others), a configuration, and the
//! pipeline it describes, which is constructed, locked and timed as a run would. Out: a [`Check`] each, the memory plan and the
//! jitter of the publisher's timer. Invariant: nothing is changed that outlives the process. Cost: the jitter test's seconds,
//! and the network's start.

mod can;
mod devices;
mod jitter;
mod kernel;
mod network;
mod processor;
mod rights;
mod system;

pub use can::{can_interfaces, can_stamps};
pub use devices::{bitrate_by_ip, camera, can, shared_memory};
pub use jitter::{Jitter, JitterError, PERIOD_MICROS, measure_jitter};
pub use kernel::{huge_pages, kernel, swap, throttling};
pub use network::{NetworkTiming, network};
pub use processor::{governor, interrupts};
pub use rights::{memory_lock, priorities};
pub use system::System;

/// Verdict of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// As it should be.
    Ok,
    /// The promise may be kept, with less room; or a device is missing that some runs do without.
    Warning,
    /// The promise cannot be kept like this.
    Fails,
}

impl State {
    /// The word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Fails => "FAILS",
        }
    }
}

/// One thing looked at.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Check {
    /// What was looked at.
    pub name: &'static str,
    /// Verdict.
    pub state: State,
    /// What was seen.
    pub seen: String,
    /// What mends it; none where nothing is to mend.
    pub fix: Option<String>,
}

impl Check {
    /// As it should be.
    #[must_use]
    pub fn ok(name: &'static str, seen: impl Into<String>) -> Self {
        Self {
            name,
            state: State::Ok,
            seen: seen.into(),
            fix: None,
        }
    }

    /// Less than it could be.
    #[must_use]
    pub fn warning(name: &'static str, seen: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            name,
            state: State::Warning,
            seen: seen.into(),
            fix: Some(fix.into()),
        }
    }

    /// In the way of the promise.
    #[must_use]
    pub fn fails(name: &'static str, seen: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            name,
            state: State::Fails,
            seen: seen.into(),
            fix: Some(fix.into()),
        }
    }
}

#[cfg(test)]
mod tests;
