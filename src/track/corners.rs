//! Corners: new points to track, in the parts of the image that have too few.
//!
//! In: the luma `[H, W] u8` and the pixels of the live tracks. Out: new corners, full-size pixels, by their [`CornerScore`]. The
//! image is divided into at most [`CORNER_CELLS`] cells, each wants [`CORNERS_PER_CELL`] tracks; only cells short of tracks are
//! searched. Below the horizon the threshold is lower, so that weakly textured asphalt still gets points.
//!
//! Invariant: a new corner keeps [`MIN_DISTANCE_PX`] from every track and [`BORDER_PX`] from the border. Cost: at most as many
//! cells a call as the caller allows, in turn. When there is no room for a cell's corners the search ends, and goes on there
//! in the next call. Where a search found nothing it rests for [`REST_CALLS`] calls.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
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

use super::corner_score::{Area, CornerScore, MARGIN_PX};
use crate::budget::{CORNER_CELL_PX, CORNER_CELLS, MAX_TRACKS};
use crate::frame::GrayImage;

/// Tracks wanted in a cell.
pub(crate) const CORNERS_PER_CELL: usize = 2;
/// Narrowest cell: a corner is kept away by tracks in the cells beside its own only.
const MIN_CELL_PX: usize = 16;
/// Between two tracks.
const MIN_DISTANCE_PX: f32 = 9.0;
/// The tracking window with its margin must fit.
pub(crate) const BORDER_PX: usize = 11;
const _: () = assert!(BORDER_PX >= MARGIN_PX && MIN_CELL_PX as f32 > MIN_DISTANCE_PX);
/// Smallest eigenvalue, in squared luma a pixel: sensor noise of 2 leaves about 2. Tuned on KITTI 03.
const MIN_SCORE: f32 = 16.0;
/// The same below the horizon, where the road is.
const MIN_SCORE_ROAD: f32 = 8.0;
/// Calls for which a cell rests that had too few corners.
const REST_CALLS: u8 = 0;

/// A pixel that corners keep away from, and the next one of its cell.
#[derive(Clone, Copy, Debug)]
struct Taken {
    pixel: Vector2<f32>,
    next: u16,
}

/// End of a cell's list.
const NONE: u16 = u16::MAX;

/// A cell of the image.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Tracks in it, and the first of its list.
    tracks: u16,
    first: u16,
    /// Calls that it rests for yet.
    rest: u8,
}

/// Searches cells for corners.
#[derive(Clone, Debug)]
pub(crate) struct CornerFinder {
    cell_px: usize,
    columns: usize,
    rows: usize,
    /// Row from which the road's threshold holds.
    horizon_px: usize,
    cells: Box<[Cell]>,
    taken: Vec<Taken>,
    /// Cell at which the next search begins, so that none starves.
    next: usize,
    score: CornerScore,
    found: Vec<Vector2<f32>>,
}

impl CornerFinder {
    /// A finder for `wanted` tracks over images of this size.
    pub(crate) fn new(width: usize, height: usize, horizon_px: usize, wanted: usize) -> Self {
        let cells = (wanted / CORNERS_PER_CELL).clamp(1, CORNER_CELLS);
        let mut cell_px =
            (((width * height) as f32 / cells as f32).sqrt() as usize).clamp(MIN_CELL_PX, CORNER_CELL_PX);
        while cell_px < CORNER_CELL_PX && width.div_ceil(cell_px) * height.div_ceil(cell_px) > CORNER_CELLS {
            cell_px += 1;
        }
        let (columns, rows) = (width.div_ceil(cell_px), height.div_ceil(cell_px));
        let empty = Cell {
            tracks: 0,
            first: NONE,
            rest: 0,
        };
        Self {
            cell_px,
            columns,
            rows,
            horizon_px,
            cells: vec![empty; columns * rows].into_boxed_slice(),
            taken: Vec::with_capacity(2 * MAX_TRACKS),
            next: 0,
            score: CornerScore::new(),
            found: Vec::with_capacity(MAX_TRACKS),
        }
    }

    /// Finds at most `room` new corners in at most `most_cells` cells.
    pub(crate) fn find(
        &mut self,
        image: &GrayImage,
        tracked: impl Iterator<Item = Vector2<f32>>,
        room: usize,
        most_cells: usize,
    ) -> &[Vector2<f32>] {
        self.found.clear();
        self.taken.clear();
        for cell in &mut self.cells {
            cell.tracks = 0;
            cell.first = NONE;
            cell.rest = cell.rest.saturating_sub(1);
        }
        for pixel in tracked.take(MAX_TRACKS) {
            self.take(pixel);
        }
        let room = room.min(MAX_TRACKS);
        let cells = self.cells.len();
        let (first, mut searched) = (self.next, 0);
        for step in 0..cells {
            let index = (first + step) % cells;
            let cell = self.cells[index];
            let missing = CORNERS_PER_CELL.saturating_sub(usize::from(cell.tracks));
            if missing == 0 || cell.rest > 0 {
                continue;
            }
            if searched == most_cells || self.found.len() + missing > room {
                self.next = index;
                break;
            }
            searched += 1;
            if self.search_cell(image, index, missing) < missing {
                self.cells[index].rest = REST_CALLS;
            }
        }
        &self.found
    }

    /// Corners found in a cell.
    fn search_cell(&mut self, image: &GrayImage, cell: usize, missing: usize) -> usize {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let left = (column * self.cell_px).max(BORDER_PX);
        let top = (row * self.cell_px).max(BORDER_PX);
        let right = ((column + 1) * self.cell_px).min(image.width().saturating_sub(BORDER_PX));
        let bottom = ((row + 1) * self.cell_px).min(image.height().saturating_sub(BORDER_PX));
        if right <= left || bottom <= top {
            return 0;
        }
        let area = Area {
            left,
            top,
            width: right - left,
            height: bottom - top,
        };
        self.score.compute(image, &area);
        for y in row.saturating_sub(1)..(row + 2).min(self.rows) {
            for x in column.saturating_sub(1)..(column + 2).min(self.columns) {
                let mut at = self.cells[y * self.columns + x].first;
                while let Some(taken) = self.taken.get(usize::from(at)) {
                    self.score.suppress(&taken.pixel, MIN_DISTANCE_PX);
                    at = taken.next;
                }
            }
        }
        for found in 0..missing {
            let (score, x, y) = self.score.best();
            let needed = if y >= self.horizon_px {
                MIN_SCORE_ROAD
            } else {
                MIN_SCORE
            };
            if score < needed {
                return found;
            }
            let corner = Vector2::new(x as f32, y as f32);
            self.score.suppress(&corner, MIN_DISTANCE_PX);
            self.found.push(corner);
            self.take(corner);
        }
        missing
    }

    /// Keeps later corners away from a pixel.
    fn take(&mut self, pixel: Vector2<f32>) {
        let column = (pixel.x.max(0.0) as usize / self.cell_px).min(self.columns - 1);
        let row = (pixel.y.max(0.0) as usize / self.cell_px).min(self.rows - 1);
        let cell = &mut self.cells[row * self.columns + column];
        let index = self.taken.len() as u16;
        self.taken.push(Taken {
            pixel,
            next: cell.first,
        });
        cell.first = index;
        cell.tracks += 1;
    }
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
        finder
            .find(image, tracked.iter().copied(), 500, CORNER_CELLS)
            .to_vec()
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
