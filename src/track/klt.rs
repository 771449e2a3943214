//! Pyramidal Lucas-Kanade: where a window of the last frame is in this one.
//!
//! In: two pyramids, a pixel in the first and a [`Guess`] of its place and of how its surroundings stretch. Out: a [`Match`]
//! in full-size pixels with the correlation of both windows. Inverse compositional (Baker and Matthews 2004): gradient and
//! normal matrix come from the window of the first image, once a level. That gradient is made orthogonal to a constant and
//! to the window itself, so a change of exposure (gain and offset) does not move the result.
//!
//! Invariant: a match lies inside the image by half a window. Cost: at most [`KLT_ITERATIONS`] windows of
//! [`SIDE`] x [`SIDE`] pixels a level, [`PYRAMID_LEVELS`](crate::budget::PYRAMID_LEVELS) levels.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use nalgebra::{Matrix2, Vector2};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::budget::KLT_ITERATIONS;
use crate::frame::{GrayImage, Pyramid};

/// Side of the window; two vector registers a row.
const SIDE: usize = 16;
/// The window and a pixel around it, for its gradient.
const WIDE: usize = SIDE + 2;
/// Offset of a window's first sample from its centre.
const HALF: f32 = 0.5 * (SIDE as f32 - 1.0);
/// An iteration that moves less is the last one, finest level; coarser levels stop at twice that.
const CONVERGED_PX: f32 = 0.03;
/// Correlation below which a window is another thing.
const MIN_CORRELATION: f32 = 0.8;
/// Determinant of the mean gradient tensor below which a window has no corner, in (squared luma a pixel)^2.
const MIN_DETERMINANT: f32 = 0.5;
/// Correlation on a coarse level below which the finer ones need not be tried.
const MIN_CORRELATION_COARSE: f32 = 0.4;
/// Stretch below which a window is taken straight: half a pixel at its edge.
const MIN_STRETCH: f32 = 0.06;
/// Furthest the result may be from its guess, in pixels of the coarsest level used.
const MAX_MOVE_PX: f32 = 12.0;

/// Level on which two guesses are compared.
const COMPARED_LEVEL: usize = 2;

type Window = [[f32; SIDE]; SIDE];

/// Where a pixel of the first image is expected in the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Guess {
    /// Full-size pixel in the second image.
    pub(crate) pixel: Vector2<f32>,
    /// `second_from_first` of small offsets around it; identity where nothing stretches.
    pub(crate) stretch: Matrix2<f32>,
}

/// Where it was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Match {
    /// Full-size pixel in the second image.
    pub(crate) pixel: Vector2<f32>,
    /// Normalised cross-correlation of the windows.
    pub(crate) correlation: f32,
}

/// Follows a pixel, from level `coarsest` down to the finest.
pub(crate) fn follow(
    first: &Pyramid,
    second: &Pyramid,
    from: &Vector2<f32>,
    guess: &Guess,
    coarsest: usize,
) -> Option<Match> {
    descend(first, second, from, guess, coarsest, 0).filter(|m| m.correlation >= MIN_CORRELATION)
}

/// Follows a pixel to the better of two guesses: both are compared on the coarse levels only.
pub(crate) fn follow_either(
    first: &Pyramid,
    second: &Pyramid,
    from: &Vector2<f32>,
    guesses: &[Guess; 2],
    coarsest: usize,
) -> Option<(Match, Guess)> {
    let [a, b] = guesses.map(|guess| {
        descend(first, second, from, &guess, coarsest, COMPARED_LEVEL).map(|found| (found, guess))
    });
    let (found, guess) = match (a, b) {
        (Some(a), Some(b)) => Some(if a.0.correlation >= b.0.correlation { a } else { b }),
        (one, other) => one.or(other),
    }?;
    let nearer = Guess {
        pixel: found.pixel,
        ..guess
    };
    follow(first, second, from, &nearer, COMPARED_LEVEL - 1).map(|found| (found, guess))
}

fn descend(
    first: &Pyramid,
    second: &Pyramid,
    from: &Vector2<f32>,
    guess: &Guess,
    coarsest: usize,
    finest: usize,
) -> Option<Match> {
    let mut at = guess.pixel;
    let mut found = None;
    let mut limit_px = f32::INFINITY;
    let levels = first.levels().len().min(second.levels().len());
    let finest = finest.min(levels - 1);
    for level in (finest..=coarsest.min(levels - 1)).rev() {
        let (from_level, to_level) = (&first.levels()[level], &second.levels()[level]);
        let Some(template) = Template::new(from_level, &at_level(from, level), &guess.stretch) else {
            // Too near the border or without texture up here; the next finer level may do.
            continue;
        };
        let scale = (1u32 << level) as f32;
        if limit_px.is_infinite() {
            limit_px = MAX_MOVE_PX * scale;
        }
        let Some((on_level, correlation)) = template.align(to_level, &at_level(&at, level), level > 0) else {
            continue;
        };
        if correlation < MIN_CORRELATION_COARSE {
            return None;
        }
        at = on_level.map(|v| (v + 0.5) * scale - 0.5);
        // Written so that NaN is too far.
        if !((at - guess.pixel).amax() <= limit_px) {
            return None;
        }
        found = (level == finest).then_some(Match {
            pixel: at,
            correlation,
        });
    }
    found
}

fn at_level(pixel: &Vector2<f32>, level: usize) -> Vector2<f32> {
    let scale = 1.0 / (1u32 << level) as f32;
    pixel.map(|v| (v + 0.5) * scale - 0.5)
}

/// A window of the first image, ready to be found.
struct Template {
    /// Luma without its mean.
    luma: Window,
    /// Gradient along x and y, orthogonal to a constant and to `luma`.
    gradient: [Window; 2],
    /// Inverse normal matrix of the gradient.
    inverse: [f32; 3],
    energy: f32,
}

impl Template {
    fn new(image: &GrayImage, centre: &Vector2<f32>, stretch: &Matrix2<f32>) -> Option<Self> {
        let mut wide = [[0.0; WIDE]; WIDE];
        if (stretch - Matrix2::identity()).amax() < MIN_STRETCH {
            sample(image, centre.x - HALF - 1.0, centre.y - HALF - 1.0, &mut wide)?;
        } else {
            sample_stretched(image, centre, &stretch.try_inverse()?, &mut wide)?;
        }
        let mut luma = [[0.0; SIDE]; SIDE];
        let mut gradient = [[[0.0; SIDE]; SIDE]; 2];
        for y in 0..SIDE {
            for x in 0..SIDE {
                luma[y][x] = wide[y + 1][x + 1];
                gradient[0][y][x] = 0.5 * (wide[y + 1][x + 2] - wide[y + 1][x]);
                gradient[1][y][x] = 0.5 * (wide[y + 2][x + 1] - wide[y][x + 1]);
            }
        }
        remove_mean(&mut luma);
        let energy = dot(&luma, &luma);
        for g in &mut gradient {
            remove_mean(g);
            let share = dot(g, &luma) / energy.max(1e-3);
            for y in 0..SIDE {
                for x in 0..SIDE {
                    g[y][x] -= share * luma[y][x];
                }
            }
        }
        let [gx, gy] = &gradient;
        let (xx, xy, yy) = (dot(gx, gx), dot(gx, gy), dot(gy, gy));
        let determinant = xx * yy - xy * xy;
        let pixels = (SIDE * SIDE) as f32;
        // Written so that NaN fails too.
        if !(determinant > MIN_DETERMINANT * pixels * pixels) {
            return None;
        }
        Some(Self {
            luma,
            gradient,
            inverse: [yy / determinant, -xy / determinant, xx / determinant],
            energy,
        })
    }

    /// Moves the window until it fits; its place and the correlation there.
    fn align(&self, image: &GrayImage, start: &Vector2<f32>, coarse: bool) -> Option<(Vector2<f32>, f32)> {
        let mut window = [[0.0; SIDE]; SIDE];
        let mut at = *start;
        let enough = if coarse { 2.0 * CONVERGED_PX } else { CONVERGED_PX };
        for _ in 0..KLT_ITERATIONS {
            sample(image, at.x - HALF, at.y - HALF, &mut window)?;
            let (bx, by) = (dot(&self.gradient[0], &window), dot(&self.gradient[1], &window));
            let [ixx, ixy, iyy] = self.inverse;
            let step = Vector2::new(ixx * bx + ixy * by, ixy * bx + iyy * by);
            // Beyond its own reach the linearisation means nothing; half a window is generous.
            let step = step * (0.5 * HALF / step.amax().max(0.5 * HALF));
            at -= step;
            if step.amax() < enough {
                break;
            }
        }
        sample(image, at.x - HALF, at.y - HALF, &mut window)?;
        remove_mean(&mut window);
        let correlation = dot(&self.luma, &window) / (self.energy * dot(&window, &window)).sqrt().max(1e-3);
        Some((at, correlation))
    }
}

/// Bilinear samples on a unit grid from `(left, top)`; none where a sample would lie outside.
fn sample<const N: usize>(image: &GrayImage, left: f32, top: f32, out: &mut [[f32; N]; N]) -> Option<()> {
    let limit_x = image.width() as f32 - N as f32 - 1.0;
    let limit_y = image.height() as f32 - N as f32 - 1.0;
    // Written so that NaN is outside.
    if !(left >= 0.0 && top >= 0.0 && left <= limit_x && top <= limit_y) {
        return None;
    }
    let (x, y) = (left as usize, top as usize);
    let (fx, fy) = (left - x as f32, top - y as f32);
    let mut above = [0.0f32; N];
    across(&image.row(y)[x..=x + N], fx, &mut above);
    for (row, out) in out.iter_mut().enumerate() {
        let mut below = [0.0f32; N];
        across(&image.row(y + row + 1)[x..=x + N], fx, &mut below);
        for i in 0..N {
            out[i] = above[i] + fy * (below[i] - above[i]);
        }
        above = below;
    }
    Some(())
}

#[inline(always)]
fn across<const N: usize>(row: &[u8], fx: f32, out: &mut [f32; N]) {
    let (here, next) = (&row[..N], &row[1..=N]);
    for i in 0..N {
        let a = f32::from(here[i]);
        out[i] = a + fx * (f32::from(next[i]) - a);
    }
}

/// Bilinear samples at `centre + first_from_second * offset`.
fn sample_stretched(
    image: &GrayImage,
    centre: &Vector2<f32>,
    first_from_second: &Matrix2<f32>,
    out: &mut [[f32; WIDE]; WIDE],
) -> Option<()> {
    let m = first_from_second;
    let reach = HALF + 1.0;
    let corner_x = reach * (m.m11.abs() + m.m12.abs());
    let corner_y = reach * (m.m21.abs() + m.m22.abs());
    let (width, height) = (image.width() as f32, image.height() as f32);
    let inside = centre.x - corner_x >= 0.0
        && centre.y - corner_y >= 0.0
        && centre.x + corner_x <= width - 1.01
        && centre.y + corner_y <= height - 1.01;
    if !inside {
        return None;
    }
    let pixels = image.pixels();
    for (row, out) in out.iter_mut().enumerate() {
        let oy = row as f32 - reach;
        for (column, out) in out.iter_mut().enumerate() {
            let ox = column as f32 - reach;
            let x = centre.x + m.m11 * ox + m.m12 * oy;
            let y = centre.y + m.m21 * ox + m.m22 * oy;
            let (ix, iy) = (x as usize, y as usize);
            let (fx, fy) = (x - ix as f32, y - iy as f32);
            let at = iy * image.width() + ix;
            let (a, b) = (f32::from(pixels[at]), f32::from(pixels[at + 1]));
            let below = at + image.width();
            let (c, d) = (f32::from(pixels[below]), f32::from(pixels[below + 1]));
            let upper = a + fx * (b - a);
            let lower = c + fx * (d - c);
            *out = upper + fy * (lower - upper);
        }
    }
    Some(())
}

/// Sum of products, in column lanes: the compiler may not reorder a single running sum.
#[inline(always)]
fn dot(a: &Window, b: &Window) -> f32 {
    let mut lanes = [0.0f32; SIDE];
    for y in 0..SIDE {
        for x in 0..SIDE {
            lanes[x] += a[y][x] * b[y][x];
        }
    }
    sum(&lanes)
}

#[inline(always)]
fn sum(lanes: &[f32; SIDE]) -> f32 {
    let mut half = [0.0f32; SIDE / 2];
    for i in 0..SIDE / 2 {
        half[i] = lanes[i] + lanes[i + SIDE / 2];
    }
    half.iter().sum()
}

#[inline(always)]
fn remove_mean(window: &mut Window) {
    let mut lanes = [0.0f32; SIDE];
    for row in window.iter() {
        for x in 0..SIDE {
            lanes[x] += row[x];
        }
    }
    let mean = sum(&lanes) / (SIDE * SIDE) as f32;
    for row in window.iter_mut() {
        for value in row.iter_mut() {
            *value -= mean;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use proptest::prelude::*;

    /// A smooth texture without repetition, scaled about (160, 100) and moved.
    fn picture(scale: f32, shift: Vector2<f32>, gain: f32, offset: f32) -> Pyramid {
        let mut pyramid = Pyramid::new(320, 200);
        for y in 0..200 {
            for x in 0..320 {
                let u = (x as f32 - 160.0 - shift.x) / scale;
                let v = (y as f32 - 100.0 - shift.y) / scale;
                let luma = 110.0
                    + 30.0 * (0.21 * u + 0.9 * (0.031 * v).sin()).sin()
                    + 25.0 * (0.17 * v + 1.3 * (0.043 * u).cos()).cos()
                    + 20.0 * (0.047 * u - 0.039 * v).sin();
                pyramid.base_mut().row_mut(y)[x] = (gain * luma + offset).clamp(0.0, 255.0) as u8;
            }
        }
        pyramid.build();
        pyramid
    }

    fn stay(pixel: Vector2<f32>) -> Guess {
        Guess {
            pixel,
            stretch: Matrix2::identity(),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_shift_is_found_under_changed_exposure(
            dx in -10.0..10.0f32, dy in -8.0..8.0f32, gain in 0.7..1.3f32, offset in -15.0..15.0f32,
        ) {
            let first = picture(1.0, Vector2::zeros(), 1.0, 0.0);
            let second = picture(1.0, Vector2::new(dx, dy), gain, offset);
            let from = Vector2::new(140.3, 96.8);
            let found = follow(&first, &second, &from, &stay(from), 3).unwrap();
            prop_assert!((found.pixel - from - Vector2::new(dx, dy)).norm() < 0.15);
            prop_assert!(found.correlation > 0.98);
        }
    }

    #[test]
    fn a_foretold_stretch_is_followed() {
        let first = picture(1.0, Vector2::zeros(), 1.0, 0.0);
        let second = picture(1.4, Vector2::zeros(), 1.0, 0.0);
        let from = Vector2::new(130.0, 80.0);
        let truth = (from - Vector2::new(160.0, 100.0)) * 1.4 + Vector2::new(160.0, 100.0);
        let guess = Guess {
            pixel: truth + Vector2::new(4.0, -3.0),
            stretch: Matrix2::identity() * 1.4,
        };
        let found = follow(&first, &second, &from, &guess, 2).unwrap();
        assert!((found.pixel - truth).norm() < 0.3, "{}", found.pixel - truth);
    }

    #[test]
    fn what_is_gone_is_not_found() {
        let first = picture(1.0, Vector2::zeros(), 1.0, 0.0);
        let flat = Pyramid::new(320, 200);
        let from = Vector2::new(140.0, 96.0);
        assert!(follow(&first, &flat, &from, &stay(from), 3).is_none());
        let outside = stay(Vector2::new(f32::NAN, 1e9));
        assert!(follow(&first, &first, &from, &outside, 3).is_none());
        let border = Vector2::new(3.0, 3.0);
        assert!(follow(&first, &first, &border, &stay(border), 3).is_none());
    }
}
