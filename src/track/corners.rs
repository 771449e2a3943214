//! Corners: new points to track, in the parts of the image that have too few.
//!
//! In: the luma `[H, W] u8` and the pixels of the live tracks. Out: new corners, full-size pixels. The image is divided into at
//! most [`CORNER_CELLS`] cells, each wants [`CORNERS_PER_CELL`] tracks; only cells short of tracks are searched. The score is
//! the smaller eigenvalue of the mean gradient tensor over 7x7 pixels (Shi and Tomasi, "Good features to track", 1994). Below
//! the horizon the threshold is lower, so that weakly textured asphalt still gets points.
//!
//! Invariant: a new corner keeps [`MIN_DISTANCE_PX`] from every track and [`BORDER_PX`] from the border. Cost: some 15 operations a
//! pixel of the searched cells, at most [`SEARCHED_CELLS`] cells a call, in turn. When there is no room for a cell's corners the
//! search ends, and goes on there in the next call.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use nalgebra::Vector2;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::budget::{CORNER_CELL_PX, CORNER_CELLS};
use crate::frame::GrayImage;

/// Tracks wanted in a cell.
pub(crate) const CORNERS_PER_CELL: usize = 2;
/// Cells searched in one call at most.
const SEARCHED_CELLS: usize = 200;
/// Between two tracks.
const MIN_DISTANCE_PX: f32 = 9.0;
/// The tracking window with its margin must fit.
pub(crate) const BORDER_PX: usize = 11;
/// Half of the tensor's window.
const HALF_PX: usize = 3;
/// Smallest eigenvalue, in squared luma a pixel: sensor noise of 2 leaves about 2. Tuned on KITTI 03.
const MIN_SCORE: f32 = 16.0;
/// The same below the horizon, where the road is.
const MIN_SCORE_ROAD: f32 = 8.0;

/// Width of the buffers: a cell, and what the tensor's window takes around it.
const STRIDE: usize = CORNER_CELL_PX + 2 * HALF_PX;

/// Searches cells for corners.
#[derive(Clone, Debug)]
pub(crate) struct CornerFinder {
    cell_px: usize,
    columns: usize,
    rows: usize,
    /// Row from which the road's threshold holds.
    horizon_px: usize,
    taken: Box<[u8]>,
    /// Cell at which the next search begins, so that none starves.
    next: usize,
    /// Products of gradients summed along columns, then scores.
    products: [Box<[f32]>; 3],
    score: Box<[f32]>,
    found: Vec<Vector2<f32>>,
}

impl CornerFinder {
    /// A finder for `wanted` tracks over images of this size.
    pub(crate) fn new(width: usize, height: usize, horizon_px: usize, wanted: usize) -> Self {
        let cells = (wanted / CORNERS_PER_CELL).clamp(1, CORNER_CELLS);
        let mut cell_px =
            (((width * height) as f32 / cells as f32).sqrt() as usize).clamp(16, CORNER_CELL_PX);
        while cell_px < CORNER_CELL_PX && width.div_ceil(cell_px) * height.div_ceil(cell_px) > CORNER_CELLS {
            cell_px += 1;
        }
        let (columns, rows) = (width.div_ceil(cell_px), height.div_ceil(cell_px));
        let buffer = || vec![0.0f32; STRIDE * STRIDE].into_boxed_slice();
        Self {
            cell_px,
            columns,
            rows,
            horizon_px,
            taken: vec![0; columns * rows].into_boxed_slice(),
            next: 0,
            products: [buffer(), buffer(), buffer()],
            score: buffer(),
            found: Vec::with_capacity(CORNERS_PER_CELL * SEARCHED_CELLS),
        }
    }

    /// Finds at most `room` new corners.
    pub(crate) fn find(
        &mut self,
        image: &GrayImage,
        tracked: impl Iterator<Item = Vector2<f32>> + Clone,
        room: usize,
    ) -> &[Vector2<f32>] {
        self.found.clear();
        self.taken.fill(0);
        for pixel in tracked.clone() {
            let cell = self.cell_of(&pixel);
            self.taken[cell] = self.taken[cell].saturating_add(1);
        }
        let cells = self.columns * self.rows;
        let (first, mut searched) = (self.next, 0);
        for step in 0..cells {
            let cell = (first + step) % cells;
            let missing = CORNERS_PER_CELL.saturating_sub(usize::from(self.taken[cell]));
            if missing == 0 {
                continue;
            }
            if searched == SEARCHED_CELLS || self.found.len() + missing > room {
                self.next = cell;
                break;
            }
            searched += 1;
            self.search_cell(image, cell, missing, tracked.clone());
        }
        &self.found
    }

    fn search_cell(
        &mut self,
        image: &GrayImage,
        cell: usize,
        missing: usize,
        tracked: impl Iterator<Item = Vector2<f32>>,
    ) {
        let Some(area) = self.score_cell(image, cell) else {
            return;
        };
        for pixel in tracked {
            self.suppress(&area, &pixel);
        }
        for i in 0..self.found.len() {
            let pixel = self.found[i];
            self.suppress(&area, &pixel);
        }
        for _ in 0..missing {
            let Some(corner) = self.best(&area) else { return };
            self.suppress(&area, &corner);
            self.found.push(corner);
        }
    }

    fn cell_of(&self, pixel: &Vector2<f32>) -> usize {
        let column = (pixel.x.max(0.0) as usize / self.cell_px).min(self.columns - 1);
        let row = (pixel.y.max(0.0) as usize / self.cell_px).min(self.rows - 1);
        row * self.columns + column
    }

    /// Scores a cell's pixels away from the border; none where no pixel is left.
    fn score_cell(&mut self, image: &GrayImage, cell: usize) -> Option<Area> {
        let left = (cell % self.columns * self.cell_px).max(BORDER_PX);
        let top = (cell / self.columns * self.cell_px).max(BORDER_PX);
        let right = ((cell % self.columns + 1) * self.cell_px).min(image.width().saturating_sub(BORDER_PX));
        let bottom = ((cell / self.columns + 1) * self.cell_px).min(image.height().saturating_sub(BORDER_PX));
        if right <= left || bottom <= top {
            return None;
        }
        let area = Area {
            left,
            top,
            width: right - left,
            height: bottom - top,
        };
        self.gradient_products(image, &area);
        self.eigenvalues(&area);
        Some(area)
    }

    fn gradient_products(&mut self, image: &GrayImage, area: &Area) {
        let width = area.width + 2 * HALF_PX;
        let [xx, xy, yy] = &mut self.products;
        for row in 0..area.height + 2 * HALF_PX {
            let y = area.top + row - HALF_PX;
            let x = area.left - HALF_PX;
            let above = &image.row(y - 1)[x..x + width];
            let below = &image.row(y + 1)[x..x + width];
            let centre = &image.row(y)[x - 1..x + width + 1];
            let at = row * STRIDE..row * STRIDE + width;
            let (xx, xy, yy) = (&mut xx[at.clone()], &mut xy[at.clone()], &mut yy[at]);
            for i in 0..width {
                let gx = f32::from(i16::from(centre[i + 2]) - i16::from(centre[i]));
                let gy = f32::from(i16::from(below[i]) - i16::from(above[i]));
                xx[i] = gx * gx;
                xy[i] = gx * gy;
                yy[i] = gy * gy;
            }
        }
    }

    fn eigenvalues(&mut self, area: &Area) {
        const SIDE: usize = 2 * HALF_PX + 1;
        // Central differences span two pixels: a quarter of the squared difference is the squared gradient.
        const SCALE: f32 = 0.25 / (SIDE * SIDE) as f32;
        let width = area.width + 2 * HALF_PX;
        let mut columns = [[0.0f32; STRIDE]; 3];
        for row in 0..area.height {
            for (sums, product) in columns.iter_mut().zip(&self.products) {
                let sums = &mut sums[..width];
                sums.fill(0.0);
                for k in 0..SIDE {
                    let line = &product[(row + k) * STRIDE..(row + k) * STRIDE + width];
                    for i in 0..width {
                        sums[i] += line[i];
                    }
                }
            }
            let score = &mut self.score[row * STRIDE..row * STRIDE + area.width];
            for i in 0..area.width {
                let mut sum = [0.0f32; 3];
                for c in 0..3 {
                    for k in 0..SIDE {
                        sum[c] += columns[c][i + k];
                    }
                }
                let [xx, xy, yy] = sum;
                let spread = ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt();
                score[i] = 0.5 * SCALE * (xx + yy - spread);
            }
        }
    }

    /// Forbids the surroundings of a pixel.
    fn suppress(&mut self, area: &Area, pixel: &Vector2<f32>) {
        let x = pixel.x - area.left as f32;
        let y = pixel.y - area.top as f32;
        let reach = MIN_DISTANCE_PX;
        if !(x > -reach && y > -reach && x < area.width as f32 + reach && y < area.height as f32 + reach) {
            return;
        }
        let span = |centre: f32, size: usize| {
            let first = (centre - reach).max(0.0).ceil() as usize;
            let end = ((centre + reach).max(0.0) as usize + 1).min(size);
            (first.min(size), end)
        };
        let (x0, x1) = span(x, area.width);
        let (y0, y1) = span(y, area.height);
        for row in y0..y1 {
            let line = row * STRIDE;
            self.score[line + x0.min(x1)..line + x1].fill(0.0);
        }
    }

    fn best(&self, area: &Area) -> Option<Vector2<f32>> {
        let mut best = (0.0, 0, 0);
        for row in 0..area.height {
            let line = &self.score[row * STRIDE..row * STRIDE + area.width];
            for (column, score) in line.iter().enumerate() {
                if *score > best.0 {
                    best = (*score, column, row);
                }
            }
        }
        let (score, column, row) = best;
        let (x, y) = (area.left + column, area.top + row);
        let needed = if y >= self.horizon_px {
            MIN_SCORE_ROAD
        } else {
            MIN_SCORE
        };
        (score >= needed).then(|| Vector2::new(x as f32, y as f32))
    }
}

/// Pixels of a cell that may become corners.
struct Area {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(width: usize, height: usize, contrast: u32) -> GrayImage {
        let mut image = GrayImage::new(width, height);
        let mut state = 7u32;
        for pixel in image.pixels_mut() {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *pixel = 100 + ((state >> 16) % contrast.max(1)) as u8;
        }
        image
    }

    fn found(finder: &mut CornerFinder, image: &GrayImage, tracked: &[Vector2<f32>]) -> Vec<Vector2<f32>> {
        finder.find(image, tracked.iter().copied(), 500).to_vec()
    }

    #[test]
    fn texture_is_covered_evenly_and_not_twice() {
        let image = noise(320, 200, 100);
        let mut finder = CornerFinder::new(320, 200, 100, 100);
        let corners = found(&mut finder, &image, &[]);
        assert!(corners.len() >= 80, "{}", corners.len());
        for quarter in 0..4 {
            let inside = corners
                .iter()
                .filter(|c| (c.x as usize / 160) + 2 * (c.y as usize / 100) == quarter)
                .count();
            assert!(inside >= 15);
        }
        for (i, a) in corners.iter().enumerate() {
            assert!(corners[i + 1..].iter().all(|b| (a - b).amax() >= MIN_DISTANCE_PX));
        }
        assert!(found(&mut finder, &image, &corners).len() <= 10);
    }

    #[test]
    fn sky_and_walls_have_no_corners_but_dull_asphalt_has() {
        let mut finder = CornerFinder::new(320, 200, 100, 100);
        assert!(found(&mut finder, &GrayImage::new(320, 200), &[]).is_empty());
        let dull = noise(320, 200, 15);
        let corners = found(&mut finder, &dull, &[]);
        assert!(corners.len() > 30 && corners.iter().all(|c| c.y >= 100.0));
    }

    #[test]
    fn an_image_too_small_has_none() {
        let image = noise(16, 12, 100);
        assert!(found(&mut CornerFinder::new(16, 12, 0, 100), &image, &[]).is_empty());
    }
}
