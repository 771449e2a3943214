//! Spaces, poses and time: the words every stage shares.
//!
//! | space   | axes                              | origin                               | unit  |
//! |---------|-----------------------------------|--------------------------------------|-------|
//! | world   | as vehicle at the first key frame | vehicle origin at the first frame    | metre |
//! | vehicle | x ahead, y left, z up (ISO 8855)  | on the ground under the rear axle    | metre |
//! | camera  | x right, y down, z ahead          | optical centre                       | metre |
//! | image   | x right, y down                   | centre of the top-left pixel         | pixel |
//! | cell    | row ahead, column left            | grid corner nearest the car, right   | cell  |
//!
//! A pose is named `a_from_b`: `point_in_a = a_from_b * point_in_b`.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A rigid motion; `world_from_camera` takes points in camera space to world space.
pub type Pose = Isometry3<f64>;

/// Microseconds of the monotonic clock, at capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Micros(pub u64);

impl Micros {
    /// Time since `earlier`, zero where `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// This instant moved on by `micros`.
    #[must_use]
    pub const fn plus(self, micros: u64) -> Self {
        Self(self.0.saturating_add(micros))
    }

    /// Seconds since `earlier`, negative where `earlier` is later.
    #[must_use]
    pub fn seconds_since(self, earlier: Self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "2^52 us are 142 years")]
        let seconds = |micros: u64| micros as f64 * 1e-6;
        if self >= earlier {
            seconds(self.0 - earlier.0)
        } else {
            -seconds(earlier.0 - self.0)
        }
    }
}

/// The camera's place on the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(deny_unknown_fields))]
pub struct Mount {
    /// Height of the optical centre over the ground.
    pub height_m: f64,
    /// Distance of the optical centre ahead of the rear axle.
    #[cfg_attr(feature = "serde", serde(default))]
    pub ahead_m: f64,
    /// Distance of the optical centre left of the vehicle's centre line.
    #[cfg_attr(feature = "serde", serde(default))]
    pub left_m: f64,
    /// Pitch of the optical axis, positive down.
    #[cfg_attr(feature = "serde", serde(default))]
    pub pitch_rad: f64,
    /// Yaw of the optical axis, positive left.
    #[cfg_attr(feature = "serde", serde(default))]
    pub yaw_rad: f64,
    /// Roll of the camera about its optical axis, positive clockwise as the camera sees it.
    #[cfg_attr(feature = "serde", serde(default))]
    pub roll_rad: f64,
}

impl Mount {
    /// The pose that takes camera space to vehicle space.
    #[must_use]
    pub fn vehicle_from_camera(&self) -> Pose {
        // Columns: the camera's x (right), y (down) and z (ahead) axes in vehicle space, before pitch, yaw and roll.
        let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let level = Rotation3::from_matrix_unchecked(axes);
        let yaw = Rotation3::from_axis_angle(&Vector3::z_axis(), self.yaw_rad);
        let pitch = Rotation3::from_axis_angle(&Vector3::y_axis(), self.pitch_rad);
        let roll = Rotation3::from_axis_angle(&Vector3::x_axis(), self.roll_rad);
        Pose::from_parts(
            Translation3::new(self.ahead_m, self.left_m, self.height_m),
            UnitQuaternion::from_rotation_matrix(&(yaw * pitch * roll * level)),
        )
    }

    /// The road plane in camera space where the vehicle stands level on it.
    #[must_use]
    pub fn plane_in_camera(&self) -> Plane {
        let up = self.vehicle_from_camera().rotation.inverse() * Vector3::z();
        Plane {
            normal: up,
            offset_m: self.height_m,
        }
    }
}

/// A plane with its unit normal towards the free side: `normal . point + offset_m` is the height of `point` over it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plane {
    /// Unit normal; for a road it points up.
    pub normal: Vector3<f64>,
    /// Height of the space's origin over the plane.
    pub offset_m: f64,
}

impl Plane {
    /// Signed height of a point over the plane.
    #[must_use]
    pub fn height_m(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&point.coords) + self.offset_m
    }

    /// The same plane in space `a`, this one being in space `b`.
    #[must_use]
    pub fn moved(&self, a_from_b: &Pose) -> Self {
        let normal = a_from_b.rotation * self.normal;
        Self {
            normal,
            offset_m: self.offset_m - normal.dot(&a_from_b.translation.vector),
        }
    }

    /// Distance along a ray from the origin to the plane, in lengths of `ray`; none where it does not meet the plane ahead.
    #[must_use]
    pub fn ray_distance(&self, ray: &Vector3<f64>) -> Option<f64> {
        let descent = -self.normal.dot(ray);
        (descent > 1e-9).then(|| self.offset_m / descent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_mount_looks_ahead() {
        let mount = Mount {
            height_m: 1.5,
            ahead_m: 2.0,
            left_m: 0.0,
            pitch_rad: 0.0,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        };
        let ahead = mount.vehicle_from_camera() * Point3::new(0.0, 0.0, 10.0);
        assert!((ahead - Point3::new(12.0, 0.0, 1.5)).norm() < 1e-12);
        let right = mount.vehicle_from_camera() * Point3::new(1.0, 0.0, 0.0);
        assert!((right - Point3::new(2.0, -1.0, 1.5)).norm() < 1e-12);
    }

    #[test]
    fn pitch_down_lowers_the_axis() {
        let mount = Mount {
            height_m: 1.5,
            ahead_m: 0.0,
            left_m: 0.0,
            pitch_rad: 0.1,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        };
        assert!((mount.vehicle_from_camera() * Point3::new(0.0, 0.0, 10.0)).z < 1.0);
    }

    #[test]
    fn plane_moves_with_its_points() {
        let mount = Mount {
            height_m: 1.5,
            ahead_m: 1.0,
            left_m: 0.2,
            pitch_rad: 0.03,
            yaw_rad: 0.1,
            roll_rad: 0.02,
        };
        let in_camera = mount.plane_in_camera();
        let in_vehicle = in_camera.moved(&mount.vehicle_from_camera());
        assert!((in_vehicle.normal - Vector3::z()).norm() < 1e-12 && in_vehicle.offset_m.abs() < 1e-12);
        let ray = Vector3::new(0.1, 0.3, 1.0);
        let hit = Point3::from(ray * in_camera.ray_distance(&ray).unwrap());
        assert!(in_camera.height_m(&hit).abs() < 1e-12);
    }
}
