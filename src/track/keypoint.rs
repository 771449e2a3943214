//! One keypoint track: where it was seen, how far it is, whether to trust it.
//!
//! The distance is triangulated against an anchor some frames back and carried from frame to frame; it predicts the next
//! frame and is never handed on, the map makes its own.

use nalgebra::{Point3, Vector2, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::TrackId;
use super::pose::across;
use crate::space::Pose;

/// Standard deviation of a distance nobody has measured, as a share of its inverse.
const UNKNOWN: f64 = 1e3;
/// Growth of the deviation from frame to frame: tracks drift.
const FORGETTING: f64 = 1.1;
/// Frames after which the anchor moves up: appearance and drift bound its use.
const ANCHOR_FRAMES: u64 = 12;

/// Ray of a track in an earlier frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Anchor {
    pub(crate) frame: u64,
    pub(crate) ray: Vector3<f64>,
}

/// State of a track.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Keypoint {
    pub(crate) id: TrackId,
    /// Full-size pixel of the distorted image in the newest frame.
    pub(crate) pixel: Vector2<f32>,
    /// Unit ray there.
    pub(crate) ray: Vector3<f64>,
    /// Frames survived.
    pub(crate) age: u32,
    /// Frames in which it contradicted the pose, forgiven one a frame.
    pub(crate) strikes: u8,
    pub(crate) anchor: Anchor,
    /// Inverse distance along the ray and its standard deviation.
    pub(crate) inverse_m: f64,
    pub(crate) inverse_sigma: f64,
    pub(crate) landmark: Option<Point3<f64>>,
    /// Ray at the last view handed out.
    pub(crate) viewed: Option<Vector3<f64>>,
}

impl Keypoint {
    /// A new track; `inverse_m` is the best guess of its inverse distance.
    pub(crate) fn new(
        id: TrackId,
        pixel: Vector2<f32>,
        ray: Vector3<f64>,
        frame: u64,
        inverse_m: f64,
    ) -> Self {
        Self {
            id,
            pixel,
            ray,
            age: 0,
            strikes: 0,
            anchor: Anchor { frame, ray },
            inverse_m,
            inverse_sigma: UNKNOWN,
            landmark: None,
            viewed: None,
        }
    }

    /// Whether the distance is known well enough that, over `baseline_m`, its error moves the track by less than `px`.
    pub(crate) fn distance_known(&self, baseline_m: f64, focal_px: f64, px: f64) -> bool {
        self.inverse_sigma * baseline_m * focal_px < px
    }

    /// Carries the distance into the new frame and sharpens it against the anchor. The new ray is already in place.
    pub(crate) fn measure_distance(
        &mut self,
        previous_ray: &Vector3<f64>,
        current_from_previous: &Pose,
        current_from_anchor: &Pose,
        sigma_rad: f64,
    ) {
        let carried = current_from_previous.rotation * previous_ray
            + current_from_previous.translation.vector * self.inverse_m;
        let norm = carried.norm().max(1e-3);
        self.inverse_m /= norm;
        self.inverse_sigma = (self.inverse_sigma / (norm * norm) * FORGETTING).min(UNKNOWN);

        let (u, v) = across(&self.ray);
        let turned = current_from_anchor.rotation * self.anchor.ray;
        let shift = current_from_anchor.translation.vector;
        let (a, b) = (
            Vector2::new(u.dot(&shift), v.dot(&shift)),
            Vector2::new(u.dot(&turned), v.dot(&turned)),
        );
        let weight = a.norm_squared();
        if weight < 1e-8 {
            return;
        }
        let inverse_there = -a.dot(&b) / weight;
        let here = (turned + shift * inverse_there).norm().max(1e-3);
        let inverse = inverse_there / here;
        let sigma = sigma_rad / (weight.sqrt() * here);
        if inverse.is_finite() && sigma < self.inverse_sigma {
            self.inverse_m = inverse;
            self.inverse_sigma = sigma;
        }
    }

    /// Moves the anchor to the newest frame once it is old.
    pub(crate) fn renew_anchor(&mut self, frame: u64) {
        if frame.saturating_sub(self.anchor.frame) >= ANCHOR_FRAMES {
            self.anchor = Anchor { frame, ray: self.ray };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_comes_from_motion() {
        let point = Point3::new(2.0, 1.0, 12.0);
        let mut point_now = point;
        let start = point.coords.normalize();
        let mut track = Keypoint::new(TrackId(1), Vector2::zeros(), start, 0, 0.01);
        let step = Pose::translation(0.0, 0.0, -0.8);
        let mut from_anchor = Pose::identity();
        for _ in 0..4 {
            let previous = track.ray;
            point_now = step * point_now;
            from_anchor = step * from_anchor;
            track.ray = point_now.coords.normalize();
            track.measure_distance(&previous, &step, &from_anchor, 1e-3);
        }
        assert!((1.0 / track.inverse_m - point_now.coords.norm()).abs() < 1e-6);
        assert!(track.distance_known(0.8, 700.0, 30.0) && !track.distance_known(0.8, 700.0, 0.01));
    }
}
