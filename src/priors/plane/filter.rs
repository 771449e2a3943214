//! The plane from key frame to key frame.
//!
//! In: plane fits. Out: what to expect next. Invariant: of a car that drives without fits the expectation returns to the mount's
//! plane, with the mount's uncertainty: pitch within seconds, height over a minute. Under one that stands it stays. Cost: constant.
//! Source: an Ornstein-Uhlenbeck process a slope, whose stationary spread is the mount's.

use nalgebra::{UnitQuaternion, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::{PlaneConfig, PlaneFit, Slopes, plane_of, slopes_of};
use crate::space::{Mount, Plane};

/// Memory of distance, pitch and roll in seconds: load changes, hills, road crown. Springs are followed by [`PlaneFilter::turn`].
const MEMORY_S: [f64; 3] = [60.0, 3.0, 4.0];

/// Expected slopes of the road plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneFilter {
    nominal: Slopes,
    stationary: Slopes,
    mean: Slopes,
    variance: Slopes,
}

impl PlaneFilter {
    /// Expects the mount's plane.
    #[must_use]
    pub fn new(mount: &Mount, config: &PlaneConfig) -> Self {
        let level = Vector3::new(mount.height_m, 0.0, 0.0);
        let nominal = slopes_of(&mount.plane_in_camera()).unwrap_or(level);
        let stationary = Vector3::new(
            config.distance_sigma_m,
            config.pitch_sigma_rad,
            config.roll_sigma_rad,
        )
        .map(|sigma| (sigma * sigma).max(1e-10));
        Self {
            nominal,
            stationary,
            mean: nominal,
            variance: stationary,
        }
    }

    /// Turns the expectation with the camera: a body that nods on its springs turns against the road, not the road.
    pub fn turn(&mut self, now_from_past: &UnitQuaternion<f64>) {
        let plane = self.plane();
        let turned = Plane {
            normal: now_from_past * plane.normal,
            ..plane
        };
        if let Some(slopes) = slopes_of(&turned).filter(|slopes| slopes.iter().all(|slope| slope.is_finite()))
        {
            self.mean = slopes;
        }
    }

    /// Moves the expectation on by `seconds`.
    pub fn predict(&mut self, seconds: f64) {
        for i in 0..3 {
            let kept = (-seconds.max(0.0) / MEMORY_S[i]).exp();
            self.mean[i] = self.nominal[i] + kept * (self.mean[i] - self.nominal[i]);
            self.variance[i] = kept * kept * self.variance[i] + (1.0 - kept * kept) * self.stationary[i];
        }
    }

    /// Takes in which way the camera has moved, in its own space: a car drives along its road, so the plane is parallel to it.
    pub fn travel(&mut self, direction: &Vector3<f64>, sigma_rad: f64) {
        // y + s z + r x vanishes along the direction.
        let (across, along) = (direction.x / direction.z, -direction.y / direction.z);
        let spread = self.variance[1] + across * across * self.variance[2] + sigma_rad * sigma_rad;
        let error = along - self.mean[1] - across * self.mean[2];
        if !(direction.z > 0.0 && error.is_finite() && spread > 0.0) {
            return;
        }
        let gain = Vector3::new(0.0, self.variance[1], across * self.variance[2]) / spread;
        self.mean += gain * error;
        self.variance[1] *= 1.0 - gain[1];
        self.variance[2] *= 1.0 - gain[2] * across;
    }

    /// Takes over a fit that had this expectation as its prior.
    pub fn update(&mut self, fit: &PlaneFit) {
        self.mean = fit.slopes;
        for i in 0..3 {
            self.variance[i] = fit.variance[i].clamp(1e-10, self.stationary[i]);
        }
    }

    /// Expected slopes.
    #[must_use]
    pub const fn expected(&self) -> Slopes {
        self.mean
    }

    /// Variances of the expected slopes.
    #[must_use]
    pub const fn variance(&self) -> Slopes {
        self.variance
    }

    /// The expected plane, in camera space.
    #[must_use]
    pub fn plane(&self) -> Plane {
        plane_of(&self.mean)
    }

    /// Standard deviation of the plane's height at a distance ahead.
    #[must_use]
    pub fn height_sigma_m(&self, ahead_m: f64) -> f64 {
        (self.variance[0] + self.variance[1] * ahead_m * ahead_m).sqrt()
    }
}
