//! A lens from pictures of a chessboard.
//!
//! In: a folder of pictures of one size, the board, the lens model. Out: the lens with the spread of its parameters, every
//! picture's error, and in words what the pictures lack. Invariant: corners are looked for in each picture alone, and the
//! same pictures give the same lens. Cost: some 0.1 s a picture of a megapixel, then a few dozen steps over all corners.
//! Source: Zhang 2000 for the start, Levenberg-Marquardt over all parameters for the rest.

mod board;
pub mod corners;
mod folder;
mod normal;
mod parameters;
pub mod picture;
pub mod refine;
pub mod report;
mod start;
mod zhang;

pub use board::{Board, Sighting, View};
pub use folder::{Outcome, Picture, read_folder};
pub use refine::{Calibration, calibrate};
pub use report::{Finding, Report};

#[cfg(test)]
mod render;
#[cfg(test)]
mod tests;
