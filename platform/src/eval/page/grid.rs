//! Free-space grids against truth.

use std::path::Path;

use super::{ROWS, WORST, lowest, percent, png};
use crate::bad_input::BadInput;
use crate::eval::grid::{CellCount, GridScore, read};
use crate::page::{Page, image};
use crate::sink::recording::birdseye;

/// The page; the two folders are those that were compared, up to `range_m` ahead.
///
/// # Errors
/// A file of them that has gone since, or changed.
pub fn render(score: &GridScore, predictions: &Path, truth: &Path, range_m: f64) -> Result<String, BadInput> {
    let mut page = Page::new(&format!(
        "grids: {} against {}",
        predictions.display(),
        truth.display()
    ));
    let all = &score.pooled;
    let range = format!("free-space IoU, 0 to {range_m:.0} m");
    page.card(&range, &format!("{:.4}", all.iou()), "");
    page.card(
        "cells called free that are occupied",
        &all.falsely_free.to_string(),
        "",
    );
    page.card("cells that the truth has seen", &all.seen.to_string(), "");
    page.card("key frames compared", &score.frames.len().to_string(), "");
    if !score.missing.is_empty() {
        page.card(
            "true grids without a prediction",
            &score.missing.len().to_string(),
            "bad",
        );
    }
    let frames = lowest(&score.frames, CellCount::iou);
    let mut pictures = Vec::new();
    for (name, count) in frames.iter().take(WORST) {
        let file = format!("{name}.npy");
        let pair = [predictions, truth].map(|folder| seen_from_above(&folder.join(&file)));
        let [called, known] = pair;
        let html = format!("<div class=\"side\">{}{}</div>", called?, known?);
        let falsely = count.falsely_free;
        pictures.push((
            html,
            format!(
                "{name}: IoU {}, {falsely} cells falsely free",
                percent(count.iou())
            ),
        ));
    }
    let heading = "key frames that differ most: left as called, right the truth; green free, red occupied, gray unknown";
    page.pictures(heading, &pictures);
    let rows: Vec<Vec<String>> = (frames.iter().take(ROWS))
        .map(|(name, count)| {
            vec![
                name.clone(),
                format!("{:.4}", count.iou()),
                count.falsely_free.to_string(),
                count.seen.to_string(),
            ]
        })
        .collect();
    page.table(
        "key frames, the furthest off first",
        &["key frame", "IoU", "falsely free", "seen"],
        &rows,
    );
    Ok(page.finish())
}

fn seen_from_above(file: &Path) -> Result<String, BadInput> {
    let (layout, cells) = read(file)?;
    let mut pixels = Vec::new();
    let (width, height) = birdseye(&layout, &cells, &mut pixels);
    Ok(image("png", &png(&pixels, width, height), "grid seen from above"))
}
