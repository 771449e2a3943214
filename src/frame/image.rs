//! Images: row-major, unpadded, sized once.

use alloc::boxed::Box;
use alloc::vec;

/// One luma byte a pixel, `[height, width] u8`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrayImage {
    width: usize,
    height: usize,
    pixels: Box<[u8]>,
}

/// Three bytes a pixel, `[height, width, 3] u8`, red first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbImage {
    width: usize,
    height: usize,
    pixels: Box<[u8]>,
}

macro_rules! image {
    ($name:ident, $channels:literal) => {
        impl $name {
            /// A black image.
            #[must_use]
            pub fn new(width: usize, height: usize) -> Self {
                Self {
                    width,
                    height,
                    pixels: vec![0; width * height * $channels].into_boxed_slice(),
                }
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

            /// All bytes, row by row.
            #[must_use]
            pub fn pixels(&self) -> &[u8] {
                &self.pixels
            }

            /// All bytes, row by row.
            pub fn pixels_mut(&mut self) -> &mut [u8] {
                &mut self.pixels
            }

            /// The bytes of row `y`.
            #[must_use]
            pub fn row(&self, y: usize) -> &[u8] {
                &self.pixels[y * self.width * $channels..(y + 1) * self.width * $channels]
            }

            /// The bytes of row `y`.
            pub fn row_mut(&mut self, y: usize) -> &mut [u8] {
                &mut self.pixels[y * self.width * $channels..(y + 1) * self.width * $channels]
            }
        }
    };
}

image!(GrayImage, 1);
image!(RgbImage, 3);
