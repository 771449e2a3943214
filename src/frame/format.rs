//! Pixel formats: what a camera delivers, and its luma.
//!
//! In: one frame's bytes in a [`PixelFormat`], rows unpadded. Out: luma `[H, W] u8` at full size; colour is made in
//! [`colour`](super::colour). Invariant: a frame whose size or length does not fit is refused and nothing is written. Cost: one
//! pass over the bytes. Compressed pictures are decoded before they come here. Source: luma weights of ITU-R BT.601.
#![allow(
    clippy::cast_possible_truncation,
    reason = "pixel arithmetic: a weighted mean of bytes is a byte"
)]

use super::GrayImage;
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
    /// The pose that came of it is no place the car can be: start the task anew.
    Broken,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::WrongLength => "the frame's length does not fit its format and size",
            Self::WrongSize => "the frame's size is not the configured one",
            Self::Refused => "the frame stage failed",
            Self::Broken => "the pose that came of it is no place the car can be",
        })
    }
}

impl core::error::Error for FrameError {}

impl RawFrame<'_> {
    pub(super) fn check(&self) -> Result<(), FrameError> {
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
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::frame::RgbImage;

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
}
