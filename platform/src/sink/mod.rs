//! Sinks: where results go; one folder or file a technology.

pub mod recording;
pub mod shared_memory;
mod socketcan;

pub use socketcan::SocketcanSink;
