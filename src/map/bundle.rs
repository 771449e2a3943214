//! Windowed bundle adjustment: poses and landmarks that agree best with all sightings, wheel distances and tracked motions.
//!
//! In and out: the [`Window`]; the oldest `held` views keep their poses and so the map its place. One [`Bundle::iterate`] is one
//! Levenberg-Marquardt iteration; a step that does not lower the cost is taken back. Landmarks are eliminated one by one (Schur
//! complement), the poses solved densely. Robust: Huber on the reprojection error. Cost: at most
//! [`BUNDLE_LANDMARKS`] landmarks with [`WINDOW_VIEWS`] sightings each; landmarks beyond wait for a later window.
//! Source: Triggs et al., *Bundle adjustment: a modern synthesis* (2000), as the refinement of Robust SLAM.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use nalgebra::{Matrix2x3, Matrix3, Matrix6, Matrix6x3, Point3, UnitQuaternion, Vector3, Vector6};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::dense::solve_cholesky;
use super::motion_factor::{Rig, Row, path_sigma_m, rows, wheel_row};
use super::triangulate::{SIGHT_SIGMA_PX, depth_sigma, reprojection};
use super::window::{Entry, Window};
use crate::budget::{BUNDLE_LANDMARKS, MAX_ITERATIONS, WINDOW_VIEWS};
use crate::space::Pose;

/// Reprojection errors count linearly beyond.
const HUBER_PX: f64 = 1.0;
/// A sighting behind its camera costs as much as one this far off.
const BEHIND_PX: f64 = 50.0;
/// Wheel and tracked residuals count linearly beyond this many standard deviations.
const HUBER_SIGMA: f64 = 3.0;
/// Relative fall of the cost below which the adjustment has converged.
const CONVERGED: f64 = 1e-3;
const FIRST_DAMPING: f64 = 1e-4;
const MAX_DAMPING: f64 = 1e4;

const POSES: usize = 6 * WINDOW_VIEWS;

/// Derivatives of one sighting, weighted to unit variance.
#[derive(Clone, Copy)]
struct Link {
    /// Which of the free views.
    view: usize,
    /// Turn and position of the view by the landmark.
    coupling: Matrix6x3<f64>,
}

/// The length of all believed wheel steps together: the errors of single steps (half a pulse at each end) cancel in it.
struct Path {
    residual_m: f64,
    length_m: f64,
    by_views: [f64; POSES],
}

impl Default for Path {
    fn default() -> Self {
        Self {
            residual_m: 0.0,
            length_m: 0.0,
            by_views: [0.0; POSES],
        }
    }
}

impl Path {
    fn add(&mut self, step: &Row, ends: [Option<usize>; 2], chord_m: f64) {
        self.residual_m += step.residual;
        self.length_m += chord_m;
        for (end, by_view) in ends.into_iter().zip([&step.by_first, &step.by_second]) {
            if let Some(view) = end {
                for r in 0..6 {
                    self.by_views[6 * view + r] += by_view[r];
                }
            }
        }
    }

    fn weight(&self) -> f64 {
        path_sigma_m(self.length_m).powi(-2)
    }
}

/// State between iterations and the storage they work in.
#[derive(Debug)]
pub(super) struct Bundle {
    damping: f64,
    iterations: usize,
    converged: bool,
    chosen: Vec<u16>,
    /// Sightings of landmarks in each view.
    sightings: [usize; WINDOW_VIEWS],
    normal: Box<[f64]>,
    factor: Box<[f64]>,
    side: Box<[f64]>,
    saved_poses: Vec<Pose>,
    saved_points: Vec<Point3<f64>>,
    /// Of each chosen landmark: inverse of its damped information, and its gradient.
    landmarks: Vec<(Matrix3<f64>, Vector3<f64>)>,
}

impl Bundle {
    pub(super) fn new() -> Self {
        Self {
            damping: FIRST_DAMPING,
            iterations: 0,
            converged: true,
            chosen: Vec::with_capacity(BUNDLE_LANDMARKS),
            sightings: [0; WINDOW_VIEWS],
            normal: vec![0.0; POSES * POSES].into_boxed_slice(),
            factor: vec![0.0; POSES * POSES].into_boxed_slice(),
            side: vec![0.0; POSES].into_boxed_slice(),
            saved_poses: Vec::with_capacity(WINDOW_VIEWS),
            saved_points: Vec::with_capacity(BUNDLE_LANDMARKS),
            landmarks: Vec::with_capacity(BUNDLE_LANDMARKS),
        }
    }

    /// Chooses the landmarks of a changed window and starts over.
    pub(super) fn restart(&mut self, window: &mut Window) {
        self.damping = FIRST_DAMPING;
        self.iterations = 0;
        self.converged = window.views().len() < 2;
        for view in 0..window.views().len() {
            self.sightings[view] = sightings_in_use(window, view);
        }
        self.chosen.clear();
        // The longest seen first: they tie the window together.
        for least in [6, 4, 3, 2] {
            let most = match least {
                6 => usize::MAX,
                4 => 5,
                other => other,
            };
            for p in 0..window.points.len() {
                let seen = window.entries_of(p).len();
                window.points[p].in_bundle &= least < 6;
                if window.points[p].located
                    && seen >= least
                    && seen <= most
                    && self.chosen.len() < BUNDLE_LANDMARKS
                {
                    #[expect(clippy::cast_possible_truncation, reason = "points are at most MAX_POINTS")]
                    self.chosen.push(p as u16);
                    window.points[p].in_bundle = true;
                }
            }
        }
    }

    /// One iteration; false once nothing more can be gained.
    pub(super) fn iterate(&mut self, window: &mut Window, rig: &Rig, held: usize) -> bool {
        let free = window.views().len().saturating_sub(held);
        if self.converged || free == 0 {
            return false;
        }
        self.iterations += 1;
        let before = self.linearise(window, rig, held);
        let n = 6 * free;
        self.factor[..n * n].copy_from_slice(&self.normal[..n * n]);
        if !solve_cholesky(&mut self.factor[..n * n], n, &mut self.side[..n]) {
            self.raise_damping();
            return !self.converged;
        }
        self.save(window);
        self.apply(window, held);
        let after = self.cost(window, rig);
        if after < before {
            self.damping = (self.damping * 0.2).max(1e-9);
            self.converged = before - after < CONVERGED * before || self.iterations >= MAX_ITERATIONS;
        } else {
            self.restore(window);
            self.raise_damping();
            // No step is better at all near the optimum.
            self.converged |= after - before < 1e-6 * before;
        }
        !self.converged
    }

    fn raise_damping(&mut self) {
        self.damping = (self.damping * 10.0).max(1e-4);
        self.converged = self.damping > MAX_DAMPING || self.iterations >= MAX_ITERATIONS;
    }

    fn save(&mut self, window: &Window) {
        self.saved_poses.clear();
        self.saved_poses
            .extend(window.views().iter().map(|v| v.world_from_camera));
        self.saved_points.clear();
        self.saved_points.extend(
            self.chosen
                .iter()
                .map(|&p| window.points[usize::from(p)].point_in_world),
        );
    }

    fn restore(&self, window: &mut Window) {
        for (view, pose) in window.views_mut().iter_mut().zip(&self.saved_poses) {
            view.world_from_camera = *pose;
        }
        for (&p, point) in self.chosen.iter().zip(&self.saved_points) {
            window.points[usize::from(p)].point_in_world = *point;
        }
    }

    /// Fills the reduced normal equations; returns the cost.
    fn linearise(&mut self, window: &Window, rig: &Rig, held: usize) -> f64 {
        let n = 6 * (window.views().len() - held);
        self.normal[..n * n].fill(0.0);
        self.side[..n].fill(0.0);
        self.landmarks.clear();
        let mut rotations = [Matrix3::identity(); WINDOW_VIEWS];
        for (rotation, view) in rotations.iter_mut().zip(window.views()) {
            *rotation = *view
                .world_from_camera
                .rotation
                .inverse()
                .to_rotation_matrix()
                .matrix();
        }
        let mut cost = self.add_motion(window, rig, held, n);
        let mut diagonal = [Matrix6::zeros(); WINDOW_VIEWS];
        for index in 0..self.chosen.len() {
            cost += self.add_landmark(
                window,
                usize::from(self.chosen[index]),
                &rotations,
                held,
                n,
                &mut diagonal,
            );
        }
        for (view, block) in diagonal[..n / 6].iter().enumerate() {
            self.add_block(view, view, block, n);
        }
        for i in 0..n {
            self.normal[i * n + i] += self.damping * diagonal[i / 6][(i % 6, i % 6)].max(1.0);
        }
        cost
    }

    fn add_motion(&mut self, window: &Window, rig: &Rig, held: usize, n: usize) -> f64 {
        let mut cost = 0.0;
        let mut path = Path::default();
        for second in 1..window.views().len() {
            let views = window.views();
            let ends = [(second - 1).checked_sub(held), second.checked_sub(held)];
            if let Some(step) = wheel_row(rig, &views[second - 1], &views[second]) {
                path.add(&step, ends, views[second].wheel_step.map_or(0.0, |w| w.chord_m));
            }
            for row in rows(rig, &views[second - 1], &views[second], self.sightings[second]) {
                let (loss, weight) = huber(row.residual.abs(), HUBER_SIGMA);
                cost += loss;
                let ends = [(ends[0], &row.by_first), (ends[1], &row.by_second)];
                for (a, by_a) in ends {
                    let Some(a) = a else { continue };
                    for r in 0..6 {
                        self.side[6 * a + r] -= weight * row.residual * by_a[r];
                        for (b, by_b) in ends {
                            let Some(b) = b else { continue };
                            for c in 0..6 {
                                self.normal[(6 * a + r) * n + 6 * b + c] += weight * by_a[r] * by_b[c];
                            }
                        }
                    }
                }
            }
        }
        let weight = path.weight();
        for i in 0..n {
            self.side[i] -= weight * path.residual_m * path.by_views[i];
            for j in 0..=i {
                self.normal[i * n + j] += weight * path.by_views[i] * path.by_views[j];
            }
        }
        cost + 0.5 * weight * path.residual_m.powi(2)
    }

    /// Eliminates one landmark: adds its part of the reduced equations; returns its cost.
    fn add_landmark(
        &mut self,
        window: &Window,
        point: usize,
        rotations: &[Matrix3<f64>; WINDOW_VIEWS],
        held: usize,
        n: usize,
        diagonal: &mut [Matrix6<f64>; WINDOW_VIEWS],
    ) -> f64 {
        let position = window.points[point].point_in_world.coords;
        let mut links: heapless::Vec<Link, WINDOW_VIEWS> = heapless::Vec::new();
        let mut information = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        let mut cost = 0.0;
        for &entry in window.entries_of(point) {
            let sighting = window.sighting(entry);
            if !sighting.agrees {
                continue;
            }
            let v = usize::from(entry.view);
            let in_camera =
                rotations[v] * (position - window.views()[v].world_from_camera.translation.vector);
            let Some((residual, by_camera)) = reprojection(sighting, &in_camera) else {
                cost += huber(BEHIND_PX, HUBER_PX).0 / SIGHT_SIGMA_PX.powi(2);
                continue;
            };
            let (loss, weight) = huber(residual.norm(), HUBER_PX);
            cost += loss / SIGHT_SIGMA_PX.powi(2);
            let weight = weight / SIGHT_SIGMA_PX.powi(2);
            let by_point: Matrix2x3<f64> = by_camera * rotations[v];
            let own = by_point.tr_mul(&by_point) * weight;
            let pull = by_point.tr_mul(&residual) * weight;
            information += own;
            gradient += pull;
            let Some(view) = v.checked_sub(held) else { continue };
            // A view's shift acts as the landmark's opposite shift: position blocks are those of the landmark.
            let by_turn: Matrix2x3<f64> = by_camera * in_camera.cross_matrix();
            let turn_by_point = by_turn.tr_mul(&by_point) * weight;
            let turn_pull = by_turn.tr_mul(&residual) * weight;
            let block = &mut diagonal[view];
            let turn_by_turn = by_turn.tr_mul(&by_turn) * weight;
            for r in 0..3 {
                for c in 0..3 {
                    block[(r, c)] += turn_by_turn[(r, c)];
                    block[(3 + r, c)] -= turn_by_point[(c, r)];
                    block[(r, 3 + c)] -= turn_by_point[(r, c)];
                    block[(3 + r, 3 + c)] += own[(r, c)];
                }
                self.side[6 * view + r] -= turn_pull[r];
                self.side[6 * view + 3 + r] += pull[r];
            }
            let mut coupling = Matrix6x3::zeros();
            coupling.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn_by_point);
            coupling.fixed_view_mut::<3, 3>(3, 0).copy_from(&(-own));
            let _ = links.push(Link { view, coupling });
        }
        for k in 0..3 {
            information[(k, k)] += self.damping * information[(k, k)] + 1e-9;
        }
        let inverse = information.try_inverse().unwrap_or_else(Matrix3::zeros);
        self.landmarks.push((inverse, gradient));
        for (i, a) in links.iter().enumerate() {
            let reduced = a.coupling * inverse;
            let pull = reduced * gradient;
            for r in 0..6 {
                self.side[6 * a.view + r] += pull[r];
            }
            for b in &links[..=i] {
                self.add_block(a.view, b.view, &(-(reduced * b.coupling.transpose())), n);
            }
        }
        cost
    }

    fn add_block(&mut self, a: usize, b: usize, block: &Matrix6<f64>, n: usize) {
        for r in 0..6 {
            let start = (6 * a + r) * n + 6 * b;
            for (c, value) in self.normal[start..start + 6].iter_mut().enumerate() {
                *value += block[(r, c)];
            }
        }
    }

    /// Moves the poses by the solution and each landmark by what follows from it.
    fn apply(&self, window: &mut Window, held: usize) {
        for (&p, (inverse, gradient)) in self.chosen.iter().zip(&self.landmarks) {
            let point = usize::from(p);
            let position = window.points[point].point_in_world.coords;
            let mut pull = -gradient;
            for &entry in window.entries_of(point) {
                pull -= self.pull_of_view(window, entry, &position, held);
            }
            window.points[point].point_in_world += inverse * pull;
        }
        for (view, step) in window.views_mut()[held..]
            .iter_mut()
            .zip(self.side.chunks_exact(6))
        {
            let pose = &mut view.world_from_camera;
            pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
            pose.translation.vector += Vector3::new(step[3], step[4], step[5]);
        }
    }

    /// Coupling of a landmark with a view, times the view's step.
    fn pull_of_view(
        &self,
        window: &Window,
        entry: Entry,
        position: &Vector3<f64>,
        held: usize,
    ) -> Vector3<f64> {
        let v = usize::from(entry.view);
        let sighting = window.sighting(entry);
        let Some(view) = v.checked_sub(held).filter(|_| sighting.agrees) else {
            return Vector3::zeros();
        };
        let pose = &window.views()[v].world_from_camera;
        let camera_from_world = pose.rotation.inverse().to_rotation_matrix();
        let in_camera = camera_from_world * (position - pose.translation.vector);
        let Some((residual, by_camera)) = reprojection(sighting, &in_camera) else {
            return Vector3::zeros();
        };
        let weight = huber(residual.norm(), HUBER_PX).1 / SIGHT_SIGMA_PX.powi(2);
        let step = Vector6::from_row_slice(&self.side[6 * view..6 * view + 6]);
        let by_point: Matrix2x3<f64> = by_camera * camera_from_world.matrix();
        let moved =
            by_camera * (in_camera.cross(&step.fixed_rows::<3>(0))) - by_point * step.fixed_rows::<3>(3);
        by_point.tr_mul(&moved) * weight
    }

    fn cost(&self, window: &Window, rig: &Rig) -> f64 {
        let mut cost = 0.0;
        let views = window.views();
        let mut path = Path::default();
        for second in 1..views.len() {
            if let Some(step) = wheel_row(rig, &views[second - 1], &views[second]) {
                path.add(
                    &step,
                    [None, None],
                    views[second].wheel_step.map_or(0.0, |w| w.chord_m),
                );
            }
            for row in rows(rig, &views[second - 1], &views[second], self.sightings[second]) {
                cost += huber(row.residual.abs(), HUBER_SIGMA).0;
            }
        }
        cost += 0.5 * path.weight() * path.residual_m.powi(2);
        let mut camera_from_world = [Matrix3::identity(); WINDOW_VIEWS];
        for (inverse, view) in camera_from_world.iter_mut().zip(views) {
            *inverse = *view
                .world_from_camera
                .rotation
                .inverse()
                .to_rotation_matrix()
                .matrix();
        }
        for &p in &self.chosen {
            let point = &window.points[usize::from(p)].point_in_world;
            for &entry in window.entries_of(usize::from(p)) {
                let sighting = window.sighting(entry);
                if sighting.agrees {
                    let view = usize::from(entry.view);
                    let offset = point.coords - views[view].world_from_camera.translation.vector;
                    let error = sighting.error_px(&Point3::from(camera_from_world[view] * offset));
                    cost += huber(error.unwrap_or(BEHIND_PX), HUBER_PX).0 / SIGHT_SIGMA_PX.powi(2);
                }
            }
        }
        cost
    }
}

/// Information of a landmark's position from all its sightings, as the standard deviation along its latest ray.
pub(super) fn landmark_depth_sigma(window: &Window, point: usize) -> Option<f64> {
    let position = window.points[point].point_in_world.coords;
    let mut information = Matrix3::zeros();
    let mut ray = None;
    for &entry in window.entries_of(point) {
        let sighting = window.sighting(entry);
        if !sighting.agrees {
            continue;
        }
        let pose = &window.views()[usize::from(entry.view)].world_from_camera;
        let camera_from_world = pose.rotation.inverse().to_rotation_matrix();
        let offset = position - pose.translation.vector;
        let (_, by_camera) = reprojection(sighting, &(camera_from_world * offset))?;
        let by_point: Matrix2x3<f64> = by_camera * camera_from_world.matrix();
        information += by_point.tr_mul(&by_point);
        ray = Some(offset);
    }
    depth_sigma(&information, &ray?)
}

fn sightings_in_use(window: &Window, view: usize) -> usize {
    super::resection::located(&window.views()[view], &window.points)
        .filter(|(s, _)| s.agrees)
        .count()
}

/// Huber's loss (half the square near zero) and the weight it gives.
fn huber(error: f64, threshold: f64) -> (f64, f64) {
    if error <= threshold {
        (0.5 * error * error, 1.0)
    } else {
        (threshold * (error - 0.5 * threshold), threshold / error)
    }
}
