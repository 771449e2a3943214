//! Colour: a frame's RGB picture, at full size or shrunk by area average.
//!
//! In: a [`RawFrame`]. Out: RGB `[h, w, 3] u8`, not larger than the frame. Each row is converted to RGB bytes and, where it
//! shrinks, gathered with its neighbours by the part of them that the output row covers, then along the row in the same way.
//! Invariant: a frame that does not fit is refused and nothing is written. Cost: two passes over the bytes of the frame; at
//! full size one. Source: YCbCr of ITU-R BT.601, limited range, which UVC cameras and V4L2 take as default.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use super::{FrameError, PixelFormat, RawFrame, RgbImage};
use crate::budget::MAX_WIDTH_PX;

impl RawFrame<'_> {
    /// Writes the picture in colour, shrunk to the size of `out` by area average; gray is repeated in all channels.
    ///
    /// # Errors
    /// When the frame does not fit its own size, is too wide, or `out` is empty or larger than the frame.
    pub fn rgb_into(&self, out: &mut RgbImage) -> Result<(), FrameError> {
        self.check()?;
        let (width, height) = (out.width(), out.height());
        let fits = (1..=self.width).contains(&width) && (1..=self.height).contains(&height);
        if !fits || self.width > MAX_WIDTH_PX {
            return Err(FrameError::WrongSize);
        }
        if (width, height) == (self.width, self.height) {
            for y in 0..height {
                self.rgb_row(y, out.row_mut(y));
            }
        } else {
            self.shrink(out);
        }
        Ok(())
    }

    /// Writes row `y` in colour.
    fn rgb_row(&self, y: usize, out: &mut [u8]) {
        let width = self.width;
        match self.format {
            PixelFormat::Rgb24 => out.copy_from_slice(&self.bytes[3 * y * width..3 * (y + 1) * width]),
            PixelFormat::Grey => {
                let row = &self.bytes[y * width..(y + 1) * width];
                for (rgb, luma) in out.chunks_exact_mut(3).zip(row) {
                    rgb.fill(*luma);
                }
            }
            PixelFormat::Yuyv => {
                let row = &self.bytes[2 * y * width..2 * (y + 1) * width];
                for (rgb, pair) in out.chunks_exact_mut(6).zip(row.chunks_exact(4)) {
                    rgb[..3].copy_from_slice(&rgb_from_yuv(pair[0], pair[1], pair[3]));
                    rgb[3..].copy_from_slice(&rgb_from_yuv(pair[2], pair[1], pair[3]));
                }
            }
            PixelFormat::Nv12 => {
                let luma = &self.bytes[y * width..(y + 1) * width];
                let chroma = &self.bytes[width * self.height + (y / 2) * width..][..width];
                let pairs = luma.chunks_exact(2).zip(chroma.chunks_exact(2));
                for (rgb, (y, uv)) in out.chunks_exact_mut(6).zip(pairs) {
                    rgb[..3].copy_from_slice(&rgb_from_yuv(y[0], uv[0], uv[1]));
                    rgb[3..].copy_from_slice(&rgb_from_yuv(y[1], uv[0], uv[1]));
                }
            }
        }
    }

    /// Area average: a source pixel cut by an edge counts by its covered part.
    fn shrink(&self, out: &mut RgbImage) {
        let (width, height) = (out.width(), out.height());
        let step_x = self.width as f32 / width as f32;
        let step_y = self.height as f32 / height as f32;
        let mut columns = [Span::default(); MAX_WIDTH_PX];
        for (column, span) in columns[..width].iter_mut().enumerate() {
            *span = Span::new(column, step_x, self.width);
        }
        let mut bytes = [0u8; 3 * MAX_WIDTH_PX];
        let mut sums = [0.0f32; 3 * MAX_WIDTH_PX];
        let (bytes, sums) = (&mut bytes[..3 * self.width], &mut sums[..3 * self.width]);
        for row in 0..height {
            let rows = Span::new(row, step_y, self.height);
            sums.fill(0.0);
            for y in rows.first..rows.end {
                self.rgb_row(y, bytes);
                let cover = rows.cover(y);
                for (sum, byte) in sums.iter_mut().zip(bytes.iter()) {
                    *sum += cover * f32::from(*byte);
                }
            }
            for (pixel, span) in out.row_mut(row).chunks_exact_mut(3).zip(&columns) {
                let mut sum = [0.0f32; 3];
                for (i, rgb) in sums[3 * span.first..3 * span.end].chunks_exact(3).enumerate() {
                    let cover = span.cover(span.first + i);
                    for c in 0..3 {
                        sum[c] += cover * rgb[c];
                    }
                }
                for c in 0..3 {
                    pixel[c] = (sum[c] * (span.share * rows.share) + 0.5) as u8;
                }
            }
        }
    }
}

/// The source pixels under one destination pixel along an axis: all covered whole but for the first and the last.
#[derive(Clone, Copy, Default)]
struct Span {
    first: usize,
    end: usize,
    cover_first: f32,
    cover_last: f32,
    /// One over the covered length.
    share: f32,
}

impl Span {
    fn new(index: usize, step: f32, size: usize) -> Self {
        let start = index as f32 * step;
        let stop = (index + 1) as f32 * step;
        let first = (start as usize).min(size - 1);
        // A sliver below a thousandth of a pixel is rounding, not picture.
        let last = ((stop - 1e-3) as usize).clamp(first, size - 1);
        let cover = |at: usize| ((at + 1) as f32).min(stop) - (at as f32).max(start);
        let whole = last.saturating_sub(first + 1) as f32;
        let ends = cover(first) + if last > first { cover(last) } else { 0.0 };
        Self {
            first,
            end: last + 1,
            cover_first: cover(first),
            cover_last: cover(last),
            share: 1.0 / (whole + ends),
        }
    }

    #[inline(always)]
    fn cover(&self, at: usize) -> f32 {
        if at == self.first {
            self.cover_first
        } else if at + 1 == self.end {
            self.cover_last
        } else {
            1.0
        }
    }
}

/// BT.601, limited range.
fn rgb_from_yuv(y: u8, u: u8, v: u8) -> [u8; 3] {
    let y = 1.164 * (f32::from(y) - 16.0);
    let (u, v) = (f32::from(u) - 128.0, f32::from(v) - 128.0);
    // The cast saturates at both ends.
    [y + 1.596 * v, y - 0.392 * u - 0.813 * v, y + 2.017 * u].map(|channel| (channel + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::space::Micros;
    use alloc::vec;
    use alloc::vec::Vec;

    fn frame(format: PixelFormat, width: usize, height: usize, bytes: &[u8]) -> RawFrame<'_> {
        RawFrame {
            stamp: Micros(0),
            format,
            width,
            height,
            bytes,
        }
    }

    /// The same half red, half green picture in every colour format looks the same.
    #[test]
    fn formats_agree() {
        let (width, height) = (8, 4);
        let rgb: Vec<u8> = (0..width * height)
            .flat_map(|i| {
                if i % width < 4 {
                    [200, 30, 40]
                } else {
                    [20, 180, 60]
                }
            })
            .collect();
        let yuv = |p: &[u8]| {
            let [r, g, b] = [f32::from(p[0]), f32::from(p[1]), f32::from(p[2])];
            [
                (0.257 * r + 0.504 * g + 0.098 * b + 16.5) as u8,
                (-0.148 * r - 0.291 * g + 0.439 * b + 128.5) as u8,
                (0.439 * r - 0.368 * g - 0.071 * b + 128.5) as u8,
            ]
        };
        let mut yuyv = Vec::new();
        for pair in rgb.chunks_exact(6) {
            let (a, b) = (yuv(&pair[..3]), yuv(&pair[3..]));
            yuyv.extend_from_slice(&[a[0], a[1], b[0], a[2]]);
        }
        let mut nv12: Vec<u8> = rgb.chunks_exact(3).map(|p| yuv(p)[0]).collect();
        for _ in 0..height / 2 {
            for x in (0..width).step_by(2) {
                let p = yuv(&rgb[3 * x..3 * x + 3]);
                nv12.extend_from_slice(&p[1..]);
            }
        }
        let mut expected = RgbImage::new(4, 2);
        frame(PixelFormat::Rgb24, width, height, &rgb)
            .rgb_into(&mut expected)
            .unwrap();
        assert_eq!(&expected.pixels()[..3], &[200, 30, 40]);
        for (format, bytes) in [(PixelFormat::Yuyv, &yuyv), (PixelFormat::Nv12, &nv12)] {
            let mut out = RgbImage::new(4, 2);
            frame(format, width, height, bytes).rgb_into(&mut out).unwrap();
            for (a, b) in out.pixels().iter().zip(expected.pixels()) {
                assert!(a.abs_diff(*b) <= 3, "{format:?}: {a} {b}");
            }
            let mut whole = RgbImage::new(width, height);
            frame(format, width, height, bytes).rgb_into(&mut whole).unwrap();
            for (a, b) in whole.pixels().iter().zip(&rgb) {
                assert!(a.abs_diff(*b) <= 3, "{format:?} at full size: {a} {b}");
            }
        }
    }

    #[test]
    fn average_keeps_the_mean_at_uneven_ratios() {
        let (width, height) = (31, 17);
        let bytes: Vec<u8> = (0..width * height).map(|i| (i * 37 % 251) as u8).collect();
        let mut out = RgbImage::new(12, 7);
        frame(PixelFormat::Grey, width, height, &bytes)
            .rgb_into(&mut out)
            .unwrap();
        let mean = |v: &[u8]| v.iter().map(|b| f64::from(*b)).sum::<f64>() / v.len() as f64;
        assert!((mean(&bytes) - mean(out.pixels())).abs() < 0.6);
        let flat = vec![93u8; width * height];
        frame(PixelFormat::Grey, width, height, &flat)
            .rgb_into(&mut out)
            .unwrap();
        assert!(out.pixels().iter().all(|b| *b == 93));
    }
}
