//! What a configuration must be told of camera and wheels, found from pictures and recordings: lens, mount, metres a count.
//!
//! None of it runs in a drive: it may allocate, and takes the time it takes.

pub mod import;
pub mod lens;
pub mod mount;
pub mod robust;
pub mod survey;
mod table;
#[cfg(test)]
mod tests;
pub mod ticks;

pub use table::{lens_table, mount_table};
