//! Cameras: one file a technology.

pub mod replay;
mod sim;
pub mod v4l2;

pub use sim::{SimFrames, seconds_at};
