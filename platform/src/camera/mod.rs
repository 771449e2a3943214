//! Cameras: one file a technology.

pub mod replay;
mod sim;

pub use sim::{SimFrames, seconds_at};
