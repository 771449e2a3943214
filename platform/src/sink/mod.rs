//! Sinks: where results go; one folder or file a technology.

pub mod recording;
mod socketcan;

pub use socketcan::SocketcanSink;
