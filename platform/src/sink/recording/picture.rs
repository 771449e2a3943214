//! Pictures of a key frame: the mask at the input's size, the overlay, and the bird's-eye view of the grid.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

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

/// Road labels, `[height, width] u8`, 0 or 1.
#[derive(Clone, Copy, Debug)]
pub struct MaskView<'a> {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Labels.
    pub labels: &'a [u8],
}

/// Source coordinate of a target pixel's centre: lower neighbour, upper neighbour, weight of the upper one.
fn taps(target: usize, source: usize) -> Vec<(usize, usize, f32)> {
    let scale = source as f32 / target as f32;
    (0..target)
        .map(|i| {
            let at = ((i as f32 + 0.5) * scale - 0.5).clamp(0.0, (source - 1) as f32);
            let low = at as usize;
            (low, (low + 1).min(source - 1), at - low as f32)
        })
        .collect()
}

impl MaskView<'_> {
    /// The mask at `width` x `height`, bilinear and cut at one half, 0 or 1.
    #[must_use]
    pub fn upsampled(&self, width: usize, height: usize) -> Vec<u8> {
        let label = |x: usize, y: usize| f32::from(u8::from(self.labels[y * self.width + x] != 0));
        let columns = taps(width, self.width);
        let mut out = Vec::with_capacity(width * height);
        for (top, bottom, down) in taps(height, self.height) {
            for &(left, right, along) in &columns {
                let upper = label(left, top) * (1.0 - along) + label(right, top) * along;
                let lower = label(left, bottom) * (1.0 - along) + label(right, bottom) * along;
                out.push(u8::from(upper * (1.0 - down) + lower * down >= 0.5));
            }
        }
        out
    }
}

/// Road tint, boundary and outline colours.
const ROAD: [u8; 3] = [40, 200, 120];
const BOUNDARY: [u8; 3] = [250, 250, 120];
const OUTLINE: [u8; 3] = [255, 110, 60];

fn mixed(pixel: [u8; 3], tint: [u8; 3], eighths: u16) -> [u8; 3] {
    std::array::from_fn(|c| ((u16::from(pixel[c]) * (8 - eighths) + u16::from(tint[c]) * eighths) / 8) as u8)
}

/// The frame with its road tinted, the road's edge and the outlines drawn, `[height, width, 3] u8`.
pub(super) fn overlay(image: &ImageView<'_>, mask: &[u8], outlines: &[[(f32, f32); 2]]) -> Vec<u8> {
    let (width, height) = (image.width, image.height);
    let mut out = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            let pixel = match image.channels {
                1 => [image.bytes[i]; 3],
                _ => std::array::from_fn(|c| image.bytes[i * 3 + c]),
            };
            let road = mask[i] != 0;
            let edge = road
                && ((x > 0 && mask[i - 1] == 0)
                    || (x + 1 < width && mask[i + 1] == 0)
                    || (y > 0 && mask[i - width] == 0)
                    || (y + 1 < height && mask[i + width] == 0));
            out.extend(match (edge, road) {
                (true, _) => mixed(pixel, BOUNDARY, 7),
                (false, true) => mixed(pixel, ROAD, 3),
                (false, false) => pixel,
            });
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
    canvas.pixels
}

/// An RGB picture.
pub(super) struct Canvas {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) pixels: Vec<u8>,
}

impl Canvas {
    fn set(&mut self, x: f64, y: f64, colour: [u8; 3], eighths: u16) {
        if x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
            return;
        }
        let i = 3 * (y as usize * self.width + x as usize);
        let pixel = std::array::from_fn(|c| self.pixels[i + c]);
        self.pixels[i..i + 3].copy_from_slice(&mixed(pixel, colour, eighths));
    }

    /// A line, cut off at the picture's edge; steps are capped by the picture's size.
    fn line(&mut self, from: (f32, f32), to: (f32, f32), colour: [u8; 3]) {
        let (x0, y0) = (f64::from(from.0), f64::from(from.1));
        let (dx, dy) = (f64::from(to.0) - x0, f64::from(to.1) - y0);
        if !(dx.is_finite() && dy.is_finite() && x0.is_finite() && y0.is_finite()) {
            return;
        }
        let cap = 4.0 * (self.width + self.height) as f64;
        let steps = dx.abs().max(dy.abs()).clamp(1.0, cap).ceil();
        for step in 0..=steps as usize {
            let part = step as f64 / steps;
            self.set((x0 + part * dx).round(), (y0 + part * dy).round(), colour, 7);
        }
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

const UNKNOWN: [u8; 3] = [74, 78, 86];
const OUTSIDE: [u8; 3] = [30, 33, 39];
const OCCUPIED: [u8; 3] = [126, 28, 32];
const FREE: [u8; 3] = [66, 178, 104];
const RING: [u8; 3] = [235, 235, 235];
const CAR: [u8; 3] = [90, 160, 250];

/// Green for free, dark red for occupied, dim in between.
fn cell_colour(value: i8) -> [u8; 3] {
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

/// The grid seen from above, ahead up and left to the left, with rings each 10 m and the car.
pub(super) fn birdseye(layout: &GridLayout, cells: &[i8]) -> Canvas {
    let [near_m, right_m] = layout.origin_in_vehicle_m;
    let cell_px = (VIEW_HEIGHT_PX / layout.rows.max(1)).max(1);
    let px_per_m = cell_px as f64 / layout.cell_m;
    let below = ((near_m + BEHIND_M) * px_per_m)
        .clamp(0.0, VIEW_HEIGHT_PX as f64)
        .round() as usize;
    let (width, height) = (layout.columns * cell_px, layout.rows * cell_px + below);
    let mut canvas = Canvas {
        width,
        height,
        pixels: OUTSIDE.repeat(width * height),
    };
    for y in 0..layout.rows * cell_px {
        let row = layout.rows - 1 - y / cell_px;
        for x in 0..width {
            let column = layout.columns - 1 - x / cell_px;
            let colour = cell_colour(cells[row * layout.columns + column]);
            canvas.pixels[3 * (y * width + x)..][..3].copy_from_slice(&colour);
        }
    }
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
    let (rear, front, half) = CAR_M;
    let (x0, y0) = place(front, half);
    let (x1, y1) = place(rear, -half);
    for y in y0.max(0.0) as usize..=y1.clamp(0.0, height as f64) as usize {
        for x in x0.max(0.0) as usize..=x1.max(0.0) as usize {
            canvas.set(x as f64, y as f64, CAR, 6);
        }
    }
    canvas
}
