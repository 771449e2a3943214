//! Frames as `foxglove.RawImage`: the bytes as the pipeline got them, without a loss.
//!
//! Cost: one copy of the pixels to write, two to read.

use foxglove::schemas::RawImage;
use foxglove::{Decode, Encode};
use freespace::frame::PixelFormat;
use freespace::port::FrameBuffer;
use freespace::space::Micros;

use super::note::timestamp;

/// Key of the field `data` in `foxglove.RawImage`: number 6, length-delimited.
const DATA_KEY: u8 = 6 << 3 | 2;

const fn encoding(format: PixelFormat) -> &'static str {
    match format {
        PixelFormat::Grey => "mono8",
        PixelFormat::Rgb24 => "rgb8",
        PixelFormat::Yuyv => "yuyv",
        PixelFormat::Nv12 => "nv12",
    }
}

fn format_of(encoding: &str) -> Option<PixelFormat> {
    match encoding {
        "mono8" | "8UC1" => Some(PixelFormat::Grey),
        "rgb8" => Some(PixelFormat::Rgb24),
        "yuyv" | "yuv422_yuy2" => Some(PixelFormat::Yuyv),
        "nv12" => Some(PixelFormat::Nv12),
        _ => None,
    }
}

/// Bytes of a row, as `step` has it: of the luma plane, where colour lies in another.
const fn row_bytes(format: PixelFormat, width: usize) -> usize {
    match format {
        PixelFormat::Grey | PixelFormat::Nv12 => width,
        PixelFormat::Yuyv => 2 * width,
        PixelFormat::Rgb24 => 3 * width,
    }
}

/// Writes a frame as a message over what `out` held.
#[expect(
    clippy::cast_possible_truncation,
    reason = "image sizes, and the low bits of a length"
)]
pub(super) fn encode(frame: &FrameBuffer, out: &mut Vec<u8>) {
    out.clear();
    let head = RawImage {
        timestamp: timestamp(frame.stamp),
        frame_id: "camera".to_owned(),
        width: frame.width as u32,
        height: frame.height as u32,
        encoding: encoding(frame.format).to_owned(),
        step: row_bytes(frame.format, frame.width) as u32,
        data: foxglove::bytes::Bytes::new(),
    };
    // Writing to memory that grows cannot fail.
    let _ = head.encode(out);
    // The pixels follow as their field, in place of a message that would own a copy of them.
    out.push(DATA_KEY);
    let mut length = frame.bytes.len();
    while length >= 0x80 {
        out.push(length as u8 | 0x80);
        length >>= 7;
    }
    out.push(length as u8);
    out.extend_from_slice(&frame.bytes);
}

/// Why a recorded picture is of no use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum PictureFault {
    /// It is no `foxglove.RawImage`.
    #[error("is no foxglove.RawImage")]
    Damaged,
    /// A pixel format that the pipeline does not take.
    #[error("has a pixel format that is not one of mono8, rgb8, yuyv, nv12")]
    Format,
    /// Its bytes are not as many as its size says.
    #[error("holds another number of bytes than its size says")]
    Size,
}

/// Reads a message into a frame; index and stamp are the message's own.
///
/// # Errors
/// See [`PictureFault`]; the frame is of no use then.
pub(crate) fn decode(
    message: &[u8],
    index: u64,
    stamp: Micros,
    frame: &mut FrameBuffer,
) -> Result<(), PictureFault> {
    let image = RawImage::decode(message).map_err(|_| PictureFault::Damaged)?;
    let format = format_of(&image.encoding).ok_or(PictureFault::Format)?;
    let (width, height) = (image.width as usize, image.height as usize);
    let fits = width < 1 << 16 && height < 1 << 16 && image.data.len() == format.byte_len(width, height);
    if !fits || image.step as usize != row_bytes(format, width) {
        return Err(PictureFault::Size);
    }
    frame.index = index;
    frame.stamp = stamp;
    frame.format = format;
    (frame.width, frame.height) = (width, height);
    frame.bytes.clear();
    frame.bytes.extend_from_slice(&image.data);
    frame.key_frame_wanted = false;
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]
    use super::*;

    #[test]
    fn every_format_comes_back_byte_for_byte() {
        for format in [
            PixelFormat::Grey,
            PixelFormat::Rgb24,
            PixelFormat::Yuyv,
            PixelFormat::Nv12,
        ] {
            let (width, height) = (64, 48);
            let frame = FrameBuffer {
                index: 7,
                stamp: Micros(1_234_567),
                format,
                width,
                height,
                bytes: (0..format.byte_len(width, height))
                    .map(|i| (i * 31 % 251) as u8)
                    .collect(),
                key_frame_wanted: false,
            };
            let (mut message, mut read) = (Vec::new(), FrameBuffer::default());
            encode(&frame, &mut message);
            decode(&message, 7, frame.stamp, &mut read).unwrap();
            assert_eq!(
                (read.format, read.width, read.height, read.bytes),
                (format, width, height, frame.bytes)
            );
        }
    }

    #[test]
    fn a_picture_that_is_not_whole_is_refused() {
        let frame = FrameBuffer {
            width: 8,
            height: 8,
            bytes: vec![0; 63],
            ..FrameBuffer::default()
        };
        let (mut message, mut read) = (Vec::new(), FrameBuffer::default());
        encode(&frame, &mut message);
        let refused = decode(&message, 0, Micros(0), &mut read);
        assert_eq!(refused, Err(PictureFault::Size));
        message.truncate(30);
        assert_eq!(
            decode(&message, 0, Micros(0), &mut read),
            Err(PictureFault::Damaged)
        );
    }
}
