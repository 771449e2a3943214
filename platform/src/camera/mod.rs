//! Cameras: one file a technology.

#[cfg(test)]
mod conformance;
pub mod replay;
mod sim;
pub mod v4l2;

pub use sim::{SimFrames, seconds_at};
