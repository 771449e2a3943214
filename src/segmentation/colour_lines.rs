//! Colour lines: which colours are road in this light, learnt from the network's own confident pixels.
//!
//! In: [`RgbImage`] `[height, width, 3] u8` (gray as equal channels), P(road) `[height, width] f32`. Out: `P_R(p|i)` and
//! `P_notR(p|i)`, `[height, width] f32` in 0..1, their sum at most 1.
//!
//! RGB is sliced by [`COLOUR_SLICES`] concentric spheres around the origin; slice `i` holds mean and covariance of the
//! road's colours, and of the others'. The scores are the densities over their sum with a flat outlier density, so that
//! both classes, wide or narrow, and gray images, where a slice is an interval of intensity, stay comparable.
//! A slice without pixels is filled by its line: between its filled neighbours, or from the nearest one towards or away
//! from the origin, with a wider variance. Each key frame weighs the same and the older ones fade, so one bad network
//! output is outvoted by those before it and forgotten by those after it.
//!
//! Cost: one table step a pixel to learn and one to score; [`COLOURS`] densities a key frame.
//! Source: Omer and Werman, "Color lines" (CVPR 2004); the paper, "Smoothness Term for the CRF".
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: slice and colour indices are bounded by their tables"
)]

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::{Matrix3, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::budget::COLOUR_SLICES;
use crate::frame::RgbImage;

/// Colours told apart: 5 bits a channel.
const COLOURS: usize = 1 << 15;
/// Thickness of a slice in grey levels: the cube's diagonal over the number of slices.
const SLICE_STEP: f32 = 441.673 / COLOUR_SLICES as f32;
/// Weight under which a slice counts as empty: a key frame weighs 1 in all.
const EMPTY_WEIGHT: f32 = 1e-3;

/// Settings of the colour lines.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(deny_unknown_fields, default)
)]
pub struct ColourConfig {
    /// P(road) over which a pixel teaches the road's colours; under 1 minus it, the others'.
    pub confident: f32,
    /// Weight that older key frames keep when a new one comes, 0 to 1.
    pub keep: f32,
    /// Least standard deviation of a slice, in grey levels; covers noise and the 5-bit colours.
    pub sigma_floor: f32,
    /// Density of colours that belong to neither class, relative to a uniform one over the slice.
    pub outlier: f32,
}

impl Default for ColourConfig {
    fn default() -> Self {
        Self {
            confident: 0.8,
            keep: 0.6,
            sigma_floor: 6.0,
            outlier: 0.01,
        }
    }
}

/// Weighted moments of the colours in one slice.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    weight: f32,
    sum: Vector3<f32>,
    outer: Matrix3<f32>,
}

/// A Gaussian ready to be evaluated.
#[derive(Clone, Copy, Debug)]
struct Gaussian {
    mean: Vector3<f32>,
    covariance: Matrix3<f32>,
    inverse: Matrix3<f32>,
    /// Weight of the slice over the square root of the covariance's determinant.
    scale: f32,
}

type Line = [Option<Gaussian>; COLOUR_SLICES];

/// The colours of one class.
#[derive(Clone, Debug)]
struct ColourClass {
    moments: [Moments; COLOUR_SLICES],
    /// Pixels of this key frame by colour.
    counts: Box<[u32]>,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct ColourLines {
    config: ColourConfig,
    road: ColourClass,
    not_road: ColourClass,
    /// `[road, not road]` scores by colour.
    scores: Box<[[f32; 2]]>,
}

impl ColourLines {
    /// Knows no colour yet: both scores are 0.5 everywhere.
    #[must_use]
    pub fn new(config: &ColourConfig) -> Self {
        Self {
            config: *config,
            road: ColourClass::new(),
            not_road: ColourClass::new(),
            scores: vec![[0.5; 2]; COLOURS].into_boxed_slice(),
        }
    }

    /// Learns from the confident pixels of a key frame; `road` is P(road) of the network, or of the 3D belief without one.
    ///
    /// # Panics
    /// Where `road` is not of the image's size.
    pub fn learn(&mut self, rgb: &RgbImage, road: &[f32]) {
        assert!(rgb.pixels().len() == 3 * road.len());
        self.road.counts.fill(0);
        self.not_road.counts.fill(0);
        for (pixel, &probability) in rgb.pixels().chunks_exact(3).zip(road) {
            // A NaN teaches nothing.
            if probability > self.config.confident {
                self.road.counts[colour(pixel)] += 1;
            } else if probability < 1.0 - self.config.confident {
                self.not_road.counts[colour(pixel)] += 1;
            }
        }
        let keep = self.config.keep.clamp(0.0, 1.0);
        self.road.remember(keep);
        self.not_road.remember(keep);
        self.tabulate();
    }

    /// Scores of every pixel: `P_R(p|i)` and `P_notR(p|i)`.
    ///
    /// # Panics
    /// Where the scores are not of the image's size.
    pub fn score_into(&self, rgb: &RgbImage, road_score: &mut [f32], not_road_score: &mut [f32]) {
        assert!(rgb.pixels().len() == 3 * road_score.len() && road_score.len() == not_road_score.len());
        let scores = road_score.iter_mut().zip(not_road_score);
        for ((road, not_road), pixel) in scores.zip(rgb.pixels().chunks_exact(3)) {
            [*road, *not_road] = self.scores[colour(pixel)];
        }
    }

    fn tabulate(&mut self) {
        let (road, not_road) = (self.road.line(&self.config), self.not_road.line(&self.config));
        for (index, scores) in self.scores.iter_mut().enumerate() {
            let x = centre(index);
            let i = slice(&x);
            let (Some(road), Some(not_road)) = (&road[i], &not_road[i]) else {
                *scores = [0.5; 2];
                continue;
            };
            // A Gaussian as wide as a slice is thick stands for the uniform density.
            let outlier = self.config.outlier / (COLOUR_SLICES as f32 * SLICE_STEP * SLICE_STEP * SLICE_STEP);
            let (r, n) = (road.density(&x), not_road.density(&x));
            let total = r + n + outlier.max(f32::MIN_POSITIVE);
            *scores = [r / total, n / total];
        }
    }
}

impl ColourClass {
    fn new() -> Self {
        Self {
            moments: [Moments::default(); COLOUR_SLICES],
            counts: vec![0; COLOURS].into_boxed_slice(),
        }
    }

    /// Adds this key frame's counts, with weight 1 in all, to what is kept of the older ones.
    fn remember(&mut self, keep: f32) {
        let total: u32 = self.counts.iter().sum();
        // Too few pixels to say anything: better the old knowledge than none.
        if total < 64 {
            return;
        }
        for moments in &mut self.moments {
            moments.weight *= keep;
            moments.sum *= keep;
            moments.outer *= keep;
        }
        for (index, &count) in self.counts.iter().enumerate() {
            if count > 0 {
                let x = centre(index);
                let weight = count as f32 / total as f32 * (1.0 - keep).max(1e-3);
                let moments = &mut self.moments[slice(&x)];
                moments.weight += weight;
                moments.sum += x * weight;
                moments.outer += x * x.transpose() * weight;
            }
        }
    }

    /// The Gaussian of each slice, empty ones filled along the line; none where the class has no colours at all.
    fn line(&self, config: &ColourConfig) -> Line {
        let total: f32 = self.moments.iter().map(|m| m.weight).sum();
        let mut line: Line = [None; COLOUR_SLICES];
        for (slice, moments) in line.iter_mut().zip(&self.moments) {
            if moments.weight > EMPTY_WEIGHT * total && total > 0.0 {
                let mean = moments.sum / moments.weight;
                let covariance = moments.outer / moments.weight - mean * mean.transpose();
                *slice = Gaussian::new(mean, covariance, moments.weight / total, config.sigma_floor);
            }
        }
        let filled = line;
        for i in 0..COLOUR_SLICES {
            if filled[i].is_none() {
                line[i] = extrapolate(&filled, i, config.sigma_floor);
            }
        }
        line
    }
}

/// The Gaussian of an empty slice, from the nearest filled ones.
fn extrapolate(filled: &Line, i: usize, sigma_floor: f32) -> Option<Gaussian> {
    let find = |mut slices: &mut dyn Iterator<Item = usize>| {
        (&mut slices).find_map(|j| {
            filled[j]
                .as_ref()
                .map(|gaussian| (i.abs_diff(j) as f32, gaussian))
        })
    };
    let below = find(&mut (0..i).rev());
    let above = find(&mut (i + 1..COLOUR_SLICES));
    let radius = (i as f32 + 0.5) * SLICE_STEP;
    let (mean, gap, nearest) = match (below, above) {
        (Some((a, low)), Some((b, high))) => {
            let nearest = if a <= b { low } else { high };
            (
                low.mean + (high.mean - low.mean) * (a / (a + b)),
                a.min(b),
                nearest,
            )
        }
        // Beyond its ends a colour line runs through the origin: the same surface under more or less light.
        (Some((gap, nearest)), None) | (None, Some((gap, nearest))) => (
            nearest.mean * (radius / nearest.mean.norm().max(1.0)),
            gap,
            nearest,
        ),
        (None, None) => return None,
    };
    Gaussian::new(mean, nearest.covariance * (1.0 + gap), EMPTY_WEIGHT, sigma_floor)
}

impl Gaussian {
    fn new(mean: Vector3<f32>, covariance: Matrix3<f32>, weight: f32, sigma_floor: f32) -> Option<Self> {
        let covariance = covariance + Matrix3::identity() * sigma_floor.max(0.5).powi(2);
        let inverse = covariance.try_inverse()?;
        Some(Self {
            mean,
            covariance,
            inverse,
            scale: weight / covariance.determinant().max(1e-6).sqrt(),
        })
    }

    fn density(&self, x: &Vector3<f32>) -> f32 {
        let d = x - self.mean;
        self.scale * (-0.5 * d.dot(&(self.inverse * d)).max(0.0)).exp()
    }
}

/// Index of a pixel's colour.
fn colour(pixel: &[u8]) -> usize {
    let bits = |k: usize| usize::from(pixel[k] >> 3);
    bits(0) << 10 | bits(1) << 5 | bits(2)
}

/// The colour at the centre of an index.
fn centre(index: usize) -> Vector3<f32> {
    let level = |shift: usize| ((index >> shift & 31) * 8 + 4) as f32 - 0.5;
    Vector3::new(level(10), level(5), level(0))
}

/// The slice between two spheres that a colour lies in.
fn slice(x: &Vector3<f32>) -> usize {
    ((x.norm() / SLICE_STEP) as usize).min(COLOUR_SLICES - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    /// Left half of one colour, right half of another, with a ramp of brightness from top to bottom.
    fn scene(left: [f32; 3], right: [f32; 3]) -> (RgbImage, Vec<f32>) {
        let (width, height) = (64, 48);
        let mut image = RgbImage::new(width, height);
        let mut road = vec![0.0; width * height];
        for y in 0..height {
            for x in 0..width {
                let light = 0.7 + 0.3 * y as f32 / height as f32;
                let base = if x < width / 2 { left } else { right };
                for k in 0..3 {
                    image.row_mut(y)[3 * x + k] = (base[k] * light) as u8;
                }
                road[y * width + x] = if x < width / 2 { 0.95 } else { 0.05 };
            }
        }
        (image, road)
    }

    fn scores_of(lines: &ColourLines, pixel: [u8; 3]) -> (f32, f32) {
        let mut image = RgbImage::new(1, 1);
        image.pixels_mut().copy_from_slice(&pixel);
        let (mut road, mut not_road) = ([0.0], [0.0]);
        lines.score_into(&image, &mut road, &mut not_road);
        (road[0], not_road[0])
    }

    const ASPHALT: [f32; 3] = [120.0, 120.0, 130.0];
    const GRASS: [f32; 3] = [60.0, 150.0, 40.0];

    #[test]
    fn road_in_the_shade_is_still_road() {
        let mut lines = ColourLines::new(&ColourConfig::default());
        let (image, road) = scene(ASPHALT, GRASS);
        lines.learn(&image, &road);
        // Brightness 0.7 to 1 was seen; 0.45 was not.
        for light in [0.45, 0.8, 1.0] {
            let (r, n) = scores_of(&lines, ASPHALT.map(|c| (c * light) as u8));
            assert!(r > 0.6 && n < 0.4, "asphalt at {light}: {r} {n}");
            let (r, n) = scores_of(&lines, GRASS.map(|c| (c * light) as u8));
            assert!(n > 0.6 && r < 0.4, "grass at {light}: {r} {n}");
        }
    }

    #[test]
    fn gray_images_are_told_apart_by_intensity() {
        let mut lines = ColourLines::new(&ColourConfig::default());
        let (image, road) = scene([90.0; 3], [200.0; 3]);
        lines.learn(&image, &road);
        assert!(scores_of(&lines, [80; 3]).0 > 0.8);
        assert!(scores_of(&lines, [180; 3]).1 > 0.8);
    }

    #[test]
    fn one_bad_key_frame_does_not_turn_the_colours() {
        let mut lines = ColourLines::new(&ColourConfig::default());
        let (image, road) = scene(ASPHALT, GRASS);
        for _ in 0..4 {
            lines.learn(&image, &road);
        }
        let bad: Vec<f32> = road.iter().map(|p| 1.0 - p).collect();
        lines.learn(&image, &bad);
        let (r, n) = scores_of(&lines, ASPHALT.map(|c| c as u8));
        assert!(r > n, "{r} {n}");
    }

    #[test]
    fn without_confident_pixels_nothing_is_said() {
        let mut lines = ColourLines::new(&ColourConfig::default());
        let (image, _) = scene(ASPHALT, GRASS);
        lines.learn(&image, &vec![0.5; 64 * 48]);
        lines.learn(&image, &vec![f32::NAN; 64 * 48]);
        assert_eq!(scores_of(&lines, [100, 100, 100]), (0.5, 0.5));
    }
}
