//! Reads the free-space grid that the module publishes in shared memory, from Rust, C ([`c`], `include/freespace.h`) or Python
//! (`include/freespace.py`).
//!
//! In: the name of the module's service. Out: [`Message`]s, in place, read-only. Invariant: a reader never keeps the module
//! waiting; one that is slow misses messages (a gap in `sequence`) and then gets the newest. **Unknown is not free**: only cells
//! of an occupancy of 0 to 35 are. Cost: one wake-up a message, no copy.

pub mod bindings;
pub mod c;
mod error;
mod reader;
pub mod service;

pub use error::ReaderError;
pub use freespace::emit::SharedMessage;
pub use reader::{Message, Reader, monotonic_now};
