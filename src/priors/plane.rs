//! The road plane, found in landmarks that mostly lie beside the road.
//!
//! In: landmarks in camera space with their depth uncertainty, and where the plane is expected. Out: the plane with its
//! support, or none where the support is too thin. Invariant: a plane found lies within the search range of the expected
//! one; nothing panics on garbage. Cost: one vote of [`HOUGH_ANGLES`] angles a landmark, then [`PLANE_PASSES`] passes.
//! Source: section "Generating Priors from the 3D Structure", `z sin(theta) - y cos(theta) = d cos(theta)` with y up; in
//! camera space (y down) this reads `y + z tan(theta) = d`. A small roll joins it in the refinement: `y + s z + r x = d`.

#![allow(
    clippy::cast_possible_truncation,
    reason = "counts are bounded by the landmarks, sigmas by metres"
)]

mod filter;
mod scale;
#[cfg(test)]
pub(crate) mod tests;

pub use filter::PlaneFilter;
pub use scale::{ScaleEstimate, ScaleSearch, find_scale};

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::{Matrix3, Point3, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::ground::Ground;
use crate::budget::{HOUGH_ANGLES, HOUGH_DISTANCES, PLANE_PASSES};
use crate::space::Plane;

/// A landmark that may lie on the road, in camera space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupportPoint {
    /// Position.
    pub point: Point3<f64>,
    /// Standard deviation along its ray.
    pub depth_sigma_m: f32,
}

/// How the plane is searched for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct PlaneConfig {
    /// The plane's distance may differ this much from the mount's height.
    pub distance_range_m: f64,
    /// The pitch may differ this much from the mount's.
    pub pitch_range_rad: f64,
    /// How well the mount's height is known, load and tyres included.
    pub distance_sigma_m: f64,
    /// How much the car pitches on its springs and the road bends.
    pub pitch_sigma_rad: f64,
    /// How much the car rolls.
    pub roll_sigma_rad: f64,
    /// How well the plane is parallel to the camera's path since the last key frame: nodding, bends of the road, drift.
    pub travel_sigma_rad: f64,
    /// Landmarks nearer than this do not vote.
    pub nearest_m: f64,
    /// Landmarks farther than this do not vote.
    pub farthest_m: f64,
    /// Half the width of the car's own corridor, where landmarks count fully.
    pub corridor_half_m: f64,
    /// How fast a landmark's weight falls outside the corridor.
    pub corridor_fade_m: f64,
    /// Fewer supporting landmarks than this are not a plane.
    pub min_inliers: u32,
    /// Independent landmarks the support is worth at most; map errors are common to neighbours.
    pub effective_inliers: f64,
    /// Common error of the landmarks' depths, a share of the depth for each metre of it: of a short base, all depths err alike.
    pub depth_bias_per_m: f64,
}

impl Default for PlaneConfig {
    fn default() -> Self {
        Self {
            distance_range_m: 0.4,
            pitch_range_rad: 0.06,
            distance_sigma_m: 0.05,
            pitch_sigma_rad: 0.015,
            roll_sigma_rad: 0.01,
            travel_sigma_rad: 0.004,
            nearest_m: 3.0,
            farthest_m: 30.0,
            corridor_half_m: 1.5,
            corridor_fade_m: 1.2,
            min_inliers: 8,
            effective_inliers: 10.0,
            depth_bias_per_m: 0.005,
        }
    }
}

/// Slopes of a plane in camera space: `(d, s, r)` of `y + s z + r x = d`.
pub type Slopes = Vector3<f64>;

/// The slopes of a plane; none where it stands upright in the image.
#[must_use]
pub fn slopes_of(plane: &Plane) -> Option<Slopes> {
    let n = &plane.normal;
    (n.y < -0.2).then(|| Vector3::new(-plane.offset_m / n.y, n.z / n.y, n.x / n.y))
}

/// The plane of slopes, its normal up.
#[must_use]
pub fn plane_of(slopes: &Slopes) -> Plane {
    let down = Vector3::new(slopes[2], 1.0, slopes[1]);
    let length = down.norm();
    Plane {
        normal: -down / length,
        offset_m: slopes[0] / length,
    }
}

/// Where the plane is expected, and how certainly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneSearch {
    /// Expected slopes, in camera space.
    pub expected: Slopes,
    /// Variances of the expected slopes.
    pub variance: Slopes,
    /// Direction ahead, in camera space.
    pub forward: Vector3<f64>,
    /// Curvature of the car's path, positive left.
    pub curvature_per_m: f64,
    /// Share of what the landmarks say that the expectation does not hold yet, 0 to 1.
    pub news: f64,
}

/// A plane found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneFit {
    /// Slopes in camera space.
    pub slopes: Slopes,
    /// Their variances, expectation included.
    pub variance: Slopes,
    /// Landmarks that voted.
    pub voters: u32,
    /// Landmarks within 2.5 sigma of it.
    pub inliers: u32,
    /// Robust standard deviation of their heights.
    pub sigma_m: f32,
}

/// Memory of the search.
#[derive(Clone, Debug)]
pub struct PlaneScratch {
    votes: Box<[f32]>,
    weighted: Box<[Weighted]>,
    heights_m: Box<[f32]>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Weighted {
    x: f64,
    y: f64,
    z: f64,
    weight: f64,
    height_variance: f64,
}

impl PlaneScratch {
    /// Memory for `landmarks` landmarks; more are left out.
    #[must_use]
    pub fn new(landmarks: usize) -> Self {
        Self {
            votes: vec![0.0; HOUGH_DISTANCES * HOUGH_ANGLES].into_boxed_slice(),
            weighted: vec![Weighted::default(); landmarks].into_boxed_slice(),
            heights_m: vec![0.0; landmarks].into_boxed_slice(),
        }
    }
}

/// Height noise of a perfect landmark on asphalt: texture and unevenness.
const ROAD_SIGMA_M: f64 = 0.02;
/// Half a pixel at 700 px focal length, across the ray.
const BEARING_SIGMA_RAD: f64 = 0.0007;
/// A lower peak with this share of the best one's votes is the road, the best one its pavement.
const LOWER_PEAK_SHARE: f32 = 0.5;

/// Finds the road plane around the expected one; none where fewer than `min_inliers` landmarks support it.
pub fn find_plane(
    points: &[SupportPoint],
    search: &PlaneSearch,
    config: &PlaneConfig,
    scratch: &mut PlaneScratch,
) -> Option<PlaneFit> {
    let count = weigh(points, search, config, scratch);
    if count < config.min_inliers as usize {
        return None;
    }
    let start = vote(count, search, config, scratch)?;
    refine(start, count, search, config, scratch)
}

/// Keeps landmarks that may be road, with a weight for the car's corridor and the variance of their height.
fn weigh(
    points: &[SupportPoint],
    search: &PlaneSearch,
    config: &PlaneConfig,
    scratch: &mut PlaneScratch,
) -> usize {
    let expected = plane_of(&search.expected);
    let ground = Ground::new(&expected, &search.forward);
    let mut count = 0;
    for support in points {
        let (ahead_m, left_m) = ground.coordinates(&support.point);
        let height_m = expected.height_m(&support.point);
        let tolerance_m = config.distance_range_m + ahead_m * config.pitch_range_rad;
        // Written so that a NaN fails it.
        let near = ahead_m >= config.nearest_m && ahead_m <= config.farthest_m;
        if !(near && height_m.abs() <= tolerance_m && support.depth_sigma_m >= 0.0) {
            continue;
        }
        if count == scratch.weighted.len() {
            break;
        }
        let off_path_m = (left_m - 0.5 * search.curvature_per_m * ahead_m * ahead_m).abs();
        let outside = (off_path_m - config.corridor_half_m).max(0.0) / config.corridor_fade_m;
        let range_m = support.point.coords.norm();
        // An error along the ray moves the point down by the sine of the ray's descent.
        let along_m = f64::from(support.depth_sigma_m) * expected.offset_m / range_m;
        let across_m = BEARING_SIGMA_RAD * range_m;
        let common_m = config.depth_bias_per_m * range_m * expected.offset_m;
        scratch.weighted[count] = Weighted {
            x: support.point.x,
            y: support.point.y,
            z: support.point.z,
            weight: (-0.5 * outside * outside).exp().max(0.05),
            height_variance: along_m * along_m
                + common_m * common_m
                + across_m * across_m
                + ROAD_SIGMA_M * ROAD_SIGMA_M,
        };
        count += 1;
    }
    count
}

/// Votes in (d, theta), the roll held: the lowest strong peak.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "bins are bounded by the votes' size"
)]
fn vote(
    count: usize,
    search: &PlaneSearch,
    config: &PlaneConfig,
    scratch: &mut PlaneScratch,
) -> Option<Slopes> {
    let bin_m = (2.0 * config.distance_range_m / HOUGH_DISTANCES as f64).max(1e-4);
    let step = 2.0 * config.pitch_range_rad / (HOUGH_ANGLES - 1) as f64;
    let slope_of = |angle: usize| search.expected[1] - config.pitch_range_rad + angle as f64 * step;
    let nearest_m = search.expected[0] - config.distance_range_m;
    scratch.votes.fill(0.0);
    for point in &scratch.weighted[..count] {
        let half_bins = ((point.height_variance.sqrt() / bin_m) as i32).clamp(1, 6);
        let share = (point.weight / f64::from(2 * half_bins + 1)) as f32;
        for angle in 0..HOUGH_ANGLES {
            let d_m = point.y + slope_of(angle) * point.z + search.expected[2] * point.x;
            let bin = ((d_m - nearest_m) / bin_m).floor() as i32;
            let votes = &mut scratch.votes[angle * HOUGH_DISTANCES..(angle + 1) * HOUGH_DISTANCES];
            let first = (bin - half_bins).clamp(0, HOUGH_DISTANCES as i32) as usize;
            let last = (bin + half_bins + 1).clamp(0, HOUGH_DISTANCES as i32) as usize;
            for vote in &mut votes[first..last.max(first)] {
                *vote += share;
            }
        }
    }
    // The expectation weighs in softly: a quarter of chi-square, for it also steers the refinement.
    for angle in 0..HOUGH_ANGLES {
        let pitch = (slope_of(angle) - search.expected[1]).powi(2) / search.variance[1];
        for bin in 0..HOUGH_DISTANCES {
            let d_m = nearest_m + (bin as f64 + 0.5) * bin_m - search.expected[0];
            let chi2 = pitch + d_m * d_m / search.variance[0];
            scratch.votes[angle * HOUGH_DISTANCES + bin] *= (-0.25 * chi2).exp() as f32;
        }
    }
    let (mut best, mut most) = (0, 0.0);
    for (index, &votes) in scratch.votes.iter().enumerate() {
        if votes > most {
            (best, most) = (index, votes);
        }
    }
    if most <= 0.0 {
        return None;
    }
    let (angle, bin) = (best / HOUGH_DISTANCES, best % HOUGH_DISTANCES);
    let bin = lowest_peak(
        &scratch.votes[angle * HOUGH_DISTANCES..(angle + 1) * HOUGH_DISTANCES],
        bin,
        (0.06 / bin_m).ceil() as usize,
        (0.25 / bin_m).ceil() as usize,
    );
    Some(Vector3::new(
        nearest_m + (bin as f64 + 0.5) * bin_m,
        slope_of(angle),
        search.expected[2],
    ))
}

/// The road is the lowest dense plane: a peak `nearest..=farthest` bins below the best one wins if it is nearly as strong.
fn lowest_peak(votes: &[f32], best: usize, nearest: usize, farthest: usize) -> usize {
    let mut lowest = best;
    let last = best.saturating_add(farthest).min(votes.len().saturating_sub(3));
    for bin in best.saturating_add(nearest.max(2))..=last {
        let around = &votes[bin - 2..=(bin + 2).min(votes.len() - 1)];
        let is_peak = around.iter().all(|&v| v <= votes[bin]);
        // A shoulder of the best peak is no peak: votes must have fallen in between.
        let valley = votes[best..=bin].iter().fold(f32::INFINITY, |a, &b| a.min(b));
        if is_peak && votes[bin] >= LOWER_PEAK_SHARE * votes[best] && valley < 0.8 * votes[bin] {
            lowest = bin;
        }
    }
    lowest
}

/// Tukey's weight; points above the plane (pavement, wheels) are cut off sooner than points below it.
fn tukey(height_m: f64, sigma_m: f64) -> f64 {
    let cut = if height_m > 0.0 { 3.0 } else { 4.685 };
    let u = height_m / (cut * sigma_m);
    let v = 1.0 - u * u;
    if v > 0.0 { v * v } else { 0.0 }
}

/// Re-weighted least squares with the expectation as a prior; graduated from coarse to the landmarks' own noise.
fn refine(
    start: Slopes,
    count: usize,
    search: &PlaneSearch,
    config: &PlaneConfig,
    scratch: &mut PlaneScratch,
) -> Option<PlaneFit> {
    let points = &scratch.weighted[..count];
    let prior = Matrix3::from_diagonal(&search.variance.map(|v| 1.0 / v.max(1e-12)));
    let mut slopes = start;
    // Of the landmarks, at what all of them together are worth: the normal equations.
    let (mut information, mut moment) = (Matrix3::zeros(), Vector3::zeros());
    for pass in 0..PLANE_PASSES {
        let blur_m = 0.05 * (PLANE_PASSES - 1 - pass) as f64 / (PLANE_PASSES - 1) as f64;
        let (mut normal, mut right, mut support) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for p in points {
            let height_m = slopes[0] - p.y - slopes[1] * p.z - slopes[2] * p.x;
            let spread = p.height_variance + blur_m * blur_m;
            let share = p.weight * tukey(height_m, spread.sqrt());
            let row = Vector3::new(1.0, -p.z, -p.x);
            normal += row * row.transpose() * (share / spread);
            right += row * (p.y * share / spread);
            support += share;
        }
        let worth = (config.effective_inliers / support.max(1e-9)).min(1.0);
        (information, moment) = (normal * worth, right * worth);
        slopes = (information + prior).try_inverse()? * (moment + prior * search.expected);
    }
    let mut inliers = 0;
    for p in points {
        let height_m = slopes[0] - p.y - slopes[1] * p.z - slopes[2] * p.x;
        if height_m * height_m < 6.25 * p.height_variance {
            scratch.heights_m[inliers] = height_m.abs() as f32;
            inliers += 1;
        }
    }
    let within = (slopes[0] - search.expected[0]).abs() <= config.distance_range_m
        && (slopes[1] - search.expected[1]).abs() <= config.pitch_range_rad
        && slopes.iter().all(|v| v.is_finite());
    if inliers < config.min_inliers as usize || !within {
        return None;
    }
    let heights = &mut scratch.heights_m[..inliers];
    let (_, median, _) = heights.select_nth_unstable_by(inliers / 2, f32::total_cmp);
    // Support is judged by all that they say; the plane moves by what of it is new.
    let inverse = (information * search.news + prior).try_inverse()?;
    Some(PlaneFit {
        slopes: inverse * (moment * search.news + prior * search.expected),
        variance: inverse.diagonal(),
        voters: count as u32,
        inliers: inliers as u32,
        sigma_m: 1.4826 * *median,
    })
}
