//! Devices, threads and the program around the `freespace` core.

pub mod clock;
pub mod runtime;
pub mod segmenter;
pub mod wheels;
pub mod world;
