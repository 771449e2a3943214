//! Stage 1, frame: pixels in; luma pyramid, small RGB and the lens out.
//!
//! The image is never warped: points are undistorted by the [`Lens`], and a [`RayTable`] holds each pixel's unit ray.

mod image;
mod lens;
mod ray_table;

pub use image::{GrayImage, RgbImage};
pub use lens::{BrownConrady, KannalaBrandt, Lens};
pub use ray_table::RayTable;

use crate::space::{Mount, Pose};

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

impl Camera {
    /// The vehicle's pose, from the camera's.
    #[must_use]
    pub fn world_from_vehicle(&self, world_from_camera: &Pose) -> Pose {
        world_from_camera * self.mount.vehicle_from_camera().inverse()
    }

    /// The lens of this camera's picture scaled to another size.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
    pub fn lens_at(&self, width: usize, height: usize) -> Lens {
        let scale = |to: usize, from: usize| to as f64 / from.max(1) as f64;
        self.lens.scaled(scale(width, self.width), scale(height, self.height))
    }
}
