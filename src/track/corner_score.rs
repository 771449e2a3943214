//! Corner score: how well each pixel of a rectangle can be tracked.
//!
//! In: the luma `[H, W] u8` and an [`Area`] of it. Out: for each of its pixels the smaller eigenvalue of the mean gradient tensor
//! over 7x7 pixels (Shi and Tomasi, "Good features to track", 1994), in squared luma a pixel. Sums are of whole numbers below 2^24,
//! so they are exact in f32 and can be kept running down the columns. Invariant: what was suppressed scores 0. Cost: some 40
//! operations a pixel, eight pixels at a time. An area is at most [`CORNER_CELL_PX`] wide and high.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::Vector2;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::budget::CORNER_CELL_PX;
use crate::frame::GrayImage;

/// Half of the tensor's window.
const HALF_PX: usize = 3;
const SIDE: usize = 2 * HALF_PX + 1;
/// Pixels around an area that its score looks at.
pub(crate) const MARGIN_PX: usize = HALF_PX + 1;
/// Width of the buffers: an area, what the tensor's window takes around it, and what fills the last vector register.
const STRIDE: usize = (CORNER_CELL_PX + 2 * HALF_PX).next_multiple_of(8) + 8;
/// Central differences span two pixels: a quarter of the squared difference is the squared gradient.
const SCALE: f32 = 0.25 / (SIDE * SIDE) as f32;

type Line = [f32; STRIDE];

/// A rectangle of pixels, [`MARGIN_PX`] away from the image's border.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Area {
    pub(crate) left: usize,
    pub(crate) top: usize,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

/// The scores of one area, with the buffers to compute them.
#[derive(Clone, Debug)]
pub(crate) struct CornerScore {
    area: Area,
    /// Products of gradients (xx, xy, yy) of the last [`SIDE`] rows, and their sums down the columns.
    products: Box<[[Line; 3]; SIDE]>,
    columns: [Line; 3],
    score: Box<[Line]>,
}

impl CornerScore {
    pub(crate) fn new() -> Self {
        Self {
            area: Area {
                left: 0,
                top: 0,
                width: 0,
                height: 0,
            },
            products: Box::new([[[0.0; STRIDE]; 3]; SIDE]),
            columns: [[0.0; STRIDE]; 3],
            score: vec![[0.0; STRIDE]; CORNER_CELL_PX].into_boxed_slice(),
        }
    }

    /// Scores an area's pixels.
    pub(crate) fn compute(&mut self, image: &GrayImage, area: &Area) {
        self.area = *area;
        self.columns = [[0.0; STRIDE]; 3];
        for row in 0..area.height + 2 * HALF_PX {
            self.add_row(image, row);
            if row + 1 >= SIDE {
                let score = &mut self.score[row + 1 - SIDE];
                score_row(&self.columns, area.width, score);
            }
        }
    }

    /// Adds a row of products to the sums, takes the one out that leaves the window.
    fn add_row(&mut self, image: &GrayImage, row: usize) {
        let width = self.area.width + 2 * HALF_PX;
        let (x, y) = (self.area.left - HALF_PX, self.area.top + row - HALF_PX);
        let above = &image.row(y - 1)[x..x + width];
        let below = &image.row(y + 1)[x..x + width];
        let left = &image.row(y)[x - 1..][..width];
        let right = &image.row(y)[x + 1..][..width];
        let is_full = row >= SIDE;
        let [xx, xy, yy] = &mut self.products[row % SIDE];
        let [sum_xx, sum_xy, sum_yy] = &mut self.columns;
        if !is_full {
            xx.fill(0.0);
            xy.fill(0.0);
            yy.fill(0.0);
        }
        let (xx, xy, yy) = (&mut xx[..width], &mut xy[..width], &mut yy[..width]);
        let (sum_xx, sum_xy, sum_yy) = (&mut sum_xx[..width], &mut sum_xy[..width], &mut sum_yy[..width]);
        for i in 0..width {
            let gx = f32::from(right[i]) - f32::from(left[i]);
            let gy = f32::from(below[i]) - f32::from(above[i]);
            let (new_xx, new_xy, new_yy) = (gx * gx, gx * gy, gy * gy);
            sum_xx[i] += new_xx - xx[i];
            sum_xy[i] += new_xy - xy[i];
            sum_yy[i] += new_yy - yy[i];
            xx[i] = new_xx;
            xy[i] = new_xy;
            yy[i] = new_yy;
        }
    }

    /// Forbids the pixels within `reach_px` of a pixel, in both directions.
    pub(crate) fn suppress(&mut self, pixel: &Vector2<f32>, reach_px: f32) {
        let (width, height) = (self.area.width, self.area.height);
        let x = pixel.x - self.area.left as f32;
        let y = pixel.y - self.area.top as f32;
        if !(x > -reach_px && y > -reach_px && x < width as f32 + reach_px && y < height as f32 + reach_px) {
            return;
        }
        let span = |centre: f32, size: usize| {
            let end = ((centre + reach_px).max(0.0) as usize + 1).min(size);
            let first = (centre - reach_px).max(0.0).ceil() as usize;
            first.min(end)..end
        };
        for line in &mut self.score[span(y, height)] {
            line[span(x, width)].fill(0.0);
        }
    }

    /// The best pixel and its score; score 0 where nothing is left.
    pub(crate) fn best(&self) -> (f32, usize, usize) {
        let mut best = (0.0, 0, 0);
        for (row, line) in self.score[..self.area.height].iter().enumerate() {
            let line = &line[..self.area.width];
            // Most rows hold nothing better: eight lanes tell.
            let mut lanes = [0.0f32; 8];
            let (chunks, rest) = line.as_chunks::<8>();
            for chunk in chunks {
                for i in 0..8 {
                    lanes[i] = if chunk[i] > lanes[i] { chunk[i] } else { lanes[i] };
                }
            }
            if lanes.iter().chain(rest).all(|score| *score <= best.0) {
                continue;
            }
            for (column, score) in line.iter().enumerate() {
                if *score > best.0 {
                    best = (*score, column, row);
                }
            }
        }
        let (score, column, row) = best;
        (score, self.area.left + column, self.area.top + row)
    }
}

/// Sums along the row, and the smaller eigenvalue.
fn score_row(columns: &[Line; 3], width: usize, score: &mut Line) {
    let mut sums = [[0.0f32; STRIDE]; 3];
    for (sum, column) in sums.iter_mut().zip(columns) {
        let mut pairs = [0.0f32; STRIDE];
        for i in 0..STRIDE - 1 {
            pairs[i] = column[i] + column[i + 1];
        }
        for i in 0..width.min(STRIDE - 6) {
            sum[i] = pairs[i] + pairs[i + 2] + pairs[i + 4] + column[i + 6];
        }
    }
    let [xx, xy, yy] = &sums;
    for i in 0..width.min(STRIDE) {
        let spread = ((xx[i] - yy[i]) * (xx[i] - yy[i]) + 4.0 * xy[i] * xy[i]).sqrt();
        score[i] = 0.5 * SCALE * (xx[i] + yy[i] - spread);
    }
}
