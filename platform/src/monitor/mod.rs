//! `freespace monitor`: a process of its own that watches a module through shared memory, and can do nothing to it.
//!
//! In: the module's messages, and its views where it shows some; the computer's temperatures. Out: a terminal view, text, JSON, a web page, metrics, all
//! made of one [`State`]. Invariant: what the module has not said lately is marked as old, never shown as if it were now;
//! everything kept has a bound ([`HISTORY`], [`MISSES`]). Cost: one copy of a grid a message. A monitor that is slow misses
//! messages, and counts them.

mod follow;
mod metrics;
mod plain;
#[cfg(test)]
mod promtool_tests;
mod snapshot;
mod state;
mod temperatures;
mod terminal;
#[cfg(test)]
mod tests;
mod web;

pub use follow::{Follower, Shared, follow, lock};
pub use metrics::render as render_metrics;
pub use plain::render as render_plain;
pub use snapshot::{Link, Snapshot};
pub use state::{HISTORY, Layer, MISSES, Now, State};
pub use temperatures::{SENSORS, Temperatures, Thermometer, Zone, measure, read as read_temperatures};
pub use terminal::{draw, run as run_terminal};
pub use web::{ServeError, Server};
