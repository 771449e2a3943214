//! Luma pyramid: each level the 2x2 average of the one below.
//!
//! In: luma `[H, W] u8`. Out: at most [`PYRAMID_LEVELS`] levels, level `l` being `[H >> l, W >> l] u8`.
//! Invariant: pixel `x` of level 0 lies at `(x + 0.5) / 2^l - 0.5` of level `l`. Cost: 4/3 of the pixels, once.
//! A level that would be smaller than [`MIN_SIDE_PX`] is left out.
#![allow(
    clippy::cast_possible_truncation,
    reason = "pixel arithmetic: an average of bytes is a byte"
)]

use alloc::boxed::Box;
use alloc::vec::Vec;

use super::GrayImage;
use crate::budget::PYRAMID_LEVELS;

/// Smallest side of a level: a tracking window and its margin.
const MIN_SIDE_PX: usize = 24;

/// Levels of one image, finest first.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Box<[GrayImage]>,
}

impl Pyramid {
    /// A black pyramid over an image of `width x height` pixels.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let levels: Vec<GrayImage> = (0..PYRAMID_LEVELS)
            .map(|level| (width >> level, height >> level))
            .take_while(|(w, h)| (w.min(h) >= &MIN_SIDE_PX) || (*w == width && *h == height))
            .map(|(w, h)| GrayImage::new(w, h))
            .collect();
        Self {
            levels: levels.into_boxed_slice(),
        }
    }

    /// All levels, finest first; at least one.
    #[must_use]
    pub fn levels(&self) -> &[GrayImage] {
        &self.levels
    }

    /// The full-size image.
    #[must_use]
    pub fn base(&self) -> &GrayImage {
        &self.levels[0]
    }

    /// The full-size image, to be followed by [`Pyramid::build`].
    pub fn base_mut(&mut self) -> &mut GrayImage {
        &mut self.levels[0]
    }

    /// Computes every level from the full-size image.
    pub fn build(&mut self) {
        for level in 1..self.levels.len() {
            let (below, above) = self.levels.split_at_mut(level);
            halve(&below[level - 1], &mut above[0]);
        }
    }
}

fn halve(from: &GrayImage, to: &mut GrayImage) {
    let width = to.width();
    for y in 0..to.height() {
        let upper = &from.row(2 * y)[..2 * width];
        let lower = &from.row(2 * y + 1)[..2 * width];
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        for (out, (a, b)) in to.row_mut(y).iter_mut().zip(pairs) {
            let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
            *out = ((sum + 2) >> 2) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_two_averages_sixteen_pixels() {
        let mut pyramid = Pyramid::new(201, 103);
        for (i, p) in pyramid.base_mut().pixels_mut().iter_mut().enumerate() {
            *p = (i * 7 % 250) as u8;
        }
        pyramid.build();
        assert_eq!(pyramid.levels().len(), 3);
        let sum: u32 = (0..16)
            .map(|i| u32::from(pyramid.base().row(40 + i / 4)[80 + i % 4]))
            .sum();
        let averaged = f64::from(pyramid.levels()[2].row(10)[20]);
        assert!((averaged - f64::from(sum) / 16.0).abs() <= 1.0);
    }

    #[test]
    fn a_tiny_image_has_one_level() {
        assert_eq!(Pyramid::new(8, 4).levels().len(), 1);
    }
}
