//! Condition: frames that show nothing new or nothing at all.
//!
//! In: the pyramid of this frame and of the last sound one. Out: an [`ImageFault`], or none. Cost: one comparison of the
//! full-size bytes (it ends at the first difference) and one pass over level [`SAMPLE_LEVEL`].
//! The sensor's noise makes two equal frames practically impossible, also when the car stands: equal bytes are a frozen camera.
#![allow(
    clippy::cast_possible_truncation,
    reason = "pixel arithmetic: counts are bounded by the image"
)]

use super::{GrayImage, Pyramid};

/// Level that is looked at: noise is averaged there, a lens out of focus by much shows no texture either.
const SAMPLE_LEVEL: usize = 1;
/// Darker than this is black: a lit road scene has lamps or markings above it. Tuned on KITTI and synthetic frames.
const BLACK_LUMA: u8 = 24;
/// At least this bright is burnt out.
const BURNT_LUMA: u8 = 250;
/// Share of burnt pixels above which little is left to see, in percent; a low sun burns some 20.
const BURNT_PERCENT: usize = 60;
/// Share of bright pixels below which the frame is black, in thousandths.
const LIT_PER_MILLE: usize = 2;
/// Luma difference of neighbours that counts as texture, over what noise leaves at the sampled level.
const TEXTURE_LUMA: u8 = 10;
/// Share of textured pixels below which the view is blocked, in thousandths; KITTI frames have above 100.
const TEXTURE_PER_MILLE: usize = 8;

/// What is wrong with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFault {
    /// The same bytes as the last sound frame.
    Frozen,
    /// No light.
    Black,
    /// Mostly burnt out.
    OverExposed,
    /// No texture: covered, fogged or far out of focus.
    Blocked,
}

/// Looks for a fault of `current`; `previous` is the last sound frame, if any.
#[must_use]
pub fn image_fault(current: &Pyramid, previous: Option<&Pyramid>) -> Option<ImageFault> {
    if previous.is_some_and(|p| p.base() == current.base()) {
        return Some(ImageFault::Frozen);
    }
    let levels = current.levels();
    let image = &levels[SAMPLE_LEVEL.min(levels.len() - 1)];
    let pixels = image.pixels().len();
    let (mut lit, mut burnt) = (0usize, 0usize);
    for luma in image.pixels() {
        lit += usize::from(*luma >= BLACK_LUMA);
        burnt += usize::from(*luma >= BURNT_LUMA);
    }
    if lit * 1000 < pixels * LIT_PER_MILLE {
        return Some(ImageFault::Black);
    }
    if burnt * 100 > pixels * BURNT_PERCENT {
        return Some(ImageFault::OverExposed);
    }
    (textured(image) * 1000 < pixels * TEXTURE_PER_MILLE).then_some(ImageFault::Blocked)
}

/// Pixels that differ clearly from the one two to the right or two below.
fn textured(image: &GrayImage) -> usize {
    let (width, height) = (image.width(), image.height());
    if width < 3 || height < 3 {
        return 0;
    }
    let mut count = 0;
    for y in 0..height - 2 {
        let row = image.row(y);
        let below = image.row(y + 2);
        for x in 0..width - 2 {
            let change = row[x].abs_diff(row[x + 2]).max(row[x].abs_diff(below[x]));
            count += usize::from(change >= TEXTURE_LUMA);
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(luma: impl Fn(usize, usize) -> u8) -> Pyramid {
        let mut pyramid = Pyramid::new(160, 96);
        for y in 0..96 {
            for x in 0..160 {
                pyramid.base_mut().row_mut(y)[x] = luma(x, y);
            }
        }
        pyramid.build();
        pyramid
    }

    #[test]
    fn each_fault_is_named() {
        let blocks = |x: usize, y: usize| {
            if (x / 16 + y / 16).is_multiple_of(2) {
                60
            } else {
                150
            }
        };
        let sound = picture(blocks);
        assert_eq!(image_fault(&sound, None), None);
        assert_eq!(image_fault(&sound, Some(&sound)), Some(ImageFault::Frozen));
        let noisy = picture(|x, y| blocks(x, y) + ((x * 31 + y * 17) % 3) as u8);
        assert_eq!(image_fault(&noisy, Some(&sound)), None);
        assert_eq!(
            image_fault(&picture(|x, _| (x % 9) as u8), None),
            Some(ImageFault::Black)
        );
        assert_eq!(
            image_fault(&picture(|x, _| if x < 30 { 90 } else { 255 }), None),
            Some(ImageFault::OverExposed)
        );
        // A covered lens: light comes through, without edges, with noise.
        let fog = |x: usize, y: usize| 100 + (y / 8) as u8 + ((x * 7 + y * 13) % 4) as u8;
        assert_eq!(image_fault(&picture(fog), None), Some(ImageFault::Blocked));
    }

    /// At night most of the picture is black, the lamps are not.
    #[test]
    fn night_is_not_black() {
        let night = |x: usize, y: usize| if y > 60 && x % 20 < 6 { 120 } else { 8 };
        assert_eq!(image_fault(&picture(night), None), None);
    }
}
