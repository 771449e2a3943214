//! Clocks: one that runs, one that stands.

mod frozen;
mod monotonic;

pub use frozen::FrozenClock;
pub use monotonic::MonotonicClock;
