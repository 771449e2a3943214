//! From a driver's buffer to the core's bytes: padding taken off rows, compressed pictures decoded.
//!
//! In: a buffer of the layout agreed. Out: `[H, W]` in a [`PixelFormat`], rows unpadded. Invariant: rows are inside the buffer, or
//! there is no [`Rows`]; bytes always fit the format, size and length that the frame says. Cost: one copy; no allocation where the
//! frame's buffer has room for three bytes a pixel, but for what the JPEG decoder takes.

use freespace::frame::PixelFormat;
use freespace::port::FrameBuffer;

use super::node::Layout;
use crate::config::DeviceFormat;

/// How the rows of a picture lie in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rows {
    /// What the core gets.
    pub(super) format: PixelFormat,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Bytes of a row, and from one row to the next; the same in both planes of NV12.
    row: usize,
    stride: usize,
    /// Rows of all planes; 0 where the picture is compressed.
    count: usize,
}

impl Rows {
    /// None where the driver's answer cannot be.
    pub(super) fn of(format: DeviceFormat, layout: &Layout) -> Option<Self> {
        let (width, height) = (layout.width as usize, layout.height as usize);
        let is_even = |size: usize| size.is_multiple_of(2);
        let (core, row, count) = match format {
            DeviceFormat::Yuyv if is_even(width) => (PixelFormat::Yuyv, 2 * width, height),
            DeviceFormat::Nv12 if is_even(width) && is_even(height) => {
                (PixelFormat::Nv12, width, height + height / 2)
            }
            DeviceFormat::Grey => (PixelFormat::Grey, width, height),
            DeviceFormat::Rgb24 => (PixelFormat::Rgb24, 3 * width, height),
            DeviceFormat::Mjpeg => (PixelFormat::Rgb24, 0, 0),
            DeviceFormat::Yuyv | DeviceFormat::Nv12 => return None,
        };
        // Some drivers leave it to the format.
        let stride = match layout.bytes_per_line as usize {
            0 => row,
            stride => stride,
        };
        let rows = Self {
            format: core,
            width,
            height,
            row,
            stride,
            count,
        };
        let is_room = count == 0 || rows.len() <= layout.image_bytes as usize;
        (stride >= row && width > 0 && height > 0 && is_room).then_some(rows)
    }

    /// Bytes from the first to the last; padding after the last row need not be there.
    const fn len(&self) -> usize {
        match self.count {
            0 => 0,
            count => (count - 1) * self.stride + self.row,
        }
    }

    /// Whether the core must be handed what a decoder makes of it.
    pub(super) const fn is_compressed(&self) -> bool {
        self.count == 0
    }

    /// Writes the frame's description; its bytes are as many as it says.
    pub(super) fn describe(&self, buffer: &mut FrameBuffer) {
        buffer.format = self.format;
        (buffer.width, buffer.height) = (self.width, self.height);
    }

    /// Copies the pixels; false, and nothing written, where there are too few.
    pub(super) fn copy(&self, from: &[u8], buffer: &mut FrameBuffer) -> bool {
        let Some(from) = from.get(..self.len()) else {
            return false;
        };
        self.describe(buffer);
        buffer.bytes.clear();
        if self.stride == self.row {
            buffer.bytes.extend_from_slice(from);
        } else {
            for line in from.chunks(self.stride) {
                buffer.bytes.extend_from_slice(&line[..self.row]);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::super::negotiate::four_cc;
    use super::*;

    fn layout(format: DeviceFormat, bytes_per_line: u32, image_bytes: u32) -> Layout {
        Layout {
            format: four_cc(format),
            width: 4,
            height: 2,
            bytes_per_line,
            image_bytes,
            is_progressive: true,
        }
    }

    #[test]
    fn padding_is_taken_off_and_the_last_row_needs_none() {
        let rows = Rows::of(DeviceFormat::Nv12, &layout(DeviceFormat::Nv12, 6, 18)).unwrap();
        let bytes: Vec<u8> = (0..16).collect();
        let mut buffer = FrameBuffer::default();
        assert!(rows.copy(&bytes, &mut buffer));
        assert_eq!(buffer.bytes, [0, 1, 2, 3, 6, 7, 8, 9, 12, 13, 14, 15]);
        assert_eq!(buffer.format, PixelFormat::Nv12);
        assert!(!rows.copy(&bytes[..15], &mut buffer), "a torn frame");
        assert_eq!(buffer.bytes.len(), 12);
    }

    #[test]
    fn answers_that_cannot_be_are_refused() {
        let of = |format, line, bytes| Rows::of(format, &layout(format, line, bytes));
        assert!(of(DeviceFormat::Yuyv, 8, 16).is_some());
        assert!(of(DeviceFormat::Yuyv, 0, 16).is_some());
        assert!(of(DeviceFormat::Yuyv, 4, 16).is_none());
        assert!(of(DeviceFormat::Rgb24, 12, 23).is_none());
        assert!(of(DeviceFormat::Mjpeg, 0, 100).is_some());
        let odd = Layout {
            width: 3,
            ..layout(DeviceFormat::Yuyv, 0, 100)
        };
        assert!(Rows::of(DeviceFormat::Yuyv, &odd).is_none());
    }
}
