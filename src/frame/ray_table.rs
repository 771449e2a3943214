//! The unit ray of every pixel, computed once.

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::{Vector2, Vector3};

use super::Lens;

/// Unit rays in camera space at a working resolution, `[height, width, 3] f32`.
///
/// A pixel the lens model does not reach has the zero ray, which meets nothing.
#[derive(Clone, Debug)]
pub struct RayTable {
    width: usize,
    height: usize,
    rays: Box<[Vector3<f32>]>,
}

impl RayTable {
    /// Rays of an image of `width x height` pixels that `lens` was scaled to.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "pixel coordinates are far below 2^24")]
    pub fn new(lens: &Lens, width: usize, height: usize) -> Self {
        let mut rays = vec![Vector3::zeros(); width * height].into_boxed_slice();
        for y in 0..height {
            for x in 0..width {
                if let Some(ray) = lens.unproject(&Vector2::new(x as f64, y as f64)) {
                    rays[y * width + x] = ray.cast();
                }
            }
        }
        Self { width, height, rays }
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// All rays, row by row.
    #[must_use]
    pub fn rays(&self) -> &[Vector3<f32>] {
        &self.rays
    }
}
