//! Pictures of a key frame: the mask at the input's size, the overlay, and the bird's-eye view of the grid.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use super::canvas::{Anchor, Canvas, Colour, mixed, text_width};
use crate::eval::grid::{FREE_BELOW, GridLayout};

/// A frame, one byte a pixel or three, row-major.
#[derive(Clone, Copy, Debug)]
pub struct ImageView<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// 1 gray, 3 red green blue.
    pub channels: usize,
    /// `[height, width, channels] u8`.
    pub bytes: &'a [u8],
}

/// Where a target pixel's centre lies in the source: lower neighbour, upper neighbour, weight of the upper one.
type Tap = (usize, usize, f32);

fn taps(target: usize, source: usize) -> Box<[Tap]> {
    let scale = source as f32 / target as f32;
    let last = source.saturating_sub(1);
    (0..target)
        .map(|i| {
            let at = ((i as f32 + 0.5) * scale - 0.5).clamp(0.0, last as f32);
            let low = at as usize;
            (low, (low + 1).min(last), at - low as f32)
        })
        .collect()
}

/// Brings road labels from the working resolution to that of the camera: bilinear, cut at one half.
#[derive(Clone, Debug)]
pub struct Upsampler {
    columns: Box<[Tap]>,
    rows: Box<[Tap]>,
    source_width: usize,
    /// Two source rows, already interpolated along x, and which they are.
    upper: (Option<usize>, Box<[f32]>),
    lower: (Option<usize>, Box<[f32]>),
}

impl Upsampler {
    /// From one width and height to another.
    #[must_use]
    pub fn new(from: (usize, usize), to: (usize, usize)) -> Self {
        let row = || (None, vec![0.0; to.0].into_boxed_slice());
        Self {
            columns: taps(to.0, from.0),
            rows: taps(to.1, from.1),
            source_width: from.0,
            upper: row(),
            lower: row(),
        }
    }

    /// Writes `labels`, row-major, not 0 = road, to `out` at the other size, 0 or 1.
    pub fn upsample(&mut self, labels: &[u8], out: &mut [u8]) {
        (self.upper.0, self.lower.0) = (None, None);
        let width = self.columns.len();
        for (row, &(top, bottom, down)) in out.chunks_exact_mut(width.max(1)).zip(&self.rows) {
            if self.upper.0 != Some(top) && self.lower.0 == Some(top) {
                std::mem::swap(&mut self.upper, &mut self.lower);
            }
            for (kept, wanted) in [(&mut self.upper, top), (&mut self.lower, bottom)] {
                if kept.0 != Some(wanted) {
                    let source = &labels[wanted * self.source_width..][..self.source_width];
                    along(source, &self.columns, &mut kept.1);
                    kept.0 = Some(wanted);
                }
            }
            for ((to, upper), lower) in row.iter_mut().zip(&self.upper.1).zip(&self.lower.1) {
                *to = u8::from(upper * (1.0 - down) + lower * down >= 0.5);
            }
        }
    }
}

fn along(source: &[u8], columns: &[Tap], out: &mut [f32]) {
    let label = |x: usize| f32::from(u8::from(source[x] != 0));
    for (to, &(left, right, part)) in out.iter_mut().zip(columns) {
        *to = label(left) * (1.0 - part) + label(right) * part;
    }
}

/// Road tint, boundary and outline colours: pink is the road in the paper's figures.
const ROAD: Colour = [255, 60, 170];
const BOUNDARY: Colour = [250, 250, 120];
const OUTLINE: Colour = [255, 110, 60];

/// Draws the frame with its road tinted, the road's edge and the outlines into `out`, `[height, width, 3] u8`.
pub(super) fn overlay(image: &ImageView<'_>, mask: &[u8], outlines: &[[(f32, f32); 2]], out: &mut Vec<u8>) {
    let (width, height) = (image.width, image.height);
    out.clear();
    match image.channels {
        1 => out.extend(image.bytes.iter().flat_map(|luma| [*luma; 3])),
        _ => out.extend_from_slice(image.bytes),
    }
    for y in 0..height {
        let first = y * width;
        for x in (0..width).filter(|x| mask[first + x] != 0) {
            let i = first + x;
            let is_edge = (x > 0 && mask[i - 1] == 0)
                || (x + 1 < width && mask[i + 1] == 0)
                || (y > 0 && mask[i - width] == 0)
                || (y + 1 < height && mask[i + width] == 0);
            let (tint, eighths) = if is_edge { (BOUNDARY, 7) } else { (ROAD, 3) };
            let pixel = std::array::from_fn(|c| out[3 * i + c]);
            out[3 * i..3 * i + 3].copy_from_slice(&mixed(pixel, tint, eighths));
        }
    }
    let mut canvas = Canvas {
        width,
        height,
        pixels: out,
    };
    for [from, to] in outlines {
        canvas.line(*from, *to, OUTLINE);
    }
}

/// Height in pixels that the bird's-eye view aims at.
const VIEW_HEIGHT_PX: usize = 480;
/// What is shown behind the vehicle's origin, so that the car is in the picture.
const BEHIND_M: f64 = 1.5;
/// Distance between the rings.
const RING_M: f64 = 10.0;
/// Outline of the car around the rear axle: rear, front, half width.
const CAR_M: (f64, f64, f64) = (-1.0, 3.6, 0.9);

const UNKNOWN: Colour = [74, 78, 86];
const OUTSIDE: Colour = [30, 33, 39];
const OCCUPIED: Colour = [126, 28, 32];
const FREE: Colour = [66, 178, 104];
const RING: Colour = [235, 235, 235];
const CAR: Colour = [90, 160, 250];

/// Green for free, dark red for occupied, dim in between.
fn cell_colour(value: i8) -> Colour {
    match value {
        ..0 => UNKNOWN,
        0..FREE_BELOW => mixed(FREE, UNKNOWN, value.unsigned_abs() as u16 / 8),
        _ => mixed(
            OCCUPIED,
            UNKNOWN,
            u16::from(100 - value.unsigned_abs().min(100)) / 8,
        ),
    }
}

/// The scale bar's length, and its distance from the picture's corner.
const SCALE_M: f64 = 10.0;
const SCALE_MARGIN_PX: f64 = 10.0;

/// A bar of [`SCALE_M`] in the lower left corner of a view of that height, its length above it; nothing where it does not fit.
fn draw_scale(canvas: &mut Canvas<'_>, px_per_m: f64, height: usize) {
    let length = (SCALE_M * px_per_m).round();
    let (left, bottom) = (SCALE_MARGIN_PX, height as f64 - SCALE_MARGIN_PX);
    let right = left + length;
    if right + SCALE_MARGIN_PX > canvas.width as f64 || bottom < 40.0 {
        return;
    }
    canvas.rectangle((left, bottom - 3.0), (right, bottom), RING, 8);
    for x in [left, right - 2.0] {
        canvas.rectangle((x, bottom - 9.0), (x + 2.0, bottom), RING, 8);
    }
    let label = format!("{SCALE_M:.0} m");
    canvas.text(
        (0.5 * (left + right), bottom - 13.0),
        Anchor::Middle,
        2,
        &label,
        RING,
    );
}

/// Height of the strip below the grid that says what the colours mean.
const LEGEND_PX: usize = 24;
/// Between a swatch and its name.
const SWATCH_GAP_PX: f64 = 5.0;

/// What the colours of the cells say, along the lower edge, in letters as large as there is room for.
fn draw_legend(canvas: &mut Canvas<'_>) {
    let entries = [("free", 0), ("occupied", 100), ("unknown", -1)];
    let entry_width = |name, size: f64| 7.0 * size + SWATCH_GAP_PX + text_width(name, size);
    let total = |size| -> f64 { entries.iter().map(|(name, _)| entry_width(name, size)).sum() };
    let room = canvas.width as f64;
    let Some(size) = [2_usize, 1]
        .into_iter()
        .find(|size| total(*size as f64) + 32.0 <= room)
    else {
        return;
    };
    let gap = (room - total(size as f64)) / (entries.len() + 1) as f64;
    let side = 7.0 * size as f64;
    let bottom = canvas.height as f64 - 0.5 * (LEGEND_PX as f64 - side);
    let mut left = gap;
    for (name, value) in entries {
        canvas.rectangle(
            (left, bottom - side),
            (left + side, bottom),
            cell_colour(value),
            8,
        );
        canvas.text(
            (left + side + SWATCH_GAP_PX, bottom),
            Anchor::Left,
            size,
            name,
            RING,
        );
        left += entry_width(name, size as f64) + gap;
    }
}

/// Draws the grid seen from above into `out`, ahead up and left to the left, with rings each 10 m, a scale bar, a legend and the
/// car; gives width and height.
pub(crate) fn birdseye(layout: &GridLayout, cells: &[i8], out: &mut Vec<u8>) -> (usize, usize) {
    let [near_m, right_m] = layout.origin_in_vehicle_m;
    let cell_px = (VIEW_HEIGHT_PX / layout.rows.max(1)).max(1);
    let px_per_m = cell_px as f64 / layout.cell_m;
    let below = ((near_m + BEHIND_M) * px_per_m)
        .clamp(0.0, VIEW_HEIGHT_PX as f64)
        .round() as usize;
    let (width, height) = (layout.columns * cell_px, layout.rows * cell_px + below);
    let mut canvas = Canvas::filled(out, width, height + LEGEND_PX, OUTSIDE);
    draw_cells(&mut canvas, layout, cells, cell_px);
    let grid_bottom = (layout.rows * cell_px) as f64;
    let place = |ahead_m: f64, left_m: f64| {
        let x = width as f64 - (left_m - right_m) * px_per_m;
        (x, grid_bottom - (ahead_m - near_m) * px_per_m)
    };
    for ring in 1..=10 {
        let radius_m = f64::from(ring) * RING_M;
        let steps = (2.0 * std::f64::consts::PI * radius_m * px_per_m) as usize;
        for step in 0..steps.min(20_000) {
            let (sin, cos) = (step as f64 / steps as f64 * std::f64::consts::TAU).sin_cos();
            let (x, y) = place(radius_m * cos, radius_m * sin);
            canvas.set(x, y, RING, 3);
        }
    }
    draw_scale(&mut canvas, px_per_m, height);
    draw_legend(&mut canvas);
    let (rear, front, half) = CAR_M;
    let (x0, y0) = place(front, half);
    let (x1, y1) = place(rear, -half);
    for y in y0.max(0.0) as usize..=y1.clamp(0.0, height as f64) as usize {
        for x in x0.max(0.0) as usize..=x1.max(0.0) as usize {
            canvas.set(x as f64, y as f64, CAR, 6);
        }
    }
    (width, height + LEGEND_PX)
}

fn draw_cells(canvas: &mut Canvas<'_>, layout: &GridLayout, cells: &[i8], cell_px: usize) {
    let stride = 3 * canvas.width;
    for (row, cells) in cells.chunks_exact(layout.columns.max(1)).rev().enumerate() {
        let top = row * cell_px * stride;
        let colours = cells.iter().rev().map(|cell| cell_colour(*cell));
        for (pixels, colour) in canvas.pixels[top..top + stride]
            .chunks_exact_mut(3 * cell_px)
            .zip(colours)
        {
            for pixel in pixels.chunks_exact_mut(3) {
                pixel.copy_from_slice(&colour);
            }
        }
        for copy in 1..cell_px {
            canvas.pixels.copy_within(top..top + stride, top + copy * stride);
        }
    }
}
