//! Devices, threads and the program around the `freespace` core.

pub mod runtime;
pub mod segmenter;
pub mod wheels;
