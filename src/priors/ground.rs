//! Coordinates on the road: metres ahead and left of the point below the camera.
//!
//! In: a plane in camera space and the direction that counts as ahead. Out: an orthonormal frame on the plane.
//! Invariant: `up`, `ahead`, `left` are right-handed (ISO 8855) and finite, whatever the plane. Cost: constant.

use nalgebra::{Point3, Vector3};

use crate::space::{Mount, Plane};

/// The frame on the road below the camera, in camera space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// The point of the plane below the optical centre.
    pub foot: Point3<f64>,
    /// Unit vector ahead, in the plane.
    pub ahead: Vector3<f64>,
    /// Unit vector to the left, in the plane.
    pub left: Vector3<f64>,
    /// The plane's normal.
    pub up: Vector3<f64>,
}

impl Ground {
    /// The frame whose ahead is `forward` (camera space) laid onto the plane.
    #[must_use]
    pub fn new(plane_in_camera: &Plane, forward: &Vector3<f64>) -> Self {
        let up = plane_in_camera.normal;
        let laid = |v: &Vector3<f64>| (v - up * up.dot(v)).try_normalize(1e-6);
        // A plane seen face-on has no ahead of its own; any direction in it will do.
        let ahead = laid(forward)
            .or_else(|| laid(&Vector3::z()))
            .or_else(|| laid(&Vector3::x()))
            .unwrap_or_else(Vector3::z);
        Self {
            foot: Point3::from(-up * plane_in_camera.offset_m),
            ahead,
            left: up.cross(&ahead),
            up,
        }
    }

    /// Metres ahead of and left of the foot.
    #[must_use]
    pub fn coordinates(&self, point: &Point3<f64>) -> (f64, f64) {
        let from_foot = point - self.foot;
        (self.ahead.dot(&from_foot), self.left.dot(&from_foot))
    }

    /// The point on the road at metres ahead and left of the foot.
    #[must_use]
    pub fn point(&self, ahead_m: f64, left_m: f64) -> Point3<f64> {
        self.foot + self.ahead * ahead_m + self.left * left_m
    }
}

/// The vehicle's x axis in camera space.
#[must_use]
pub fn vehicle_forward(mount: &Mount) -> Vector3<f64> {
    mount.vehicle_from_camera().rotation.inverse() * Vector3::x()
}
