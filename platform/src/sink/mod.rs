//! Sinks: where results go; one folder or file a technology.

pub mod mcap;
pub mod recording;
pub mod shared_memory;
mod socketcan;

pub use socketcan::SocketcanSink;
