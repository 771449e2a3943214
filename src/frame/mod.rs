//! Stage 1, frame: pixels in; luma pyramid, small RGB and the lens out.
//!
//! In: a [`RawFrame`] of the configured size. Out: the luma [`Pyramid`] of this frame and of the last sound one before it;
//! a key frame's picture in RGB comes of [`RawFrame::rgb_into`]. Invariant: the previous pyramid is never that of a frame with
//! an [`ImageFault`], so tracking goes on over a bad frame. Cost: a few passes over the pixels; nothing is allocated.
//!
//! The image is never warped: points are undistorted by the [`Lens`], and a [`RayTable`] holds each pixel's unit ray.

mod colour;
mod condition;
mod format;
mod image;
mod lens;
mod pyramid;
mod ray_table;

pub use condition::{ImageFault, image_fault};
pub use format::{FrameError, PixelFormat, RawFrame};
pub use image::{GrayImage, RgbImage};
pub use lens::{BrownConrady, KannalaBrandt, Lens};
pub use pyramid::Pyramid;
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
        self.lens
            .scaled(scale(width, self.width), scale(height, self.height))
    }
}

/// The stage: two pyramids that change places.
#[derive(Clone, Debug)]
pub struct FrameStage {
    current: Pyramid,
    previous: Pyramid,
    /// Whether `current` and `previous` hold sound frames.
    current_sound: bool,
    previous_sound: bool,
}

impl FrameStage {
    /// Buffers for the camera's frames.
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        Self {
            current: Pyramid::new(camera.width, camera.height),
            previous: Pyramid::new(camera.width, camera.height),
            current_sound: false,
            previous_sound: false,
        }
    }

    /// Takes a frame in. With a fault, [`FrameStage::pyramid`] shows the faulty frame, and the next frame replaces it.
    ///
    /// # Errors
    /// When the frame's size or length is wrong; the stage is as it was before.
    pub fn step(&mut self, raw: &RawFrame<'_>) -> Result<Option<ImageFault>, FrameError> {
        if self.current_sound {
            core::mem::swap(&mut self.current, &mut self.previous);
        }
        if let Err(error) = raw.luma_into(self.current.base_mut()) {
            if self.current_sound {
                core::mem::swap(&mut self.current, &mut self.previous);
            }
            return Err(error);
        }
        self.previous_sound |= self.current_sound;
        self.current.build();
        let fault = image_fault(&self.current, self.previous_sound.then_some(&self.previous));
        self.current_sound = fault.is_none();
        Ok(fault)
    }

    /// Pyramid of the newest frame.
    #[must_use]
    pub const fn pyramid(&self) -> &Pyramid {
        &self.current
    }

    /// Pyramid of the last sound frame before the newest; black before there was one.
    #[must_use]
    pub const fn previous_pyramid(&self) -> &Pyramid {
        &self.previous
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::space::Micros;
    use alloc::vec::Vec;

    #[test]
    fn a_bad_frame_does_not_replace_the_last_sound_one() {
        let camera = Camera {
            lens: Lens::pinhole(100.0, 100.0, 32.0, 24.0),
            width: 64,
            height: 48,
            mount: Mount {
                height_m: 1.5,
                ahead_m: 0.0,
                left_m: 0.0,
                pitch_rad: 0.0,
                yaw_rad: 0.0,
                roll_rad: 0.0,
            },
        };
        let mut stage = FrameStage::new(&camera);
        let pattern = |shift: usize| -> Vec<u8> {
            (0..64 * 48)
                .map(|i| {
                    if ((i % 64 + shift) / 8).is_multiple_of(2) {
                        40
                    } else {
                        160
                    }
                })
                .collect()
        };
        let frames = [
            pattern(0),
            pattern(1),
            alloc::vec![0; 64 * 48],
            pattern(1),
            pattern(2),
        ];
        let faults = [
            None,
            None,
            Some(ImageFault::Black),
            Some(ImageFault::Frozen),
            None,
        ];
        for (bytes, fault) in frames.iter().zip(faults) {
            let raw = RawFrame {
                stamp: Micros(0),
                format: PixelFormat::Grey,
                width: 64,
                height: 48,
                bytes,
            };
            assert_eq!(stage.step(&raw), Ok(fault));
            let torn = RawFrame {
                bytes: &bytes[1..],
                ..raw
            };
            assert_eq!(stage.step(&torn), Err(FrameError::WrongLength));
            assert_eq!(stage.pyramid().base().pixels(), &bytes[..]);
        }
        assert_eq!(stage.previous_pyramid().base().pixels(), &frames[1][..]);
    }
}
