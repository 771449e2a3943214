//! Rolling: how the camera moves when the vehicle rolls on its wheels.
//!
//! In: distance of the rear axle along its path and the rotation in between. Out: the camera's motion `previous_from_current`.
//! The rear axle does not slip sideways, so it moves along an arc; a camera ahead of it swings out in a turn.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::space::{Mount, Pose};

/// The vehicle under the camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rolling {
    vehicle_from_camera: Pose,
}

impl Rolling {
    pub(crate) fn new(mount: &Mount) -> Self {
        Self {
            vehicle_from_camera: mount.vehicle_from_camera(),
        }
    }

    /// Translation part of the camera's `previous_from_current` after `distance_m` with that rotation.
    pub(crate) fn translation(&self, distance_m: f64, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
        let level = self.vehicle_from_camera.rotation;
        let ahead = level * (rotation * (level.inverse() * Vector3::x()));
        let heading = ahead.y.atan2(ahead.x);
        let (sin, cos) = heading.sin_cos();
        // Chord of the arc; its series where the angle is too small to divide by.
        let (along, left) = if heading.abs() < 1e-6 {
            (1.0, 0.5 * heading)
        } else {
            (sin / heading, (1.0 - cos) / heading)
        };
        let lever = self.vehicle_from_camera.translation.vector;
        let swing = Vector3::new(
            cos * lever.x - sin * lever.y - lever.x,
            sin * lever.x + cos * lever.y - lever.y,
            0.0,
        );
        level.inverse() * (Vector3::new(along * distance_m, left * distance_m, 0.0) + swing)
    }

    /// The whole motion for a known rotation.
    pub(crate) fn motion(&self, distance_m: f64, rotation: UnitQuaternion<f64>) -> Pose {
        Pose::from_parts(
            Translation3::from(self.translation(distance_m, &rotation)),
            rotation,
        )
    }

    /// The camera's rotation when the vehicle turns left by `heading_rad`.
    pub(crate) fn turn(&self, heading_rad: f64) -> UnitQuaternion<f64> {
        let level = self.vehicle_from_camera.rotation;
        level.inverse() * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad) * level
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_circle_ends_where_it_should() {
        let mount = Mount {
            height_m: 1.5,
            ahead_m: 2.0,
            left_m: 0.3,
            pitch_rad: 0.05,
            yaw_rad: 0.02,
            roll_rad: 0.01,
        };
        let rolling = Rolling::new(&mount);
        let quarter = core::f64::consts::FRAC_PI_2;
        let rotation = rolling.turn(quarter);
        let camera = rolling.motion(10.0 * quarter, rotation);
        let vehicle_from_camera = mount.vehicle_from_camera();
        let vehicle = vehicle_from_camera * camera * vehicle_from_camera.inverse();
        assert!((vehicle.translation.vector - Vector3::new(10.0, 10.0, 0.0)).norm() < 1e-9);
        assert!(
            (vehicle * nalgebra::Point3::new(1.0, 0.0, 0.0) - nalgebra::Point3::new(10.0, 11.0, 0.0)).norm()
                < 1e-9
        );
    }
}
