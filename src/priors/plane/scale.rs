//! Metric scale from the known camera height, where there are no wheels.
//!
//! In: landmarks of unknown scale in camera space. Out: what lengths must be multiplied by, and how well that is known.
//! Invariant: the ratio is within 1/3 to 1/0.3 of the search's; a wrong scale by less is found whatever its size.
//! Cost: as [`find_plane`]. Source: the paper's known `d`, read backwards.

use super::{
    Box, HOUGH_ANGLES, PlaneConfig, PlaneScratch, PlaneSearch, Point3, Slopes, SupportPoint, find_plane, vec,
};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use nalgebra::Vector3;

/// Bins of the logarithm of the scale between 1/3 and 1/0.3: 2.4 % each.
const BINS: usize = 96;
const SMALLEST_RATIO: f64 = 1.0 / 3.0;
const LARGEST_RATIO: f64 = 1.0 / 0.3;
/// Each angle looks at this share of the pitch bins; the scale is coarse here and refined after.
const ANGLE_STRIDE: usize = 4;

/// The metric scale of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleEstimate {
    /// True lengths over the map's: known camera height over measured height.
    pub ratio: f64,
    /// Relative standard deviation of `ratio`.
    pub sigma: f64,
    /// Landmarks on the plane.
    pub inliers: u32,
    /// Share of the landmarks near the plane that lie on it, 0 to 1; under 0.1 it is better to hold the scale.
    pub confidence: f32,
}

/// Memory of the search for the scale.
#[derive(Clone, Debug)]
pub struct ScaleSearch {
    votes: Box<[f32]>,
    scaled: Box<[SupportPoint]>,
}

impl ScaleSearch {
    /// Memory for `landmarks` landmarks; more are left out.
    #[must_use]
    pub fn new(landmarks: usize) -> Self {
        let nowhere = SupportPoint {
            point: Point3::origin(),
            depth_sigma_m: 0.0,
        };
        Self {
            votes: vec![0.0; BINS * HOUGH_ANGLES.div_ceil(ANGLE_STRIDE)].into_boxed_slice(),
            scaled: vec![nowhere; landmarks].into_boxed_slice(),
        }
    }
}

/// Finds the scale at which the road lies where `search` (in metres) expects it; none without a plane.
pub fn find_scale(
    points: &[SupportPoint],
    search: &PlaneSearch,
    config: &PlaneConfig,
    memory: &mut ScaleSearch,
    scratch: &mut PlaneScratch,
) -> Option<ScaleEstimate> {
    let coarse = vote(points, &search.expected, config, &mut memory.votes)?;
    let count = points.len().min(memory.scaled.len());
    for (scaled, support) in memory.scaled[..count].iter_mut().zip(points) {
        scaled.point = support.point * coarse;
        scaled.depth_sigma_m = support.depth_sigma_m * coarse as f32;
    }
    // The distance is free here: that is what is measured, anew each time.
    let free = PlaneSearch {
        news: 1.0,
        variance: Vector3::new(1.0, search.variance[1], search.variance[2]),
        ..*search
    };
    let fit = find_plane(&memory.scaled[..count], &free, config, scratch)?;
    let ratio = coarse * search.expected[0] / fit.slopes[0];
    Some(ScaleEstimate {
        ratio,
        sigma: fit.variance[0].sqrt() / fit.slopes[0],
        inliers: fit.inliers,
        confidence: fit.inliers as f32 / fit.voters.max(1) as f32,
    })
}

/// Votes in (log scale, theta); distances in units of the plane's own.
fn vote(points: &[SupportPoint], expected: &Slopes, config: &PlaneConfig, votes: &mut [f32]) -> Option<f64> {
    let log_first = SMALLEST_RATIO.ln();
    let log_bin = (LARGEST_RATIO.ln() - log_first) / BINS as f64;
    votes.fill(0.0);
    for support in points {
        let p = &support.point;
        for (index, bins) in votes.chunks_exact_mut(BINS).enumerate() {
            let turn = (index * ANGLE_STRIDE) as f64 / (HOUGH_ANGLES - 1) as f64 * 2.0 - 1.0;
            let slope = expected[1] + turn * config.pitch_range_rad;
            let measured = p.y + slope * p.z + expected[2] * p.x;
            if !(measured > 1e-6 && p.z > 0.0) {
                continue;
            }
            let ratio = expected[0] / measured;
            let (ahead_m, aside_m) = (p.z * ratio, p.x.abs() * ratio);
            if ahead_m < config.nearest_m || ahead_m > config.farthest_m {
                continue;
            }
            let position = (ratio.ln() - log_first) / log_bin;
            if !(1.0..(BINS - 1) as f64).contains(&position) {
                continue;
            }
            let outside = ((aside_m - config.corridor_half_m).max(0.0) / config.corridor_fade_m).min(3.0);
            let noise = f64::from(support.depth_sigma_m) * ratio / ahead_m;
            let weight = ((-0.5 * outside * outside).exp() / (1.0 + 100.0 * noise * noise)) as f32;
            #[expect(clippy::cast_sign_loss, reason = "within the bins, checked above")]
            let bin = position as usize;
            bins[bin] += weight;
            bins[bin - 1] += 0.5 * weight;
            bins[bin + 1] += 0.5 * weight;
        }
    }
    let (mut best, mut most) = (0, 0.0);
    for (index, &count) in votes.iter().enumerate() {
        if count > most {
            (best, most) = (index, count);
        }
    }
    (most > 2.0).then(|| (log_first + (best % BINS) as f64 * log_bin + 0.5 * log_bin).exp())
}
