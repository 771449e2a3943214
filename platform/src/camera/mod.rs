//! Cameras: one file a technology.

pub mod replay;
