//! Stage 1, frame: pixels in; luma pyramid, small RGB and the lens out.
//!
//! The image is never warped: points are undistorted by the [`Lens`], and a [`RayTable`] holds each pixel's unit ray.

mod image;
mod lens;
mod ray_table;

pub use image::{GrayImage, RgbImage};
pub use lens::{BrownConrady, KannalaBrandt, Lens};
pub use ray_table::RayTable;

use crate::space::Mount;

/// What the pipeline must know of the camera: its lens, its image size and its place on the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Projection between camera space and the full-size image.
    pub lens: Lens,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Place on the vehicle.
    pub mount: Mount,
}
