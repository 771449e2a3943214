//! What goes into the network: a tile of the image, resized and normalised.
//!
//! In: [`RgbImage`] or [`GrayImage`] of the size given at construction. Out: `[3, height, width] f32` a tile, in the
//! network's channel order: `(value - mean) * scale`, value in 0..255.
//! Cost: two separable passes a tile, at most [`MAX_TAPS`](crate::budget::MAX_TAPS) taps each.
#![allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^24")]

use alloc::boxed::Box;
use alloc::vec;

use super::resample::{Taps, taps};
use super::{ChannelOrder, NetworkShape, TileConfig, Tiles, tile};
use crate::frame::{GrayImage, RgbImage};

/// Fills network inputs from images of one size.
#[derive(Clone, Debug)]
pub struct InputFiller {
    shape: NetworkShape,
    image_width: usize,
    image_height: usize,
    tiles: Tiles,
    columns: heapless::Vec<Box<[Taps]>, { crate::budget::MAX_TILES }>,
    rows: heapless::Vec<Box<[Taps]>, { crate::budget::MAX_TILES }>,
    /// One image row, rows already summed, `[image_width, 3] f32`.
    line: Box<[f32]>,
}

impl InputFiller {
    /// For images of `image_width x image_height` pixels.
    #[must_use]
    pub fn new(shape: &NetworkShape, image_width: usize, image_height: usize, config: &TileConfig) -> Self {
        let tiles = tile(image_width, image_height, config);
        let (width, height) = (image_width as f32, image_height as f32);
        let columns = tiles
            .iter()
            .map(|t| taps(t.left * width, t.width * width, image_width, shape.width))
            .collect();
        let rows = tiles
            .iter()
            .map(|t| taps(t.top * height, t.height * height, image_height, shape.height))
            .collect();
        Self {
            shape: shape.clone(),
            image_width,
            image_height,
            tiles,
            columns,
            rows,
            line: vec![0.0; image_width * 3].into_boxed_slice(),
        }
    }

    /// The tiles, left to right.
    #[must_use]
    pub const fn tiles(&self) -> &Tiles {
        &self.tiles
    }

    /// Values of one tile's input.
    #[must_use]
    pub const fn len(&self) -> usize {
        3 * self.shape.width * self.shape.height
    }

    /// Whether the network takes nothing.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes tile `index` of a colour image to `input`, `[3, height, width] f32`.
    ///
    /// # Panics
    /// Where the image or `input` is not of the size given at construction, or there is no such tile.
    pub fn fill_rgb(&mut self, image: &RgbImage, index: usize, input: &mut [f32]) {
        assert!(image.width() == self.image_width && image.height() == self.image_height);
        self.fill(index, input, |y, weight, line| {
            for (sum, &byte) in line.iter_mut().zip(image.row(y)) {
                *sum += weight * f32::from(byte);
            }
        });
    }

    /// Writes tile `index` of a gray image, its luma in all three channels.
    ///
    /// # Panics
    /// As [`Self::fill_rgb`].
    pub fn fill_gray(&mut self, image: &GrayImage, index: usize, input: &mut [f32]) {
        assert!(image.width() == self.image_width && image.height() == self.image_height);
        self.fill(index, input, |y, weight, line| {
            for (sum, &byte) in line.chunks_exact_mut(3).zip(image.row(y)) {
                let value = weight * f32::from(byte);
                sum[0] += value;
                sum[1] += value;
                sum[2] += value;
            }
        });
    }

    fn fill(&mut self, index: usize, input: &mut [f32], add_row: impl Fn(usize, f32, &mut [f32])) {
        let NetworkShape {
            width,
            height,
            mean,
            scale,
            order,
            ..
        } = self.shape;
        assert!(input.len() == 3 * width * height);
        let (red, rest) = input.split_at_mut(width * height);
        let (green, blue) = rest.split_at_mut(width * height);
        let planes = match order {
            ChannelOrder::Rgb => [red, green, blue],
            ChannelOrder::Bgr => [blue, green, red],
        };
        // Mean and scale are in the network's channel order; `planes` is in the image's.
        let of = |values: [f32; 3]| match order {
            ChannelOrder::Rgb => values,
            ChannelOrder::Bgr => [values[2], values[1], values[0]],
        };
        let (mean, scale) = (of(mean), of(scale));
        for (y, row_taps) in self.rows[index].iter().enumerate() {
            self.line.fill(0.0);
            for (source_y, weight) in row_taps.iter() {
                add_row(source_y, weight, &mut self.line);
            }
            for (x, column_taps) in self.columns[index].iter().enumerate() {
                let mut sum = [0.0; 3];
                for (source_x, weight) in column_taps.iter() {
                    let pixel = &self.line[3 * source_x..3 * source_x + 3];
                    sum[0] += weight * pixel[0];
                    sum[1] += weight * pixel[1];
                    sum[2] += weight * pixel[2];
                }
                for channel in 0..3 {
                    planes[channel][y * width + x] = (sum[channel] - mean[channel]) * scale[channel];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segmentation::tests::shape;
    use alloc::vec::Vec;

    #[test]
    fn channels_are_normalised_in_the_networks_order() {
        let mut image = RgbImage::new(40, 30);
        for pixel in image.pixels_mut().chunks_exact_mut(3) {
            pixel.copy_from_slice(&[200, 100, 50]);
        }
        let mut shape = shape();
        shape.order = ChannelOrder::Bgr;
        shape.mean = [10.0, 20.0, 30.0];
        shape.scale = [0.1, 0.2, 0.5];
        let mut filler = InputFiller::new(&shape, 40, 30, &TileConfig::default());
        let mut input: Vec<f32> = alloc::vec![f32::NAN; filler.len()];
        filler.fill_rgb(&image, 0, &mut input);
        let plane = shape.width * shape.height;
        for (channel, expected) in [4.0, 16.0, 85.0].into_iter().enumerate() {
            assert!(
                input[channel * plane..(channel + 1) * plane]
                    .iter()
                    .all(|v| (v - expected).abs() < 1e-2)
            );
        }
    }

    #[test]
    fn gray_equals_colour_of_equal_channels() {
        let mut gray = GrayImage::new(90, 30);
        let mut rgb = RgbImage::new(90, 30);
        for (i, byte) in gray.pixels_mut().iter_mut().enumerate() {
            *byte = u8::try_from(i * 31 % 256).unwrap_or(0);
            rgb.pixels_mut()[3 * i..3 * i + 3].fill(*byte);
        }
        let mut filler = InputFiller::new(&shape(), 90, 30, &TileConfig::default());
        for index in 0..filler.tiles().len() {
            let (mut a, mut b) = (alloc::vec![0.0; filler.len()], alloc::vec![0.0; filler.len()]);
            filler.fill_gray(&gray, index, &mut a);
            filler.fill_rgb(&rgb, index, &mut b);
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-4));
        }
    }
}
