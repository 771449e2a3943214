//! Road masks against truth.

use std::path::Path;

use super::{ROWS, WORST, lowest, percent, png};
use crate::bad_input::BadInput;
use crate::eval::masks::{GrayFile, MaskScore, TruthKind, read_gray};
use crate::page::{Page, image};

/// Widest picture; larger ones lose every nth pixel.
const WIDTH_PX: usize = 640;

/// Road in both, called road alone, true alone, neither, and left open by the truth.
const HIT: [u8; 3] = [255, 60, 170];
const FALSE_ALARM: [u8; 3] = [255, 150, 40];
const MISS: [u8; 3] = [80, 150, 255];
const REJECTION: [u8; 3] = [44, 49, 58];
const OPEN: [u8; 3] = [90, 94, 102];

/// The page; the two folders are those that were compared.
///
/// # Errors
/// A file of them that has gone since, or changed.
pub fn render(
    score: &MaskScore,
    predictions: &Path,
    truth: &Path,
    kind: TruthKind,
) -> Result<String, BadInput> {
    let mut page = Page::new(&format!(
        "road masks: {} against {}",
        predictions.display(),
        truth.display()
    ));
    let all = &score.pooled;
    page.card("road F, pooled", &percent(all.f()), "");
    page.card("precision", &percent(all.precision()), "");
    page.card("recall", &percent(all.recall()), "");
    page.card("IoU", &percent(all.iou()), "");
    page.card("frames compared", &score.frames.len().to_string(), "");
    if !score.missing.is_empty() {
        page.card(
            "true masks without a prediction",
            &score.missing.len().to_string(),
            "bad",
        );
    }
    let frames = lowest(&score.frames, super::super::masks::PixelCount::iou);
    let mut pictures = Vec::new();
    for (name, count) in frames.iter().take(WORST) {
        let file = format!("{name}.png");
        let picture = compared(&predictions.join(&file), &truth.join(&file), kind)?;
        let caption = format!("{name}: IoU {}, F {}", percent(count.iou()), percent(count.f()));
        pictures.push((picture, caption));
    }
    let heading = "frames that differ most: pink road in both, orange called road alone, blue missed road, light gray not judged";
    page.pictures(heading, &pictures);
    let rows: Vec<Vec<String>> = (frames.iter().take(ROWS))
        .map(|(name, count)| {
            let shares = [count.iou(), count.f(), count.precision(), count.recall()].map(percent);
            [vec![name.clone()], shares.to_vec()].concat()
        })
        .collect();
    page.table(
        "frames, the furthest off first",
        &["frame", "IoU", "F", "precision", "recall"],
        &rows,
    );
    Ok(page.finish())
}

fn compared(mask: &Path, truth: &Path, kind: TruthKind) -> Result<String, BadInput> {
    let (mask, truth) = (read_gray(mask)?, read_gray(truth)?);
    let (pixels, width, height) = colours(&mask, &truth, kind);
    Ok(image("png", &png(&pixels, width, height), "mask and truth"))
}

/// `[height, width, 3] u8`, and width and height.
fn colours(mask: &GrayFile, truth: &GrayFile, kind: TruthKind) -> (Vec<u8>, usize, usize) {
    let (full_width, full_height) = (mask.width as usize, mask.height as usize);
    let step = full_width.div_ceil(WIDTH_PX).max(1);
    let (width, height) = (full_width / step, full_height / step);
    let mut pixels = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            let i = y * step * full_width + x * step;
            let true_value = truth.pixels.get(i).copied().unwrap_or_default();
            pixels.extend(match (mask.pixels[i] != 0, kind.road(true_value)) {
                (_, Ok(None) | Err(_)) => OPEN,
                (true, Ok(Some(true))) => HIT,
                (true, Ok(Some(false))) => FALSE_ALARM,
                (false, Ok(Some(true))) => MISS,
                (false, Ok(Some(false))) => REJECTION,
            });
        }
    }
    (pixels, width, height)
}
