//! The small picture of a view: the key frame with its road tinted, as JPEG.
#![allow(
    clippy::cast_possible_truncation,
    reason = "pixel arithmetic: values are mixtures of bytes"
)]

use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;

/// Widest picture; larger frames are shrunk by whole numbers.
const WIDTH_PX: usize = 640;
/// 0 to 100: 640x480 is 40 to 120 kB.
const QUALITY: u8 = 70;
const ROAD: [u8; 3] = [255, 60, 170];
const EDGE: [u8; 3] = [250, 250, 120];

/// What a picture is drawn from.
#[derive(Clone, Copy, Debug)]
pub struct PictureSource<'a> {
    /// Width and height of the frame in pixels.
    pub size: (usize, usize),
    /// `[height, width, 3] u8`, red green blue.
    pub pixels: &'a [u8],
    /// Width and height of the labels.
    pub labels_size: (usize, usize),
    /// `[height, width] u8`, not 0 = road.
    pub labels: &'a [u8],
}

/// Draws into buffers that are used again.
#[derive(Debug, Default)]
pub(super) struct Painter {
    pixels: Vec<u8>,
    jpeg: Vec<u8>,
}

impl Painter {
    /// The picture as JPEG; empty where sizes and buffers do not fit each other.
    pub(super) fn paint(&mut self, source: &PictureSource<'_>) -> &[u8] {
        self.jpeg.clear();
        let (width, height) = source.size;
        let step = width.div_ceil(WIDTH_PX).max(1);
        let size = (width / step, height / step);
        let is_whole = source.pixels.len() == 3 * width * height
            && source.labels.len() == source.labels_size.0 * source.labels_size.1
            && size.0 > 0
            && size.1 > 0;
        let (Ok(w), Ok(h)) = (u16::try_from(size.0), u16::try_from(size.1)) else {
            return &[];
        };
        if !is_whole || source.labels.is_empty() {
            return &[];
        }
        self.draw(source, step, size);
        let mut encoder = JpegEncoder::new_with_quality(&mut self.jpeg, QUALITY);
        let encoded = encoder.encode(&self.pixels, u32::from(w), u32::from(h), ExtendedColorType::Rgb8);
        if encoded.is_err() {
            self.jpeg.clear();
        }
        &self.jpeg
    }

    fn draw(&mut self, source: &PictureSource<'_>, step: usize, (width, height): (usize, usize)) {
        self.pixels.clear();
        for y in 0..height {
            for x in 0..width {
                let first = 3 * (y * step * source.size.0 + x * step);
                let pixel = [
                    source.pixels[first],
                    source.pixels[first + 1],
                    source.pixels[first + 2],
                ];
                let is_road = |x: usize, y: usize| is_road(source, x, y, (width, height));
                let (tint, eighths) = if !is_road(x, y) {
                    (ROAD, 0)
                } else if is_road(x.saturating_sub(1), y)
                    && is_road((x + 1).min(width - 1), y)
                    && is_road(x, y.saturating_sub(1))
                    && is_road(x, (y + 1).min(height - 1))
                {
                    (ROAD, 3)
                } else {
                    (EDGE, 7)
                };
                self.pixels.extend((0..3).map(|c| {
                    ((u16::from(pixel[c]) * (8 - eighths) + u16::from(tint[c]) * eighths) / 8) as u8
                }));
            }
        }
    }
}

/// Label of a pixel of the picture: that of the nearest working pixel.
fn is_road(source: &PictureSource<'_>, x: usize, y: usize, (width, height): (usize, usize)) -> bool {
    let column = x * source.labels_size.0 / width;
    let row = y * source.labels_size.1 / height;
    source.labels[row * source.labels_size.0 + column] != 0
}
