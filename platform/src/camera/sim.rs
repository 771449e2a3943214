//! The camera of the simulated road.

use std::sync::Arc;

use freespace::frame::{Camera, GrayImage, PixelFormat, RgbImage};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::space::Micros;

use crate::world::{Sensor, SimCamera, World};

/// Renders a frame each period until the drive ends.
pub struct SimFrames {
    world: Arc<World>,
    camera: SimCamera,
    picture: Picture,
    frame_rate_hz: f64,
    frames: u64,
    next: u64,
}

enum Picture {
    Colour(RgbImage),
    Gray(GrayImage),
}

impl SimFrames {
    /// A camera that drives through `world` for `seconds`.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a number of frames"
    )]
    pub fn new(
        world: Arc<World>,
        camera: &Camera,
        sensor: &Sensor,
        is_gray: bool,
        frame_rate_hz: f64,
        seconds: f64,
    ) -> Self {
        let (width, height) = (camera.width, camera.height);
        Self {
            world,
            camera: SimCamera::new(camera, sensor),
            picture: if is_gray {
                Picture::Gray(GrayImage::new(width, height))
            } else {
                Picture::Colour(RgbImage::new(width, height))
            },
            frame_rate_hz,
            frames: (seconds.max(0.0) * frame_rate_hz).ceil() as u64,
            next: 0,
        }
    }

    /// The camera, to be cloned for what looks through it too.
    #[must_use]
    pub const fn camera(&self) -> &SimCamera {
        &self.camera
    }

    /// Frames of the whole drive.
    #[must_use]
    pub fn len(&self) -> usize {
        usize::try_from(self.frames).unwrap_or(usize::MAX)
    }

    /// Whether the drive ends before its first frame.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.frames == 0
    }
}

/// Seconds of the world at a stamp.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "2^52 us are 142 years")]
pub fn seconds_at(stamp: Micros) -> f64 {
    stamp.0 as f64 * 1e-6
}

impl SimFrames {
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "stamps"
    )]
    fn stamp(&self, index: u64) -> Micros {
        Micros((index as f64 / self.frame_rate_hz * 1e6).round() as u64)
    }
}

impl CameraPort for SimFrames {
    fn skip_before(&mut self, now: Micros) -> u64 {
        let first = self.next;
        while self.next + 1 < self.frames && self.stamp(self.next + 1) <= now {
            self.next += 1;
        }
        self.next - first
    }

    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        if self.next >= self.frames {
            return CameraAnswer::End;
        }
        buffer.stamp = self.stamp(self.next);
        buffer.index = self.next;
        buffer.key_frame_wanted = false;
        self.next += 1;
        let seconds = seconds_at(buffer.stamp);
        let (bytes, width, height) = match &mut self.picture {
            Picture::Colour(image) => {
                self.camera.render(&self.world, seconds, image);
                buffer.format = PixelFormat::Rgb24;
                (image.pixels(), image.width(), image.height())
            }
            Picture::Gray(image) => {
                self.camera.render_gray(&self.world, seconds, image);
                buffer.format = PixelFormat::Grey;
                (image.pixels(), image.width(), image.height())
            }
        };
        (buffer.width, buffer.height) = (width, height);
        buffer.bytes.clear();
        buffer.bytes.extend_from_slice(bytes);
        CameraAnswer::Frame
    }
}
