//! Comparisons with truth as pages that stand alone: the numbers, and pictures of the frames that differ most.
//!
//! In: scores, and the files that they were made of. Out: the text of an HTML page, some 2 MB at most: six frames are shown whatever
//! their number, large ones smaller.

mod fleet;
mod grid;
mod masks;
mod trajectory;

pub use fleet::render as render_fleet;
pub use grid::render as render_grid;
pub use masks::render as render_masks;
pub use trajectory::render as render_trajectory;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};

/// Frames shown: those that differ most.
const WORST: usize = 6;
/// Rows of a table of frames, the furthest off first.
const ROWS: usize = 40;

/// The frames with the lowest scores, the lowest first.
fn lowest<T>(frames: &[(String, T)], score: impl Fn(&T) -> f64) -> Vec<&(String, T)> {
    let mut frames: Vec<_> = frames.iter().collect();
    frames.sort_by(|a, b| score(&a.1).total_cmp(&score(&b.1)));
    frames
}

/// `[height, width, 3] u8` as PNG; empty where it has no size, which leaves a gap on the page.
fn png(pixels: &[u8], width: usize, height: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let (Ok(width), Ok(height)) = (u32::try_from(width), u32::try_from(height)) else {
        return bytes;
    };
    let encoder = PngEncoder::new(&mut bytes);
    if encoder
        .write_image(pixels, width, height, ExtendedColorType::Rgb8)
        .is_err()
    {
        bytes.clear();
    }
    bytes
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}

#[cfg(test)]
mod tests;
