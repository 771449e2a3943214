//! One image file: its header, whether it is whole, and its pixels.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use freespace::frame::PixelFormat;
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use crate::bad_input::BadInput;
use crate::config::ImageSize;

pub(super) struct Header {
    pub(super) size: ImageSize,
    pub(super) format: PixelFormat,
}

/// Reads what stands before the pixels, and checks that the file has its end.
pub(super) fn header(path: &Path) -> Result<Header, BadInput> {
    let again = "copy the file again from its source, or remove it: a missing frame is survived";
    let fault = |what: String| BadInput::of_file(path, what, again);
    let file = File::open(path).map_err(|error| fault(format!("cannot be opened: {error}")))?;
    let reader = ImageReader::new(BufReader::new(file))
        .with_guessed_format()
        .map_err(|error| fault(format!("cannot be read: {error}")))?;
    let Some(kind @ (ImageFormat::Png | ImageFormat::Jpeg)) = reader.format() else {
        return Err(fault("is no PNG or JPEG image, or is empty".to_owned()));
    };
    let decoder = reader
        .into_decoder()
        .map_err(|error| fault(format!("has a damaged header: {error}")))?;
    let (width, height) = decoder.dimensions();
    let format = match decoder.color_type() {
        ColorType::L8 | ColorType::La8 | ColorType::L16 | ColorType::La16 => PixelFormat::Grey,
        _ => PixelFormat::Rgb24,
    };
    if !is_whole(path, kind).map_err(|error| fault(format!("cannot be read: {error}")))? {
        return Err(fault(
            "is truncated: the end of the image is not in the file".to_owned(),
        ));
    }
    let size = ImageSize {
        width: width as usize,
        height: height as usize,
    };
    Ok(Header { size, format })
}

/// Bytes at the end of a file that are searched for the end of its image; cameras append a few of their own.
const TAIL_BYTES: u64 = 4096;

/// Whether the tail holds PNG's last chunk or JPEG's end marker.
fn is_whole(path: &Path, kind: ImageFormat) -> std::io::Result<bool> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(TAIL_BYTES)))?;
    let mut tail = Vec::new();
    file.read_to_end(&mut tail)?;
    let end: &[u8] = match kind {
        ImageFormat::Png => b"IEND\xAE\x42\x60\x82",
        _ => b"\xFF\xD9",
    };
    Ok(tail.windows(end.len()).any(|window| window == end))
}

/// Decodes into `bytes`, `[height, width, channels] u8`; on an error the bytes are of no use.
pub(super) fn decode(
    path: &Path,
    size: ImageSize,
    format: PixelFormat,
    bytes: &mut [u8],
) -> Result<(), String> {
    let text = |error: &dyn std::error::Error| error.to_string();
    let reader = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|error| text(&error))?;
    let decoder = reader.into_decoder().map_err(|error| text(&error))?;
    let (width, height) = decoder.dimensions();
    if (width as usize, height as usize) != (size.width, size.height) {
        return Err(format!("is {width}x{height} now"));
    }
    let native = match decoder.color_type() {
        ColorType::L8 => Some(PixelFormat::Grey),
        ColorType::Rgb8 => Some(PixelFormat::Rgb24),
        _ => None,
    };
    if native == Some(format) {
        return decoder.read_image(bytes).map_err(|error| text(&error));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|error| text(&error))?;
    match format {
        PixelFormat::Grey => bytes.copy_from_slice(image.to_luma8().as_raw()),
        // Image files give these two only.
        PixelFormat::Rgb24 | PixelFormat::Yuyv | PixelFormat::Nv12 => {
            bytes.copy_from_slice(image.to_rgb8().as_raw())
        }
    }
    Ok(())
}
