//! The pose of a frame from what it sees, with the wheels as a prior.
//!
//! In: [`Sighting`]s, unit rays of the new frame with a landmark or with rays of earlier frames; the motion the wheels foretell.
//! Out: the pose `world_from_camera`, and each sighting's residual in pixels. Landmarks give their distance from the ray
//! (two equations), earlier rays give the epipolar distance (one, after Sampson). Iteratively reweighted Gauss-Newton over
//! `pose * exp([rotation, translation])`, Cauchy weights whose scale shrinks, so that a third of the sightings may be wrong.
//!
//! The prior is a factor: the length along the path is known to about 1 %, sideways a car does not slip, the turn rate is
//! nearly constant. Epipolar distances say nothing of the length of a step between two frames; there the prior decides.
//!
//! Invariant: the answer is finite; where the equations fail it is the prediction. Cost: [`POSE_ITERATIONS`] passes.

use nalgebra::{Matrix3, Matrix6, Point3, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::rolling::Rolling;
use crate::budget::{POSE_ITERATIONS, RECENT_POSES};
use crate::space::Pose;

/// Standard deviation of a tracked point, KLT on real images.
const SIGMA_PX: f64 = 0.7;
/// Baselines below this say nothing through epipolar geometry.
const MIN_BASELINE_M: f64 = 1e-3;
/// Scale of the Cauchy weights: wide while the prediction may be off by a bump in the road, narrow at the end. A turn begun between two frames is off by 30 px.
const SCALES_PX: [f64; 6] = [16.0, 8.0, 4.0, 2.0, 1.5, 1.0];
/// A step smaller than this ends the iteration, radians and metres.
const CONVERGED: f64 = 1e-7;

/// What one track tells about the frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sighting {
    /// Unit ray in the new camera.
    pub(crate) ray: Vector3<f64>,
    /// Its landmark in world space.
    pub(crate) landmark: Option<Point3<f64>>,
    /// Rays in earlier frames: index of the frame's pose and unit ray there.
    pub(crate) earlier: [Option<(usize, Vector3<f64>)>; 2],
}

/// The motion foretold and how well it is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior {
    /// Pose of the last frame.
    pub(crate) world_from_previous: Pose,
    /// Rotation foretold, `previous_from_current`.
    pub(crate) rotation: UnitQuaternion<f64>,
    /// Distance along the rear axle's path.
    pub(crate) distance_m: f64,
    /// Standard deviations: rotation, along the path, across it.
    pub(crate) sigma_rotation_rad: f64,
    pub(crate) sigma_along_m: f64,
    pub(crate) sigma_across_m: f64,
}

impl Prior {
    /// How far a pose lies sideways of the foretold path, and over or under it, in standard deviations.
    pub(crate) fn across_sigmas(&self, rolling: &Rolling, pose: &Pose) -> f64 {
        let (off, [_, u, v]) = self.off_path(rolling, &self.world_from_previous.inv_mul(pose));
        u.dot(&off).hypot(v.dot(&off)) / self.sigma_across_m
    }

    /// How far a motion is from the path that its rotation foretells, and the directions along and across that path.
    fn off_path(&self, rolling: &Rolling, motion: &Pose) -> (Vector3<f64>, [Vector3<f64>; 3]) {
        let expected = rolling.translation(self.distance_m, &motion.rotation);
        let along = if expected.norm() > 1e-6 {
            expected.normalize()
        } else {
            rolling.translation(1.0, &UnitQuaternion::identity()).normalize()
        };
        let (u, v) = across(&along);
        (motion.translation.vector - expected, [along, u, v])
    }
}

/// Residual of a sighting: by its landmark where it has one, and the largest epipolar distance.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Residual {
    pub(crate) landmark_px: Option<f32>,
    pub(crate) epipolar_px: f32,
}

/// Solves for the pose; `residuals` are written in the order of `sightings`.
pub(crate) fn solve(
    rolling: &Rolling,
    prior: &Prior,
    earlier: &[Pose],
    focal_px: f64,
    sightings: &[Sighting],
    residuals: &mut [Residual],
) -> Pose {
    let predicted = prior.world_from_previous * rolling.motion(prior.distance_m, prior.rotation);
    let mut pose = predicted;
    let mut relatives = Relatives::default();
    for iteration in 0..POSE_ITERATIONS {
        let scale_px = SCALES_PX[iteration.min(SCALES_PX.len() - 1)];
        let mut system = System::default();
        system.add_prior(rolling, prior, &pose);
        relatives.update(earlier, &pose);
        let current_from_world = pose.inverse();
        for sighting in sightings {
            if let Some(landmark) = &sighting.landmark {
                system.add_landmark(
                    &(current_from_world * landmark),
                    &sighting.ray,
                    focal_px,
                    scale_px,
                );
            }
            for (index, ray) in sighting.earlier.iter().flatten() {
                if let Some(row) = relatives.row(*index, ray, &sighting.ray) {
                    system.add_row(&(row.jacobian * focal_px), row.residual * focal_px, scale_px);
                }
            }
        }
        let Some(step) = system.step() else { break };
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        let shift = Translation3::from(step.fixed_rows::<3>(3).into_owned());
        pose *= Pose::from_parts(shift, turn);
        pose.rotation.renormalize_fast();
        if iteration >= SCALES_PX.len() && step.amax() < CONVERGED {
            break;
        }
    }
    if !pose.to_homogeneous().iter().all(|v| v.is_finite()) {
        pose = predicted;
    }
    relatives.update(earlier, &pose);
    let current_from_world = pose.inverse();
    for (sighting, residual) in sightings.iter().zip(residuals) {
        *residual = relatives.residual(&current_from_world, focal_px, sighting);
    }
    pose
}

/// Two unit vectors across a unit vector.
pub(crate) fn across(ray: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if ray.y.abs() < 0.9 {
        Vector3::y()
    } else {
        Vector3::x()
    };
    let first = helper.cross(ray).normalize();
    (first, ray.cross(&first))
}

/// Distance of a point from a ray, in focal lengths, along two directions across it.
fn off_ray(point: &Vector3<f64>, ray: &Vector3<f64>) -> Option<(Vector2<f64>, [Vector3<f64>; 2], f64)> {
    let depth = ray.dot(point);
    (depth > 0.1).then(|| {
        let (u, v) = across(ray);
        (Vector2::new(u.dot(point), v.dot(point)) / depth, [u, v], depth)
    })
}

/// Motion from the new frame to each earlier one.
struct Relatives {
    motions: heapless::Vec<(Matrix3<f64>, Vector3<f64>), RECENT_POSES>,
}

impl Default for Relatives {
    fn default() -> Self {
        Self {
            motions: heapless::Vec::new(),
        }
    }
}

struct Row {
    jacobian: Vector6<f64>,
    residual: f64,
}

impl Relatives {
    fn update(&mut self, earlier: &[Pose], pose: &Pose) {
        self.motions.clear();
        for world_from_earlier in earlier.iter().take(RECENT_POSES) {
            let motion = world_from_earlier.inv_mul(pose);
            // Bounded by `take`.
            let _ = self.motions.push((
                motion.rotation.to_rotation_matrix().into_inner(),
                motion.translation.vector,
            ));
        }
    }

    /// Epipolar equation `f0 . (t x R f1) = 0` over the standard deviation that a unit of noise on both rays gives it.
    fn row(&self, index: usize, earlier: &Vector3<f64>, ray: &Vector3<f64>) -> Option<Row> {
        let (rotation, translation) = self.motions.get(index)?;
        if translation.norm_squared() < MIN_BASELINE_M * MIN_BASELINE_M {
            return None;
        }
        let turned = rotation * ray;
        let normal = translation.cross(&turned);
        let other = earlier.cross(translation);
        let deviation = (normal.norm_squared() + other.norm_squared()).sqrt();
        if deviation < 1e-9 {
            return None;
        }
        let by_rotation = ray.cross(&(rotation.tr_mul(&other)));
        // The residual does not change with the baseline's length; its numerator does, and would pull the step short.
        let by_translation = turned.cross(earlier);
        let along = translation * (by_translation.dot(translation) / translation.norm_squared());
        let by_translation = rotation.tr_mul(&(by_translation - along));
        let mut jacobian = Vector6::zeros();
        jacobian
            .fixed_rows_mut::<3>(0)
            .copy_from(&(by_rotation / deviation));
        jacobian
            .fixed_rows_mut::<3>(3)
            .copy_from(&(by_translation / deviation));
        Some(Row {
            jacobian,
            residual: earlier.dot(&normal) / deviation,
        })
    }

    #[expect(clippy::cast_possible_truncation, reason = "residuals are f32")]
    fn residual(&self, current_from_world: &Pose, focal_px: f64, sighting: &Sighting) -> Residual {
        let landmark_px = sighting.landmark.map(|landmark| {
            off_ray(&(current_from_world * landmark).coords, &sighting.ray)
                .map_or(f32::INFINITY, |(r, _, _)| (r.norm() * focal_px) as f32)
        });
        let epipolar_px = sighting
            .earlier
            .iter()
            .flatten()
            .filter_map(|(index, ray)| self.row(*index, ray, &sighting.ray))
            .map(|row| (row.residual.abs() * focal_px) as f32)
            .fold(0.0, f32::max);
        Residual {
            landmark_px,
            epipolar_px,
        }
    }
}

/// Normal equations of a step.
#[derive(Default)]
struct System {
    matrix: Matrix6<f64>,
    gradient: Vector6<f64>,
}

impl System {
    fn add_row(&mut self, jacobian: &Vector6<f64>, residual_px: f64, scale_px: f64) {
        let ratio = residual_px / scale_px;
        let weight = 1.0 / ((1.0 + ratio * ratio) * SIGMA_PX * SIGMA_PX);
        self.add(jacobian, residual_px, weight);
    }

    fn add(&mut self, jacobian: &Vector6<f64>, residual: f64, weight: f64) {
        if !(residual * weight).is_finite() {
            return;
        }
        let weighted = jacobian * weight;
        self.gradient += weighted * residual;
        self.matrix.ger(1.0, &weighted, jacobian, 1.0);
    }

    fn add_landmark(&mut self, point: &Point3<f64>, ray: &Vector3<f64>, focal_px: f64, scale_px: f64) {
        let Some((residual, axes, depth)) = off_ray(&point.coords, ray) else {
            return;
        };
        // Both equations share a weight: a landmark is wrong or right as a whole.
        let ratio = residual.norm() * focal_px / scale_px;
        let weight = 1.0 / ((1.0 + ratio * ratio) * SIGMA_PX * SIGMA_PX);
        for (axis, r) in axes.iter().zip(residual.iter()) {
            let slope = (axis - ray * *r) * (focal_px / depth);
            // d point = point x d rotation - d translation
            let by_rotation = slope.cross(&point.coords);
            let mut jacobian = Vector6::zeros();
            jacobian.fixed_rows_mut::<3>(0).copy_from(&by_rotation);
            jacobian.fixed_rows_mut::<3>(3).copy_from(&(-slope));
            self.add(&jacobian, r * focal_px, weight);
        }
    }

    /// The wheels' word on the translation, the turn rate's on the rotation.
    fn add_prior(&mut self, rolling: &Rolling, prior: &Prior, pose: &Pose) {
        let motion = prior.world_from_previous.inv_mul(pose);
        // The arc follows the rotation as solved so far; its own derivative is small and left out.
        let (off, [along, u, v]) = prior.off_path(rolling, &motion);
        let turned = motion.rotation.inverse();
        for (axis, sigma_m) in [
            (along, prior.sigma_along_m),
            (u, prior.sigma_across_m),
            (v, prior.sigma_across_m),
        ] {
            let mut jacobian = Vector6::zeros();
            jacobian.fixed_rows_mut::<3>(3).copy_from(&(turned * axis));
            self.add(&jacobian, axis.dot(&off), 1.0 / (sigma_m * sigma_m));
        }
        let turn = (prior.rotation.inverse() * motion.rotation).scaled_axis();
        let weight = 1.0 / (prior.sigma_rotation_rad * prior.sigma_rotation_rad);
        for i in 0..3 {
            let mut jacobian = Vector6::zeros();
            jacobian[i] = 1.0;
            self.add(&jacobian, turn[i], weight);
        }
    }

    fn step(&self) -> Option<Vector6<f64>> {
        let step = -self.matrix.cholesky()?.solve(&self.gradient);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Mount;
    use alloc::vec;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
        }
    }

    fn rolling() -> Rolling {
        Rolling::new(&Mount {
            height_m: 1.5,
            ahead_m: 1.7,
            left_m: 0.1,
            pitch_rad: 0.02,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        })
    }

    /// A road scene seen twice, a quarter of the tracks wrong: the pose is recovered with and without landmarks.
    fn recover(seed: u64, heading_rad: f64, with_landmarks: bool) -> (f64, f64) {
        let mut random = Random(seed ^ 0x9E37_79B9_7F4A_7C15);
        let rolling = rolling();
        let bump = UnitQuaternion::from_scaled_axis(Vector3::new(0.006, 0.0, 0.003));
        let rotation = rolling.turn(heading_rad) * bump;
        let truth = rolling.motion(1.0, rotation);
        let mut sightings = Vec::new();
        for i in 0..200 {
            let z = 6.0 + 24.0 * (0.5 + 0.5 * random.next());
            let point = Point3::new(random.next() * z * 0.7, random.next() * z * 0.25, z);
            let noise = 0.3 / 700.0;
            let mut blur = || Vector3::new(random.next(), random.next(), 0.0) * noise;
            let before = (point.coords / z + blur()).normalize();
            let seen = truth.inverse() * point;
            let mut ray = seen.coords / seen.z + blur();
            if i % 4 == 0 {
                ray += Vector3::new(random.next(), random.next(), 0.0) * 0.05;
            }
            sightings.push(Sighting {
                ray: ray.normalize(),
                landmark: with_landmarks.then_some(point),
                earlier: [Some((0, before)), None],
            });
        }
        let prior = Prior {
            world_from_previous: Pose::identity(),
            rotation: UnitQuaternion::identity(),
            distance_m: 1.0,
            sigma_rotation_rad: 0.02,
            sigma_along_m: 0.015,
            sigma_across_m: 0.02,
        };
        let mut residuals = vec![Residual::default(); sightings.len()];
        let pose = solve(
            &rolling,
            &prior,
            &[Pose::identity()],
            700.0,
            &sightings,
            &mut residuals,
        );
        let sound = residuals.iter().filter(|r| r.epipolar_px < 1.0).count();
        assert!(sound >= 120, "{sound}");
        let error = truth.inv_mul(&pose);
        (error.rotation.angle(), error.translation.vector.norm())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn landmarks_give_the_pose_among_wrong_tracks(seed in any::<u64>(), heading in -0.015..0.015f64) {
            let (angle, metres) = recover(seed, heading, true);
            prop_assert!(angle < 5e-4 && metres < 0.01, "{angle} {metres}");
        }
    }

    /// One pair of frames, a quarter of it wrong: sideways motion and turning look alike, so a few in a hundred are worse
    /// than the median tells.
    #[test]
    fn epipolar_geometry_gives_the_pose_among_wrong_tracks() {
        let (mut angles, mut metres) = (Vec::new(), Vec::new());
        for seed in 1..=40u64 {
            let heading = 0.015 * (seed as f64 / 20.0 - 1.0);
            let (angle, metre) = recover(seed.wrapping_mul(0xD134_2543_DE82_EF95), heading, false);
            angles.push(angle);
            metres.push(metre);
        }
        angles.sort_unstable_by(f64::total_cmp);
        metres.sort_unstable_by(f64::total_cmp);
        assert!(
            angles[20] < 1e-3 && metres[20] < 0.015,
            "{} {}",
            angles[20],
            metres[20]
        );
        assert!(
            angles[34] < 3e-3 && metres[34] < 0.05,
            "{} {}",
            angles[34],
            metres[34]
        );
    }

    #[test]
    fn a_pose_off_the_path_is_told_in_standard_deviations() {
        let rolling = rolling();
        let prior = Prior {
            world_from_previous: Pose::translation(3.0, 2.0, 1.0),
            rotation: UnitQuaternion::identity(),
            distance_m: 5.0,
            sigma_rotation_rad: 0.02,
            sigma_along_m: 0.05,
            sigma_across_m: 0.1,
        };
        // Any turn is a path, and the distance is another matter.
        for (distance_m, heading_rad) in [(5.0, 0.0), (5.0, 0.2), (4.0, 0.0)] {
            let on_path = prior.world_from_previous * rolling.motion(distance_m, rolling.turn(heading_rad));
            assert!(prior.across_sigmas(&rolling, &on_path) < 1e-6);
        }
        let straight = prior.world_from_previous * rolling.motion(5.0, UnitQuaternion::identity());
        let risen = straight * Pose::translation(0.3, 0.4, 0.0);
        let sigmas = prior.across_sigmas(&rolling, &risen);
        assert!((sigmas - 5.0).abs() < 0.05, "{sigmas}");
    }

    #[test]
    fn nothing_seen_is_dead_reckoning() {
        let rolling = rolling();
        let prior = Prior {
            world_from_previous: Pose::translation(3.0, 2.0, 1.0),
            rotation: rolling.turn(0.03),
            distance_m: 0.8,
            sigma_rotation_rad: 0.02,
            sigma_along_m: 0.01,
            sigma_across_m: 0.01,
        };
        let pose = solve(&rolling, &prior, &[], 700.0, &[], &mut []);
        let expected = prior.world_from_previous * rolling.motion(0.8, prior.rotation);
        assert!((pose.to_homogeneous() - expected.to_homogeneous()).amax() < 1e-12);
    }
}
