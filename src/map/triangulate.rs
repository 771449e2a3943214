//! Triangulation: where the rays of a track meet.
//!
//! In: the sightings of a point in the window's views. Out: its position and the standard deviation of its depth, if the rays
//! meet before all cameras, with parallax and small reprojection errors. Cost: one 3 x 3 solution and [`STEPS`]
//! Gauss-Newton steps over at most [`WINDOW_VIEWS`](crate::budget::WINDOW_VIEWS) sightings.
//! Source: Hartley and Sturm, *Triangulation* (1997): least squares of the distances to the rays, then of the image errors.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "a NaN must fail the comparison")]

use nalgebra::{Matrix2x3, Matrix3, Point3, Vector2, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::window::{Entry, MIN_DEPTH_M, Sighting, Window};
use crate::space::Pose;

/// Gauss-Newton steps after the linear solution.
const STEPS: usize = 2;
/// Largest angle between two rays of a landmark, at least: 2.5 px at 720 px focal length.
const MIN_PARALLAX_RAD: f64 = 0.0035;
/// Root mean square of the reprojection errors, at most.
const MAX_ERROR_PX: f64 = 2.0;
/// Standard deviation of a track's place.
pub(super) const SIGHT_SIGMA_PX: f64 = 0.5;

#[derive(Clone, Copy, Debug)]
pub(super) struct Triangulated {
    pub(super) point_in_world: Point3<f64>,
    pub(super) depth_sigma_m: f64,
}

/// Residual in pixels of a point in camera space and its derivative by that point; none behind the camera.
pub(super) fn reprojection(
    sighting: &Sighting,
    in_camera: &Vector3<f64>,
) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    if !(in_camera.z > MIN_DEPTH_M) {
        return None;
    }
    let inverse = 1.0 / in_camera.z;
    let (x, y) = (in_camera.x * inverse, in_camera.y * inverse);
    let scale = sighting.scale_px;
    let s = scale * inverse;
    Some((
        Vector2::new(scale * (x - sighting.x), scale * (y - sighting.y)),
        Matrix2x3::new(s, 0.0, -s * x, 0.0, s, -s * y),
    ))
}

/// Least squares over the sightings that agree.
pub(super) fn triangulate(window: &Window, entries: &[Entry]) -> Option<Triangulated> {
    let rays = || {
        entries.iter().filter_map(|&entry| {
            let sighting = window.sighting(entry);
            let pose = &window.views()[usize::from(entry.view)].world_from_camera;
            sighting.agrees.then_some((sighting, pose))
        })
    };
    if parallax(rays()) < MIN_PARALLAX_RAD {
        return None;
    }
    let origin = rays().next()?.1.translation.vector;
    let (mut normal, mut side) = (Matrix3::zeros(), Vector3::zeros());
    for (sighting, pose) in rays() {
        let ray = (pose.rotation * sighting.bearing()).normalize();
        let off_ray = Matrix3::identity() - ray * ray.transpose();
        normal += off_ray;
        side += off_ray * (pose.translation.vector - origin);
    }
    let mut point = normal.try_inverse()? * side + origin;
    let mut information = Matrix3::zeros();
    let mut mean_square = 0.0;
    for step in 0..=STEPS {
        let mut gradient = Vector3::zeros();
        let (mut squares, mut count) = (0.0, 0.0);
        information = Matrix3::zeros();
        for (sighting, pose) in rays() {
            let camera_from_world = pose.rotation.inverse();
            let in_camera = camera_from_world * (point - pose.translation.vector);
            let (residual, by_camera) = reprojection(sighting, &in_camera)?;
            let by_point = by_camera * camera_from_world.to_rotation_matrix().matrix();
            information += by_point.tr_mul(&by_point);
            gradient += by_point.tr_mul(&residual);
            squares += residual.norm_squared();
            count += 1.0;
        }
        mean_square = squares / count;
        if step < STEPS {
            point -= information.try_inverse()? * gradient;
        }
    }
    if !(mean_square < MAX_ERROR_PX.powi(2)) {
        return None;
    }
    let (_, latest) = rays().next_back()?;
    let depth_sigma_m = depth_sigma(&information, &(point - latest.translation.vector))?;
    Some(Triangulated {
        point_in_world: Point3::from(point),
        depth_sigma_m,
    })
}

/// Standard deviation along a ray, from the information of the residuals in pixels.
pub(super) fn depth_sigma(information: &Matrix3<f64>, ray: &Vector3<f64>) -> Option<f64> {
    let ray = ray.try_normalize(1e-9)?;
    let variance = ray.dot(&(information.try_inverse()? * ray)) * SIGHT_SIGMA_PX * SIGHT_SIGMA_PX;
    (variance.is_finite() && variance >= 0.0).then(|| variance.sqrt())
}

/// The largest angle of a ray with the first or the last one.
fn parallax<'a>(rays: impl Iterator<Item = (&'a Sighting, &'a Pose)> + Clone) -> f64 {
    let world = |(sighting, pose): (&Sighting, &Pose)| (pose.rotation * sighting.bearing()).normalize();
    let Some(first) = rays.clone().next().map(world) else {
        return 0.0;
    };
    let last = rays.clone().last().map_or(first, world);
    rays.map(world)
        .map(|ray| ray.cross(&first).norm().max(ray.cross(&last).norm()))
        .fold(0.0, f64::max)
}
