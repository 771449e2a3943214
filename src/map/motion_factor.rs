//! What is known of the motion between neighbouring views besides the picture: wheel distance, no side slip, the tracked motion.
//!
//! In: two neighbouring views and the camera's place on the vehicle. Out: residuals over their standard deviations with their
//! derivatives by both poses, turn (in the camera's own space) before position (in world space). The wheels measure the path of
//! the rear axle, so its lever arm from the camera is part of the residual. Cost: eight rows a pair.

use nalgebra::{Matrix3, RowVector6, Vector3};

use super::window::MapView;
use crate::frame::Camera;
use crate::space::Pose;

/// Standard deviation of the wheel distance: half a percent (tyre pressure and load) and half a pulse.
const WHEEL_SIGMA: f64 = 0.002;
const WHEEL_SIGMA_M: f64 = 0.003;
/// Standard deviation of a path over many steps, against its neighbours in time: the tyres do not change meanwhile.
const PATH_SIGMA: f64 = 0.0003;
/// Side slip of the rear axle is below one degree in ordinary driving; the mount's yaw is known no better than two.
const SIDE_SIGMA: f64 = 0.05;
const SIDE_SIGMA_M: f64 = 0.02;
/// Tracked motion without wheels: a tie, not a measurement.
const TURN_SIGMA_RAD: f64 = 0.002;
const TRACKED_SIGMA: f64 = 0.1;
const TRACKED_SIGMA_M: f64 = 0.03;
/// Tracked motion with wheels. Frame to frame, with the wheels' length, the tracker drifts by 0.13 % on KITTI 03, where bundles of
/// views 1.4 m apart drift by 1.3 %: their points foreshorten as they come nearer, all alike, and their many residuals outvote
/// any honest weight of the wheels. So the chain leads, and the bundle places the points.
const WHEELED_TURN_SIGMA_RAD: f64 = 0.0005;
const WHEELED_TRACKED_SIGMA: f64 = 0.001;
const WHEELED_TRACKED_SIGMA_M: f64 = 0.001;
/// Tracked motion of a view with few sightings: as good as the wheels that made it.
const BLIND_TURN_SIGMA_RAD: f64 = 0.003;
const BLIND_TRACKED_SIGMA: f64 = 0.02;
const BLIND_TRACKED_SIGMA_M: f64 = 0.02;
/// Sightings below which a view counts as blind.
const BLIND_SIGHTINGS: usize = 25;

/// Rows of a pair at most.
pub(super) const MAX_ROWS: usize = 8;

/// A residual in standard deviations and its derivatives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub(super) residual: f64,
    pub(super) by_first: RowVector6<f64>,
    pub(super) by_second: RowVector6<f64>,
}

/// The camera's place on the vehicle, as the factors need it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rig {
    /// The rear axle's centre in camera space.
    pub(super) rear_in_camera: Vector3<f64>,
    /// The vehicle's left in camera space.
    left_in_camera: Vector3<f64>,
}

impl Rig {
    pub(super) fn new(camera: &Camera) -> Self {
        let camera_from_vehicle = camera.mount.vehicle_from_camera().inverse();
        Self {
            rear_in_camera: camera_from_vehicle.translation.vector,
            left_in_camera: camera_from_vehicle.rotation * Vector3::y(),
        }
    }

    /// Where the rear axle's centre is in world space.
    pub(super) fn rear(&self, world_from_camera: &Pose) -> Vector3<f64> {
        world_from_camera.rotation * self.rear_in_camera + world_from_camera.translation.vector
    }

    /// Length of the rear axle's step between two poses.
    pub(super) fn step_m(&self, first: &Pose, second: &Pose) -> f64 {
        (self.rear(second) - self.rear(first)).norm()
    }
}

/// Standard deviation of a wheel distance.
pub(super) fn wheel_sigma_m(distance_m: f64) -> f64 {
    WHEEL_SIGMA_M + WHEEL_SIGMA * distance_m
}

/// Standard deviation of a path's length over several steps.
pub(super) fn path_sigma_m(distance_m: f64) -> f64 {
    WHEEL_SIGMA_M + PATH_SIGMA * distance_m
}

fn row(turn: Vector3<f64>, position: Vector3<f64>) -> RowVector6<f64> {
    RowVector6::new(turn.x, turn.y, turn.z, position.x, position.y, position.z)
}

/// All rows between neighbours; `sightings` are those of the second view that bundle adjustment uses.
pub(super) fn rows(
    rig: &Rig,
    first: &MapView,
    second: &MapView,
    sightings: usize,
) -> heapless::Vec<Row, MAX_ROWS> {
    let mut rows = heapless::Vec::new();
    wheel_rows(rig, first, second, &mut rows);
    tracked_rows(first, second, sightings < BLIND_SIGHTINGS, &mut rows);
    rows
}

/// Rear axle's step less the wheel distance, in metres; none where the wheels are not believed or nothing moves.
pub(super) fn wheel_row(rig: &Rig, first: &MapView, second: &MapView) -> Option<Row> {
    let wheel = second.wheel_step?;
    let (a, b) = (&first.world_from_camera, &second.world_from_camera);
    let step = rig.rear(b) - rig.rear(a);
    let along = step.try_normalize(1e-3)?;
    // How the rear axle moves with the turn of each camera: d(R r) = -R [r]x d(turn), and (R [r]x)' u = u' R x r.
    let lever = |pose: &Pose| (pose.rotation.inverse() * along).cross(&rig.rear_in_camera);
    Some(Row {
        residual: step.norm() - wheel.chord_m,
        by_first: row(lever(a), -along),
        by_second: row(-lever(b), along),
    })
}

fn wheel_rows(rig: &Rig, first: &MapView, second: &MapView, rows: &mut heapless::Vec<Row, MAX_ROWS>) {
    let Some(wheel) = second.wheel_step else { return };
    if let Some(row) = wheel_row(rig, first, second) {
        let weight = 1.0 / wheel_sigma_m(wheel.chord_m);
        let _ = rows.push(Row {
            residual: row.residual * weight,
            by_first: row.by_first * weight,
            by_second: row.by_second * weight,
        });
    }
    let (a, b) = (&first.world_from_camera, &second.world_from_camera);
    let step = rig.rear(b) - rig.rear(a);
    let (turn_a, turn_b) = (a.rotation.to_rotation_matrix(), b.rotation.to_rotation_matrix());
    let lever = rig.rear_in_camera.cross_matrix();
    let (by_turn_a, by_turn_b): (Matrix3<f64>, Matrix3<f64>) =
        (turn_a.matrix() * lever, -(turn_b.matrix() * lever));
    // The axle does not slide sideways: its chord points along the mean of both headings.
    let (left_a, left_b) = (turn_a * rig.left_in_camera, turn_b * rig.left_in_camera);
    let left = 0.5 * (left_a + left_b);
    let tilt = rig.left_in_camera.cross_matrix();
    let weight = 1.0 / (SIDE_SIGMA_M + SIDE_SIGMA * wheel.chord_m);
    let half_tilt_a = -0.5 * (turn_a.matrix() * tilt).tr_mul(&step);
    let half_tilt_b = -0.5 * (turn_b.matrix() * tilt).tr_mul(&step);
    let _ = rows.push(Row {
        residual: left.dot(&step) * weight,
        by_first: row(half_tilt_a + by_turn_a.tr_mul(&left), -left) * weight,
        by_second: row(half_tilt_b + by_turn_b.tr_mul(&left), left) * weight,
    });
}

fn tracked_rows(first: &MapView, second: &MapView, is_blind: bool, rows: &mut heapless::Vec<Row, MAX_ROWS>) {
    let tracked = &second.tracked_step;
    let now = first.world_from_camera.inv_mul(&second.world_from_camera);
    let turn_error = (tracked.rotation.inverse() * now.rotation).scaled_axis();
    let step_error = now.translation.vector - tracked.translation.vector;
    let length = tracked.translation.vector.norm();
    let (turn_weight, step_weight) = if second.wheel_step.is_some() {
        (
            1.0 / WHEELED_TURN_SIGMA_RAD,
            1.0 / (WHEELED_TRACKED_SIGMA_M + WHEELED_TRACKED_SIGMA * length),
        )
    } else if is_blind {
        (
            1.0 / BLIND_TURN_SIGMA_RAD,
            1.0 / (BLIND_TRACKED_SIGMA_M + BLIND_TRACKED_SIGMA * length),
        )
    } else {
        (
            1.0 / TURN_SIGMA_RAD,
            1.0 / (TRACKED_SIGMA_M + TRACKED_SIGMA * length),
        )
    };
    let back = now.rotation.inverse().to_rotation_matrix();
    let first_from_world = first.world_from_camera.rotation.inverse().to_rotation_matrix();
    let swing = now.translation.vector.cross_matrix();
    for k in 0..3 {
        let mut unit = Vector3::zeros();
        unit[k] = 1.0;
        let _ = rows.push(Row {
            residual: turn_error[k] * turn_weight,
            by_first: row(-back.matrix().tr_mul(&unit), Vector3::zeros()) * turn_weight,
            by_second: row(unit, Vector3::zeros()) * turn_weight,
        });
        let in_world = first_from_world.matrix().tr_mul(&unit);
        let _ = rows.push(Row {
            residual: step_error[k] * step_weight,
            by_first: row(swing.tr_mul(&unit), -in_world) * step_weight,
            by_second: row(Vector3::zeros(), in_world) * step_weight,
        });
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::super::window::WheelStep;
    use super::*;
    use crate::frame::Lens;
    use crate::space::{Micros, Mount};
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    fn view(pose: Pose, tracked: Pose) -> MapView {
        MapView {
            stamp: Micros(0),
            tracked: Pose::identity(),
            tracked_step: tracked,
            world_from_camera: pose,
            travel: None,
            wheel_step: Some(WheelStep { chord_m: 1.1 }),
            sightings: alloc::vec::Vec::new(),
        }
    }

    fn moved(pose: &Pose, change: &[f64]) -> Pose {
        Pose::from_parts(
            Translation3::from(pose.translation.vector + Vector3::new(change[3], change[4], change[5])),
            pose.rotation * UnitQuaternion::from_scaled_axis(Vector3::new(change[0], change[1], change[2])),
        )
    }

    proptest! {
        #[test]
        fn derivatives_equal_differences(turn in prop::array::uniform3(-0.1..0.1f64), base in prop::array::uniform3(-1.0..1.0f64)) {
            let mount = Mount { height_m: 1.6, ahead_m: 1.7, left_m: 0.2, pitch_rad: 0.02, yaw_rad: 0.01, roll_rad: 0.0 };
            let rig = Rig::new(&Camera { lens: Lens::pinhole(700.0, 700.0, 600.0, 180.0), width: 1242, height: 375, mount });
            let first = Pose::new(Vector3::new(5.0, 3.0, 1.0), Vector3::from(base));
            let second = first * Pose::new(Vector3::new(0.05, -0.02, 1.2), Vector3::from(turn));
            let (a, b) = (view(first, Pose::identity()), view(second, Pose::new(Vector3::new(0.0, 0.0, 1.1), Vector3::from(turn) * 0.99)));
            let at = rows(&rig, &a, &b, 100);
            prop_assert_eq!(at.len(), MAX_ROWS);
            for k in 0..6 {
                let mut change = [0.0; 6];
                change[k] = 1e-6;
                let by_first = rows(&rig, &view(moved(&first, &change), a.tracked_step), &b, 100);
                let by_second = rows(&rig, &a, &view(moved(&second, &change), b.tracked_step), 100);
                // The rows of a turn leave out its second order: half a percent of a weight of 2000 over the whole turn.
                for r in 0..MAX_ROWS {
                    let slope = (by_first[r].residual - at[r].residual) / 1e-6;
                    prop_assert!((slope - at[r].by_first[k]).abs() < 0.02 * (100.0 + slope.abs()), "first {r} {k}: {slope} {}", at[r].by_first[k]);
                    let slope = (by_second[r].residual - at[r].residual) / 1e-6;
                    prop_assert!((slope - at[r].by_second[k]).abs() < 0.02 * (100.0 + slope.abs()), "second {r} {k}: {slope} {}", at[r].by_second[k]);
                }
            }
        }
    }
}
