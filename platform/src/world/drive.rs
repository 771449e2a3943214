//! The ego car's motion: how far along its lane it is at any time, and how far each wheel has rolled.
//!
//! A profile is a list of phases of constant acceleration, repeated until the road ends, so the distance has a closed
//! form at any time. The car follows its lane with the rear axle's centre; wheels follow from the path's curvature.
//! In: seconds. Out: metres, poses. Invariant: distance never falls; at time 0 the pose is the identity.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "table indices are clamped to the path's length"
)]

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::road::Road;
use freespace::space::Pose;

/// Metres along the road between samples of the rolled distances.
const STEP_M: f64 = 0.25;

/// How the ego car drives; the phases repeat from the acceleration on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Speed at time 0.
    pub start_mps: f64,
    /// Speed held between accelerating and braking.
    pub cruise_mps: f64,
    /// Acceleration and deceleration.
    pub acceleration_mps2: f64,
    /// Time at cruising speed.
    pub cruise_s: f64,
    /// Time at rest before going on.
    pub stop_s: f64,
}

impl Default for Drive {
    fn default() -> Self {
        Self {
            start_mps: 5.0,
            cruise_mps: 10.0,
            acceleration_mps2: 1.8,
            cruise_s: 14.0,
            stop_s: 2.0,
        }
    }
}

impl Drive {
    /// Distance and speed at `seconds`, on a road without end.
    #[must_use]
    pub fn at(&self, seconds: f64) -> (f64, f64) {
        let (v, a) = (self.cruise_mps, self.acceleration_mps2);
        let start = self.start_mps.clamp(0.0, v);
        // The first acceleration starts at `start`; extend it backwards to a standstill to make all rounds alike.
        let spent = start / a;
        let offset = 0.5 * start * spent;
        let ramp = v / a;
        let round = 2.0 * ramp + self.cruise_s + self.stop_s;
        let round_m = v * (ramp + self.cruise_s);
        let time = seconds.max(0.0) + spent;
        let rounds = (time / round).floor();
        let t = time - rounds * round;
        let (metres, speed) = if t < ramp {
            (0.5 * a * t * t, a * t)
        } else if t < ramp + self.cruise_s {
            (0.5 * v * ramp + v * (t - ramp), v)
        } else if t < 2.0 * ramp + self.cruise_s {
            let left = 2.0 * ramp + self.cruise_s - t;
            (round_m - 0.5 * a * left * left, a * left)
        } else {
            (round_m, 0.0)
        };
        (rounds * round_m + metres - offset, speed)
    }
}

/// The rolled distances along the ego lane, tabulated over the road.
#[derive(Clone, Debug)]
pub(super) struct Path {
    lane_d: f64,
    /// Per sample of `s`: distance of the rear axle's centre, then of the four wheels.
    rolled: Vec<[f64; 5]>,
}

impl Path {
    /// Rolls the car along its lane for `length_m` of road.
    pub(super) fn new(road: &Road, lane_d: f64, length_m: f64, track_m: f64, wheelbase_m: f64) -> Self {
        let count = (length_m / STEP_M) as usize + 2;
        let mut rolled = Vec::with_capacity(count);
        let mut sum = [0.0; 5];
        for i in 0..count {
            rolled.push(sum);
            let s = i as f64 * STEP_M;
            let (x0, y0, h0) = road.world(s, lane_d);
            let (x1, y1, h1) = road.world(s + STEP_M, lane_d);
            let centre = (x1 - x0).hypot(y1 - y0);
            let turn = h1 - h0;
            let half = 0.5 * track_m;
            // Rear wheels move along the car; front wheels are carried round by the turn as well.
            let (left, right) = (centre - turn * half, centre + turn * half);
            let front = turn * wheelbase_m;
            let steps = [centre, left.hypot(front), right.hypot(front), left, right];
            for (total, step) in sum.iter_mut().zip(steps) {
                *total += step;
            }
        }
        Self { lane_d, rolled }
    }

    /// Length of the whole path.
    pub(super) fn length_m(&self) -> f64 {
        self.rolled[self.rolled.len() - 1][0]
    }

    /// Where along the road the rear axle is after `metres` of path, and what the wheels have rolled.
    pub(super) fn at(&self, metres: f64) -> (f64, [f64; 4]) {
        let after = self
            .rolled
            .partition_point(|r| r[0] <= metres)
            .clamp(1, self.rolled.len() - 1);
        let (a, b) = (&self.rolled[after - 1], &self.rolled[after]);
        let f = ((metres - a[0]) / (b[0] - a[0]).max(1e-9)).clamp(0.0, 1.0);
        let wheel = |k: usize| a[k] + f * (b[k] - a[k]);
        (
            (after as f64 - 1.0 + f) * STEP_M,
            [wheel(1), wheel(2), wheel(3), wheel(4)],
        )
    }

    /// Vehicle pose at `s`.
    pub(super) fn world_from_vehicle(&self, road: &Road, s: f64) -> Pose {
        let (x, y, heading) = road.world(s, self.lane_d);
        Pose::from_parts(
            Translation3::new(x, y, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading),
        )
    }
}
