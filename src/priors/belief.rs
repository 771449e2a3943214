//! How far the sparse structure believes in road, place by place: the soft form of `I(p)`.
//!
//! In: landmarks near the plane, the plane's uncertainty, the car's path. Out: a raster on the road plane, `[ahead, left]`
//! f32 in [0, 1], 0.5 where nothing is known. Invariant: every value is finite and in [0, 1]. Cost: a fixed kernel of cells
//! a landmark, three passes over the raster. Source: replaces the paper's hard indicator, whose plane takes in the pavement.
//!
//! Witnesses: a landmark 0.12 m over the plane speaks against road around it as far as its certainty allows, one on the
//! plane for it. What lies beyond a kerb, seen from the path, is less likely road. Where the car is about to drive is road.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "raster cells are bounded by the raster"
)]

use alloc::boxed::Box;
use alloc::vec;

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::ground::Ground;
use super::plane::{PlaneFilter, SupportPoint};

/// How evidence becomes belief. Log-odds are natural.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct BeliefConfig {
    /// A cell of the raster.
    pub cell_m: f32,
    /// Reach ahead.
    pub ahead_m: f32,
    /// Reach to either side.
    pub side_m: f32,
    /// Log-odds of a plane pixel without witnesses.
    pub plane_log_odds: f32,
    /// Uncertainty of the plane's height that halves the trust in everything but the path.
    pub height_tolerance_m: f32,
    /// Log-odds of a pixel whose ray meets a box first, or nothing.
    pub blocked_log_odds: f32,
    /// Log-odds of the car's path close ahead.
    pub path_log_odds: f32,
    /// Half the width of the path.
    pub path_half_m: f32,
    /// Distance ahead over which the path's log-odds fall by e.
    pub path_length_m: f32,
    /// Log-odds of places one `lateral_fade_m` to the side of the path; grows to twice that.
    pub lateral_log_odds: f32,
    /// See `lateral_log_odds`.
    pub lateral_fade_m: f32,
    /// Most a witness may say against road.
    pub witness_against: f32,
    /// Most a witness may say for road.
    pub witness_for: f32,
    /// Share of the not-road landmarks that lie as low as the road: lawns, flush pavements.
    pub flat_share: f32,
    /// Reach of a witness along the road.
    pub reach_ahead_m: f32,
    /// Reach of a witness across the road.
    pub reach_left_m: f32,
    /// Log-odds that evidence against road passes on to what lies beyond, a share.
    pub barrier_share: f32,
    /// Distance over which a barrier is forgotten.
    pub barrier_fade_m: f32,
}

impl Default for BeliefConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.25,
            ahead_m: 60.0,
            side_m: 12.0,
            plane_log_odds: -0.15,
            height_tolerance_m: 0.3,
            blocked_log_odds: -3.0,
            path_log_odds: 1.2,
            path_half_m: 1.6,
            path_length_m: 25.0,
            lateral_log_odds: -0.3,
            lateral_fade_m: 6.0,
            witness_against: -3.0,
            witness_for: 1.0,
            flat_share: 0.3,
            reach_ahead_m: 1.5,
            reach_left_m: 0.4,
            barrier_share: 0.6,
            barrier_fade_m: 4.0,
        }
    }
}

/// Probability of road on the plane below one camera.
#[derive(Clone, Debug)]
pub struct BeliefRaster {
    config: BeliefConfig,
    rows: usize,
    columns: usize,
    weight: Box<[f32]>,
    evidence: Box<[f32]>,
    belief: Box<[f32]>,
}

/// Kernel cells to either side of a witness.
const KERNEL_AHEAD: usize = 12;
const KERNEL_LEFT: usize = 4;

impl BeliefRaster {
    /// A raster that knows nothing.
    #[must_use]
    pub fn new(config: BeliefConfig) -> Self {
        let cell_m = config.cell_m.max(0.05);
        let rows = ((config.ahead_m / cell_m) as usize).clamp(2, 2000);
        let columns = ((2.0 * config.side_m / cell_m) as usize).clamp(2, 2000);
        let zeros = || vec![0.0; rows * columns].into_boxed_slice();
        Self {
            config: BeliefConfig { cell_m, ..config },
            rows,
            columns,
            weight: zeros(),
            evidence: zeros(),
            belief: vec![0.5; rows * columns].into_boxed_slice(),
        }
    }

    /// Belief at metres ahead and left of the foot, bilinear; its edge beyond the raster, fading to 0.5 behind the foot.
    #[must_use]
    pub fn at(&self, ahead_m: f32, left_m: f32) -> f32 {
        let row = (ahead_m / self.config.cell_m - 0.5).clamp(0.0, (self.rows - 1) as f32);
        let column =
            ((left_m + self.config.side_m) / self.config.cell_m - 0.5).clamp(0.0, (self.columns - 1) as f32);
        let (r, c) = (
            (row as usize).min(self.rows - 2),
            (column as usize).min(self.columns - 2),
        );
        let (v, u) = (row - r as f32, column - c as f32);
        let near = &self.belief[r * self.columns + c..][..2];
        let far = &self.belief[(r + 1) * self.columns + c..][..2];
        let low = near[0] + u * (near[1] - near[0]);
        let high = far[0] + u * (far[1] - far[0]);
        low + v * (high - low)
    }

    /// Gathers the evidence of one key frame.
    pub fn fill(
        &mut self,
        points: &[SupportPoint],
        ground: &Ground,
        filter: &PlaneFilter,
        curvature_per_m: f64,
    ) {
        self.weight.fill(0.0);
        self.evidence.fill(0.0);
        for support in points {
            self.splat(support, ground, filter);
        }
        let curvature = curvature_per_m as f32;
        for row in 0..self.rows {
            self.settle(row, filter, curvature);
        }
    }

    fn splat(&mut self, support: &SupportPoint, ground: &Ground, filter: &PlaneFilter) {
        let c = &self.config;
        let (ahead, left) = ground.coordinates(&support.point);
        let height_m = ground.up.dot(&(support.point - ground.foot));
        let column = ((left as f32 + c.side_m) / c.cell_m).floor();
        let row = (ahead as f32 / c.cell_m).floor();
        let inside = row >= 0.0 && column >= 0.0 && row < self.rows as f32 && column < self.columns as f32;
        if !inside || !(-1.0..=3.0).contains(&height_m) {
            return;
        }
        let range_m = ahead.hypot(left).max(0.5);
        // Height error of a depth error along a descending ray, of half a pixel, and of the plane itself.
        let along_m = f64::from(support.depth_sigma_m) * ground.foot.coords.norm() / range_m;
        let plane_m = filter.height_sigma_m(ahead);
        let variance = along_m * along_m + plane_m * plane_m + (0.0007 * range_m).powi(2) + 0.03f64.powi(2);
        let says = witness(height_m as f32, variance as f32, c);
        if !says.is_finite() {
            return;
        }
        let (row, column) = (row as usize, column as usize);
        let fall = |cells: usize, reach_m: f32| {
            let u = cells as f32 * c.cell_m / reach_m.max(0.05);
            (-0.5 * u * u).exp()
        };
        let mut across = [0.0; 2 * KERNEL_LEFT + 1];
        for (offset, share) in across.iter_mut().enumerate() {
            *share = fall(offset.abs_diff(KERNEL_LEFT), c.reach_left_m);
        }
        for r in row.saturating_sub(KERNEL_AHEAD)..(row + KERNEL_AHEAD + 1).min(self.rows) {
            let along = fall(r.abs_diff(row), c.reach_ahead_m);
            for k in column.saturating_sub(KERNEL_LEFT)..(column + KERNEL_LEFT + 1).min(self.columns) {
                let share = along * across[k + KERNEL_LEFT - column];
                self.weight[r * self.columns + k] += share;
                self.evidence[r * self.columns + k] += share * says;
            }
        }
    }

    /// Turns a row's evidence into belief, walking outwards from the path so that barriers shade what lies beyond.
    fn settle(&mut self, row: usize, filter: &PlaneFilter, curvature_per_m: f32) {
        let c = &self.config;
        let ahead_m = (row as f32 + 0.5) * c.cell_m;
        let height_sigma_m = filter.height_sigma_m(f64::from(ahead_m)) as f32;
        let trust = 1.0 / (1.0 + (height_sigma_m / c.height_tolerance_m).powi(2));
        let path_left_m = 0.5 * curvature_per_m * ahead_m * ahead_m;
        let path_column =
            ((path_left_m + c.side_m) / c.cell_m).clamp(0.0, (self.columns - 1) as f32) as usize;
        let path = c.path_log_odds * (-ahead_m / c.path_length_m).exp();
        let forget = (-c.cell_m / c.barrier_fade_m).exp();
        let first = row * self.columns;
        let (mut left_barrier, mut right_barrier) = (0.0f32, 0.0f32);
        for step in 0..self.columns {
            for (column, barrier) in [
                (path_column.checked_add(step), &mut left_barrier),
                (path_column.checked_sub(step + 1), &mut right_barrier),
            ] {
                let Some(column) = column.filter(|&column| column < self.columns) else {
                    continue;
                };
                let index = first + column;
                let weight = self.weight[index];
                // The mean of what the witnesses say; they share the map's errors, so more of them do not add up.
                let says = self.evidence[index] / (weight + 0.5);
                let left_m = (column as f32 + 0.5) * c.cell_m - c.side_m;
                let off_path = (left_m - path_left_m).abs();
                let outside = (off_path - c.path_half_m).max(0.0);
                let lateral = c.lateral_log_odds * (outside / c.lateral_fade_m).min(2.0);
                *barrier = (*barrier * forget).min(c.barrier_share * says.min(0.0));
                let shade = barrier.min(says.min(0.0)) + says.max(0.0);
                let log_odds =
                    path * (-0.5 * outside * outside).exp() + trust * (c.plane_log_odds + lateral + shade);
                self.belief[index] = 1.0 / (1.0 + (-log_odds).exp());
            }
        }
    }
}

/// Log-odds of road given a landmark's height: the road's is normal; other surfaces spread up to 2.5 m, some as low as it.
fn witness(height_m: f32, variance: f32, config: &BeliefConfig) -> f32 {
    let normal = |mean: f32, variance: f32| {
        let u = height_m - mean;
        (-0.5 * u * u / variance).exp() / (variance * core::f32::consts::TAU).sqrt()
    };
    let road = normal(0.0, variance);
    // Pavements stand 0.05 to 0.2 m over the road.
    let kerbed = normal(0.12, variance + 0.0025);
    let spread = if height_m > -0.3 { 0.36 } else { 0.05 };
    let other = config.flat_share * road + 0.5 * (1.0 - config.flat_share) * (kerbed + spread);
    ((road + 1e-6) / (other + 1e-6))
        .ln()
        .clamp(config.witness_against, config.witness_for)
}

#[cfg(test)]
mod tests {
    use super::super::plane::PlaneConfig;
    use super::super::plane::tests::mount;
    use super::*;
    use crate::priors::vehicle_forward;
    use alloc::vec::Vec;

    fn kerbed_road() -> BeliefRaster {
        let mount = mount();
        let ground = Ground::new(&mount.plane_in_camera(), &vehicle_forward(&mount));
        let mut filter = PlaneFilter::new(&mount, &PlaneConfig::default());
        // As after a good fit: 1 cm and 2 mrad.
        filter.update(&super::super::plane::PlaneFit {
            slopes: filter.expected(),
            variance: nalgebra::Vector3::new(1e-4, 4e-6, 1e-6),
            voters: 100,
            inliers: 100,
            sigma_m: 0.02,
        });
        let points: Vec<_> = (0..60)
            .map(|i| SupportPoint {
                point: ground.point(4.0 + 0.25 * f64::from(i), -4.0) + ground.up * 0.12,
                depth_sigma_m: 0.05,
            })
            .collect();
        let mut raster = BeliefRaster::new(BeliefConfig::default());
        raster.fill(&points, &ground, &filter, 0.0);
        raster
    }

    #[test]
    fn kerb_speaks_against_itself_and_what_lies_beyond() {
        let raster = kerbed_road();
        let (lane, kerb, beyond, other_side) = (
            raster.at(8.0, 0.0),
            raster.at(8.0, -4.0),
            raster.at(8.0, -5.5),
            raster.at(8.0, 4.0),
        );
        assert!(
            lane > 0.65 && kerb < 0.45 && beyond < 0.5,
            "{lane} {kerb} {beyond}"
        );
        // A bare plane says next to nothing, for a lawn is one too.
        assert!((0.35..0.55).contains(&other_side), "{other_side}");
    }

    #[test]
    fn belief_stays_in_its_range() {
        let raster = kerbed_road();
        assert!(raster.belief.iter().all(|b| (0.0..=1.0).contains(b)));
        assert!(raster.at(f32::NAN, 1e9).is_finite() || raster.at(f32::NAN, 1e9).is_nan());
        assert!((0.3..0.7).contains(&raster.at(55.0, 10.0)));
    }
}
