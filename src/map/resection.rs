//! Resection: the pose of one view from points that are already known.
//!
//! In: sightings and their points in world space, a pose to start from. Out: the pose, its inliers and the covariance of its
//! position. Cost: [`STEPS`] robust Gauss-Newton steps over at most [`MAX_TRACKS`](crate::budget::MAX_TRACKS) points.
//! It is what the wheels are judged by: a step between two resections is metric through the landmarks alone.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "a NaN must fail the comparison")]

use nalgebra::{Matrix2x3, Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::triangulate::{SIGHT_SIGMA_PX, reprojection};
use super::window::{MapPoint, MapView, NO_POINT, Sighting};
use crate::space::Pose;

/// Gauss-Newton steps.
const STEPS: usize = 6;
/// Errors beyond count less and less (Cauchy); the first steps are more tolerant.
const ERROR_SCALE_PX: f64 = 1.5;
/// An inlier's largest error.
const INLIER_PX: f64 = 3.0;
/// Inliers that a resection needs.
const MIN_INLIERS: usize = 25;

#[derive(Clone, Copy, Debug)]
pub(super) struct Resection {
    pub(super) world_from_camera: Pose,
    pub(super) position_covariance: Matrix3<f64>,
}

pub(super) fn located<'a>(
    view: &'a MapView,
    points: &'a [MapPoint],
) -> impl Iterator<Item = (&'a Sighting, &'a MapPoint)> {
    view.sightings
        .iter()
        .filter(|s| s.point != NO_POINT)
        .map(|s| (s, &points[usize::from(s.point)]))
        .filter(|(_, p)| p.located)
}

/// Mean truncated squared error of the located points seen from a pose; none where there are too few.
pub(super) fn mismatch(view: &MapView, points: &[MapPoint], pose: &Pose) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0);
    let camera_from_world = pose.inverse();
    for (sighting, point) in located(view, points) {
        let error = sighting
            .error_px(&(camera_from_world * point.point_in_world))
            .unwrap_or(20.0);
        sum += error.min(20.0).powi(2);
        count += 1;
    }
    (count >= MIN_INLIERS).then(|| sum / count as f64)
}

pub(super) fn resect(view: &MapView, points: &[MapPoint], start: &Pose) -> Option<Resection> {
    let mut pose = *start;
    let mut covariance = None;
    for step in 0..STEPS {
        let tolerance = ERROR_SCALE_PX * if step < 2 { 4.0 } else { 1.0 };
        let mut normal = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        let mut inliers = 0;
        let camera_from_world = pose.rotation.inverse().to_rotation_matrix();
        for (sighting, point) in located(view, points) {
            let in_camera = camera_from_world * (point.point_in_world.coords - pose.translation.vector);
            let Some((residual, by_camera)) = reprojection(sighting, &in_camera) else {
                continue;
            };
            let square = residual.norm_squared();
            inliers += usize::from(square < INLIER_PX * INLIER_PX);
            let weight = 1.0 / (1.0 + square / (tolerance * tolerance)).powi(2);
            let by_turn: Matrix2x3<f64> = by_camera * in_camera.cross_matrix();
            let by_position: Matrix2x3<f64> = -by_camera * camera_from_world.matrix();
            for r in 0..2 {
                let row = Vector6::new(
                    by_turn[(r, 0)],
                    by_turn[(r, 1)],
                    by_turn[(r, 2)],
                    by_position[(r, 0)],
                    by_position[(r, 1)],
                    by_position[(r, 2)],
                );
                normal.syger(weight, &row, &row, 1.0);
                gradient.axpy(-weight * residual[r], &row, 1.0);
            }
        }
        // Only the lower triangle is filled, which is all that Cholesky reads.
        let factor = normal.cholesky()?;
        let change = factor.solve(&gradient);
        if !(change.norm() < 100.0) {
            return None;
        }
        pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::new(change[0], change[1], change[2]));
        pose.translation.vector += Vector3::new(change[3], change[4], change[5]);
        if step + 1 == STEPS {
            if inliers < MIN_INLIERS {
                return None;
            }
            covariance = Some(factor.inverse().fixed_view::<3, 3>(3, 3) * SIGHT_SIGMA_PX * SIGHT_SIGMA_PX);
        }
    }
    covariance.map(|position_covariance| Resection {
        world_from_camera: pose,
        position_covariance,
    })
}
