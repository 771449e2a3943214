//! Pixel formats: what a camera delivers, to luma and to a small RGB picture.
//!
//! In: one frame's bytes in a [`PixelFormat`], rows unpadded. Out: luma `[H, W] u8` at full size, and RGB `[h, w, 3] u8`
//! at a working resolution by area average. Invariant: a frame whose size or length does not fit is refused and nothing is
//! written. Cost: one pass over the bytes each. Compressed pictures are decoded before they come here.
//! Source: luma weights and YCbCr of ITU-R BT.601, limited range, which UVC cameras and V4L2 take as default.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use super::{GrayImage, RgbImage};
use crate::space::Micros;

/// How a frame's bytes are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum PixelFormat {
    /// One luma byte a pixel.
    Grey,
    /// Red, green, blue.
    Rgb24,
    /// Two pixels in four bytes: Y0 U Y1 V; the width is even.
    Yuyv,
    /// A plane of luma, then one of U and V interleaved at half width and height; both sizes are even.
    Nv12,
}

impl PixelFormat {
    /// Bytes of a frame of this size.
    #[must_use]
    pub const fn byte_len(self, width: usize, height: usize) -> usize {
        let pixels = width * height;
        match self {
            Self::Grey => pixels,
            Self::Rgb24 => 3 * pixels,
            Self::Yuyv => 2 * pixels,
            Self::Nv12 => pixels + 2 * (width / 2) * (height / 2),
        }
    }

    const fn fits(self, width: usize, height: usize) -> bool {
        match self {
            Self::Grey | Self::Rgb24 => true,
            Self::Yuyv => width.is_multiple_of(2),
            Self::Nv12 => width.is_multiple_of(2) && height.is_multiple_of(2),
        }
    }
}

/// One frame as the camera delivered it.
#[derive(Clone, Copy, Debug)]
pub struct RawFrame<'a> {
    /// Capture stamp.
    pub stamp: Micros,
    /// Layout of `bytes`.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Rows without padding.
    pub bytes: &'a [u8],
}

/// Why a frame was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The bytes are not as many as format and size ask for: a torn frame, drop it.
    WrongLength,
    /// Not the configured size, or an odd one in a format of pixel pairs: the camera was set up differently.
    WrongSize,
    /// The stage itself failed: drop it.
    Refused,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::WrongLength => "the frame's length does not fit its format and size",
            Self::WrongSize => "the frame's size is not the configured one",
            Self::Refused => "the frame stage failed",
        })
    }
}

impl core::error::Error for FrameError {}

impl RawFrame<'_> {
    fn check(&self) -> Result<(), FrameError> {
        if self.width == 0 || self.height == 0 || !self.format.fits(self.width, self.height) {
            return Err(FrameError::WrongSize);
        }
        if self.bytes.len() != self.format.byte_len(self.width, self.height) {
            return Err(FrameError::WrongLength);
        }
        Ok(())
    }

    /// Writes the luma at full size.
    ///
    /// # Errors
    /// When the frame does not fit its own size or that of `out`; nothing is written then.
    pub fn luma_into(&self, out: &mut GrayImage) -> Result<(), FrameError> {
        self.check()?;
        if (out.width(), out.height()) != (self.width, self.height) {
            return Err(FrameError::WrongSize);
        }
        let luma = out.pixels_mut();
        match self.format {
            PixelFormat::Grey | PixelFormat::Nv12 => {
                let pixels = luma.len();
                luma.copy_from_slice(&self.bytes[..pixels]);
            }
            PixelFormat::Yuyv => {
                for (y, pair) in luma.iter_mut().zip(self.bytes.chunks_exact(2)) {
                    *y = pair[0];
                }
            }
            PixelFormat::Rgb24 => {
                for (y, rgb) in luma.iter_mut().zip(self.bytes.chunks_exact(3)) {
                    let sum = 77 * u32::from(rgb[0]) + 150 * u32::from(rgb[1]) + 29 * u32::from(rgb[2]);
                    *y = ((sum + 128) >> 8) as u8;
                }
            }
        }
        Ok(())
    }

    /// Writes the picture in colour, shrunk to the size of `out` by area average; gray is repeated in all channels.
    ///
    /// # Errors
    /// When the frame does not fit its own size, or `out` is empty or larger than the frame.
    pub fn rgb_into(&self, out: &mut RgbImage) -> Result<(), FrameError> {
        self.check()?;
        let (width, height) = (out.width(), out.height());
        if width == 0 || height == 0 || width > self.width || height > self.height {
            return Err(FrameError::WrongSize);
        }
        match self.format {
            PixelFormat::Grey => self.shrink(out, |x, y| {
                let luma = f32::from(self.bytes[y * self.width + x]);
                [luma; 3]
            }),
            PixelFormat::Rgb24 => self.shrink(out, |x, y| {
                let at = 3 * (y * self.width + x);
                let rgb = &self.bytes[at..at + 3];
                [f32::from(rgb[0]), f32::from(rgb[1]), f32::from(rgb[2])]
            }),
            PixelFormat::Yuyv => self.shrink(out, |x, y| {
                let at = 4 * ((y * self.width + x) / 2);
                let pair = &self.bytes[at..at + 4];
                rgb_from_yuv(pair[2 * (x & 1)], pair[1], pair[3])
            }),
            PixelFormat::Nv12 => self.shrink(out, |x, y| {
                let chroma = self.width * self.height + (y / 2) * self.width + 2 * (x / 2);
                let luma = self.bytes[y * self.width + x];
                rgb_from_yuv(luma, self.bytes[chroma], self.bytes[chroma + 1])
            }),
        }
        Ok(())
    }

    /// Exact area average: a source pixel cut by an edge counts by its covered part.
    fn shrink(&self, out: &mut RgbImage, rgb_at: impl Fn(usize, usize) -> [f32; 3]) {
        let (width, height) = (out.width(), out.height());
        let step = (
            self.width as f32 / width as f32,
            self.height as f32 / height as f32,
        );
        for row in 0..height {
            let span_y = Span::new(row, step.1, self.height);
            for column in 0..width {
                let span_x = Span::new(column, step.0, self.width);
                let mut sum = [0.0f32; 3];
                let mut area = 0.0;
                for y in span_y.first..span_y.end {
                    let cover_y = span_y.cover(y);
                    for x in span_x.first..span_x.end {
                        let weight = cover_y * span_x.cover(x);
                        let rgb = rgb_at(x, y);
                        area += weight;
                        for c in 0..3 {
                            sum[c] += weight * rgb[c];
                        }
                    }
                }
                let at = 3 * column;
                let pixel = &mut out.row_mut(row)[at..at + 3];
                for c in 0..3 {
                    pixel[c] = (sum[c] / area + 0.5) as u8;
                }
            }
        }
    }
}

/// The source pixels under one destination pixel along an axis.
struct Span {
    start: f32,
    stop: f32,
    first: usize,
    end: usize,
}

impl Span {
    fn new(index: usize, step: f32, size: usize) -> Self {
        let start = index as f32 * step;
        let stop = (index + 1) as f32 * step;
        let first = (start as usize).min(size - 1);
        // A sliver below a thousandth of a pixel is rounding, not picture.
        let last = (stop - 1e-3) as usize;
        Self {
            start,
            stop,
            first,
            end: (last + 1).clamp(first + 1, size),
        }
    }

    fn cover(&self, at: usize) -> f32 {
        ((at + 1) as f32).min(self.stop) - (at as f32).max(self.start)
    }
}

/// BT.601, limited range.
fn rgb_from_yuv(y: u8, u: u8, v: u8) -> [f32; 3] {
    let y = 1.164 * (f32::from(y) - 16.0);
    let (u, v) = (f32::from(u) - 128.0, f32::from(v) - 128.0);
    [
        (y + 1.596 * v).clamp(0.0, 255.0),
        (y - 0.392 * u - 0.813 * v).clamp(0.0, 255.0),
        (y + 2.017 * u).clamp(0.0, 255.0),
    ]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
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

    #[test]
    fn torn_and_odd_frames_are_refused() {
        let mut luma = GrayImage::new(4, 2);
        let short = frame(PixelFormat::Grey, 4, 2, &[0; 7]);
        assert_eq!(short.luma_into(&mut luma), Err(FrameError::WrongLength));
        let other = frame(PixelFormat::Grey, 2, 4, &[0; 8]);
        assert_eq!(other.luma_into(&mut luma), Err(FrameError::WrongSize));
        let odd = frame(PixelFormat::Yuyv, 3, 2, &[0; 12]);
        assert_eq!(
            odd.luma_into(&mut GrayImage::new(3, 2)),
            Err(FrameError::WrongSize)
        );
        let empty = frame(PixelFormat::Grey, 0, 0, &[]);
        assert_eq!(
            empty.rgb_into(&mut RgbImage::new(1, 1)),
            Err(FrameError::WrongSize)
        );
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
