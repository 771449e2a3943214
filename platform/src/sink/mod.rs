//! Sinks: where results go; one folder or file a technology.

pub mod recording;
