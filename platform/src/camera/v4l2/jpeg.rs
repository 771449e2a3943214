//! Pictures of cameras that compress: JPEG in, RGB out.
//!
//! In: one picture of the agreed size, as the camera sent it. Out: `[H, W, 3] u8`. Invariant: a picture that is cut off, of
//! another size or not decodable is refused, never shown half grey. Cost: some ms and the decoder's own allocations, on the
//! camera's thread.
//!
//! Cameras leave the Huffman tables out, as AVI files do (each picture has the same); the decoder fills them in where the header of
//! such a file says so, so that header is put in front.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

/// Start of a picture, with the header of AVI files: segment `APP0` of 16 bytes.
const AVI_START: [u8; 20] = *b"\xff\xd8\xff\xe0\x00\x10AVI1\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00";

/// Markers of JPEG (ITU-T T.81, table B.1).
const HUFFMAN_TABLES: u8 = 0xc4;
const START_OF_SCAN: u8 = 0xda;

/// Decodes pictures of one size.
#[derive(Debug)]
pub(super) struct Jpeg {
    options: DecoderOptions,
    /// Room for a picture with the header in front.
    completed: Vec<u8>,
}

impl Jpeg {
    /// For pictures of at most so many bytes.
    pub(super) fn new(longest: usize) -> Self {
        Self {
            options: DecoderOptions::new_fast()
                .set_strict_mode(true)
                .jpeg_set_out_colorspace(ColorSpace::RGB),
            completed: Vec::with_capacity(longest + AVI_START.len()),
        }
    }

    /// Writes the picture to `rgb`, whose length is that of the size; false where it is damaged, then `rgb` is undefined.
    pub(super) fn decode(&mut self, picture: &[u8], (width, height): (usize, usize), rgb: &mut [u8]) -> bool {
        let picture = match picture.strip_prefix(b"\xff\xd8") {
            Some(rest) if !has_huffman_tables(rest) => {
                self.completed.clear();
                self.completed.extend_from_slice(&AVI_START);
                self.completed.extend_from_slice(rest);
                &self.completed
            }
            _ => picture,
        };
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(picture), self.options);
        if decoder.decode_headers().is_err() {
            return false;
        }
        let is_size = (decoder.info())
            .is_some_and(|info| (usize::from(info.width), usize::from(info.height)) == (width, height));
        is_size && decoder.output_buffer_size() == Some(rgb.len()) && decoder.decode_into(rgb).is_ok()
    }
}

/// Whether the header of a picture, its start marker taken off, defines Huffman tables; true where it cannot be read, for the
/// decoder to say so.
fn has_huffman_tables(mut rest: &[u8]) -> bool {
    while let [0xff, marker, high, low, ..] = *rest {
        match marker {
            HUFFMAN_TABLES => return true,
            START_OF_SCAN => return false,
            // A fill byte.
            0xff => rest = &rest[1..],
            _ => {
                let segment = 2 + usize::from(u16::from_be_bytes([high, low]));
                rest = rest.get(segment..).unwrap_or_default();
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]
    use image::codecs::jpeg::JpegEncoder;
    use image::{ExtendedColorType, ImageEncoder as _};
    use proptest::prelude::*;

    use super::*;

    const SIZE: (usize, usize) = (64, 48);

    fn encoded(colour: ExtendedColorType) -> Vec<u8> {
        let channels = usize::from(colour.channel_count());
        let pixels: Vec<u8> = (0..SIZE.0 * SIZE.1 * channels)
            .map(|at| (at / channels % SIZE.0 * 3) as u8)
            .collect();
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 95)
            .write_image(&pixels, SIZE.0 as u32, SIZE.1 as u32, colour)
            .unwrap();
        bytes
    }

    fn decode(picture: &[u8]) -> Option<Vec<u8>> {
        let mut rgb = vec![0; 3 * SIZE.0 * SIZE.1];
        Jpeg::new(picture.len())
            .decode(picture, SIZE, &mut rgb)
            .then_some(rgb)
    }

    fn without_tables(mut picture: Vec<u8>) -> Vec<u8> {
        while let Some(at) = picture
            .windows(4)
            .position(|four| four[..2] == [0xff, HUFFMAN_TABLES])
        {
            let len = usize::from(u16::from_be_bytes([picture[at + 2], picture[at + 3]]));
            picture.drain(at..picture.len().min(at + 2 + len));
        }
        picture
    }

    #[test]
    fn colour_and_grey_pictures_are_decoded() {
        for colour in [ExtendedColorType::Rgb8, ExtendedColorType::L8] {
            let rgb = decode(&encoded(colour)).unwrap();
            for (at, pixel) in rgb.chunks(3).enumerate() {
                let wanted = (at % SIZE.0 * 3) as u8;
                assert!(
                    pixel.iter().all(|value| value.abs_diff(wanted) < 6),
                    "{colour:?} {at}: {pixel:?}"
                );
            }
        }
    }

    #[test]
    fn a_picture_without_huffman_tables_is_decoded_as_the_same() {
        let whole = encoded(ExtendedColorType::Rgb8);
        let bare = without_tables(whole.clone());
        assert!(bare.len() + 400 < whole.len());
        assert_eq!(decode(&bare), decode(&whole));
    }

    #[test]
    fn cut_and_foreign_pictures_are_refused() {
        let whole = encoded(ExtendedColorType::Rgb8);
        assert_eq!(decode(&whole[..whole.len() / 2]), None);
        assert_eq!(decode(&[]), None);
        assert_eq!(decode(b"\xff\xd8"), None);
        let mut other = vec![0; 3 * 48 * 64];
        assert!(!Jpeg::new(0).decode(&whole, (48, 64), &mut other));
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 300, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..ProptestConfig::default() })]
        #[test]
        fn a_damaged_picture_never_panics(at in 2usize..2000, value: u8, cut in 0usize..2000) {
            let mut picture = encoded(ExtendedColorType::Rgb8);
            let len = picture.len();
            picture[at % len] = value;
            picture.truncate(len - cut % (len / 2));
            decode(&picture);
            decode(&without_tables(picture));
        }
    }
}
