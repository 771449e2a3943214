//! Devices, threads and the program around the `freespace` core.

pub mod bad_input;
pub mod calibrate;
pub mod camera;
pub mod can;
pub mod cli;
pub mod clock;
pub mod config;
pub mod doctor;
pub mod eval;
pub mod monitor;
mod page;
pub mod runtime;
pub mod segmenter;
pub mod sink;
pub mod statistics;
pub mod view;
pub mod wheels;
pub mod whole_file;
pub mod world;
