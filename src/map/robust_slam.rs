//! The map itself: takes batches of views in, refines itself in quanta, and reports what the tracker should know.
//!
//! In: a [`ViewBatch`] a key frame. Out: [`Landmark`]s and poses in world space, metres. [`Map::insert`] is the base: relative
//! poses, rotation averaging, translation averaging, triangulation and [`BASE_ITERATIONS`] of bundle adjustment leave a valid map
//! always; each [`Map::refine`] is one more iteration; [`Map::finish`] culls. Nothing allocates after [`Map::new`].
//! Source: Patra et al., Robust SLAM (2017): poses of small batches are stabilised by motion averaging before they are bundled.

#![allow(clippy::cast_possible_truncation, reason = "counts are bounded by the window")]

mod placing;

use alloc::vec::Vec;

use nalgebra::Point3;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::bundle::{Bundle, landmark_depth_sigma};
use super::motion_factor::Rig;
use super::resection::{Resection, mismatch, resect};
use super::scale::{ScaleMonitor, Verdict, VisualStep};
use super::triangulate::triangulate;
use super::two_view::{Match, Pcg};
use super::window::{MAX_STRIKES, NO_POINT, WheelStep, Window, is_finite};
use super::{Landmark, MapUpdate, View, ViewBatch};
use crate::budget::{BASE_ITERATIONS, MAX_LANDMARKS, MAX_TRACKS};
use crate::frame::Camera;
use crate::health::ScaleState;
use crate::space::Pose;

/// A sighting this far from its landmark is left out before bundle adjustment, and after it.
const START_GATE_PX: f64 = 8.0;
const FINISH_GATE_PX: f64 = 3.0;
/// Share of a landmark's sightings that must agree.
const MIN_AGREEMENT: f64 = 0.6;
/// Depth over its standard deviation, at least, for a landmark to be given out.
const MIN_DEPTH_CERTAINTY: f64 = 4.0;
/// Views whose tracks the tracker may still follow.
const LIVE_VIEWS: usize = 2;

/// What the map may be told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct MapConfig {
    /// Seed of the random samples; the same seed and input give the same map.
    pub seed: u64,
}

/// A metric map of the last [`WINDOW_VIEWS`](crate::budget::WINDOW_VIEWS) views.
#[derive(Debug)]
pub struct Map {
    camera: Camera,
    rig: Rig,
    window: Window,
    bundle: Bundle,
    scale: ScaleMonitor,
    random: Pcg,
    held: usize,
    rescaled: f64,
    matches: Vec<Match>,
    landmarks: Vec<Landmark>,
}

impl Map {
    /// Reserves all storage.
    #[must_use]
    pub fn new(camera: &Camera, config: &MapConfig) -> Self {
        Self {
            camera: *camera,
            rig: Rig::new(camera),
            window: Window::new(),
            bundle: Bundle::new(),
            scale: ScaleMonitor::new(),
            random: Pcg::new(config.seed),
            held: 1,
            rescaled: 1.0,
            matches: Vec::with_capacity(MAX_TRACKS),
            landmarks: Vec::with_capacity(MAX_LANDMARKS),
        }
    }

    /// Takes new views in; the oldest leave the window. An empty batch changes nothing.
    pub fn insert(&mut self, batch: &ViewBatch) {
        if batch.is_empty() {
            return;
        }
        self.window.make_room(batch.len());
        let first_new = self.window.views().len();
        for view in batch {
            let (world_from_camera, step) = self.predicted(view);
            self.window.push(view, world_from_camera, step, &self.camera);
        }
        self.window.link();
        self.follow_update(first_new);
        self.judge_wheels(first_new);
        self.place(first_new);
        self.gate_new_sightings(first_new);
        self.triangulate_new();
        self.held = match self.scale.state {
            ScaleState::Wheels => 1,
            // The older half of what was known carries the scale on.
            ScaleState::Unknown | ScaleState::CameraHeight | ScaleState::Held => (first_new / 2).max(1),
        };
        self.bundle.restart(&mut self.window);
        for _ in 0..BASE_ITERATIONS {
            if !self.refine() {
                break;
            }
        }
    }

    /// One iteration of bundle adjustment; false once nothing more can be gained.
    pub fn refine(&mut self) -> bool {
        self.bundle.iterate(&mut self.window, &self.rig, self.held)
    }

    /// Culls what does not fit, triangulates again, and renews [`Self::landmarks`].
    pub fn finish(&mut self) {
        for point in 0..self.window.points.len() {
            if self.window.points[point].located {
                self.cull(point);
            }
        }
        self.triangulate_new();
        self.list_landmarks();
    }

    /// The landmarks as of the last [`Self::finish`], ordered by track.
    #[must_use]
    pub fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }

    /// World from camera of the newest view; the identity before the first.
    #[must_use]
    pub fn newest_pose(&self) -> Pose {
        self.window
            .views()
            .last()
            .map_or_else(Pose::identity, |view| view.world_from_camera)
    }

    /// Stamps and poses of the window's views, oldest first.
    pub fn poses(&self) -> impl Iterator<Item = (crate::space::Micros, Pose)> + '_ {
        self.window
            .views()
            .iter()
            .map(|view| (view.stamp, view.world_from_camera))
    }

    /// Where the scale comes from at present.
    #[must_use]
    pub const fn scale_state(&self) -> ScaleState {
        self.scale.state
    }

    /// Running mean of the wheels' distance over the picture's; 1 where both agree.
    #[must_use]
    pub const fn wheel_over_visual(&self) -> f64 {
        self.scale.wheel_over_visual()
    }

    /// Wheel steps that were left out since the start.
    #[must_use]
    pub const fn rejected_wheel_steps(&self) -> u64 {
        self.scale.rejected
    }

    /// Tracks that found no room since the start.
    #[must_use]
    pub const fn untaken_tracks(&self) -> u64 {
        self.window.untaken()
    }

    /// Multiplies the map's lengths about the newest camera, where the camera's height over the road says that they are off.
    pub fn rescale(&mut self, ratio: f64) {
        if ratio.is_finite() && ratio > 0.0 {
            self.multiply_lengths(ratio);
            if self.scale.state == ScaleState::Held {
                self.scale.state = ScaleState::CameraHeight;
            }
        }
    }

    /// Writes what the tracker should learn and starts a new count of rescaling.
    pub fn update_into(&mut self, out: &mut MapUpdate) {
        out.landmarks.clear();
        out.rescale = core::mem::replace(&mut self.rescaled, 1.0);
        let views = self.window.views();
        let Some(newest) = views.last() else {
            out.stamp = None;
            return;
        };
        out.stamp = Some(newest.stamp);
        out.world_from_camera_tracked = newest.tracked;
        out.world_from_camera = newest.world_from_camera;
        let alive = &views[views.len().saturating_sub(LIVE_VIEWS)..];
        for landmark in &self.landmarks {
            let seen = alive.iter().any(|v| {
                v.sightings
                    .binary_search_by_key(&landmark.track, |s| s.track)
                    .is_ok()
            });
            if seen {
                // As large as the list it is filled from.
                let _ = out.landmarks.push((landmark.track, landmark.point_in_world));
            }
        }
    }

    fn multiply_lengths(&mut self, ratio: f64) {
        let centre = self.newest_pose().translation.vector;
        for view in self.window.views_mut() {
            let position = &mut view.world_from_camera.translation.vector;
            *position = centre + (*position - centre) * ratio;
            view.tracked_step.translation.vector *= ratio;
        }
        for point in &mut self.window.points {
            point.point_in_world.coords = centre + (point.point_in_world.coords - centre) * ratio;
            point.depth_sigma_m *= ratio as f32;
        }
        for landmark in &mut self.landmarks {
            landmark.point_in_world.coords = centre + (landmark.point_in_world.coords - centre) * ratio;
            landmark.depth_sigma_m *= ratio as f32;
        }
        self.rescaled *= ratio;
    }

    /// Where the tracked motion puts a new view, and that motion from the view before.
    fn predicted(&self, view: &View) -> (Pose, Pose) {
        let tracked = view.world_from_camera;
        let Some(last) = self.window.views().last() else {
            return (
                if is_finite(&tracked) {
                    tracked
                } else {
                    Pose::identity()
                },
                Pose::identity(),
            );
        };
        let step = last.tracked.inv_mul(&tracked);
        let step = if is_finite(&step) { step } else { Pose::identity() };
        let mut pose = last.world_from_camera * step;
        pose.rotation.renormalize();
        (pose, step)
    }

    /// A tracker that took the last update in between moved to the map's poses; its step from the view before is then one from
    /// the map's pose of that view. The landmarks tell which.
    fn follow_update(&mut self, first_new: usize) {
        let Some(last) = first_new.checked_sub(1) else {
            return;
        };
        let views = self.window.views();
        let (last, first) = (&views[last], &views[first_new]);
        let fit = |pose: &Pose| mismatch(first, &self.window.points, pose);
        let moved = first.tracked;
        if !matches!((fit(&moved), fit(&first.world_from_camera)), (Some(a), Some(b)) if a < b) {
            return;
        }
        let step = last.world_from_camera.inv_mul(&moved);
        self.window.views_mut()[first_new].tracked_step = step;
        for j in first_new..self.window.views().len() {
            let before = self.window.views()[j - 1].world_from_camera;
            let view = &mut self.window.views_mut()[j];
            view.world_from_camera = before * view.tracked_step;
        }
    }

    /// Compares each new wheel step with what the landmarks say of it, and keeps it where it is believed.
    fn judge_wheels(&mut self, first_new: usize) {
        let mut before: Option<Resection> = None;
        for j in first_new..self.window.views().len() {
            let views = self.window.views();
            let seen = resect(&views[j], &self.window.points, &self.start_of(j, before.as_ref()));
            let visual = (j > 0)
                .then(|| self.visual_step(j, before.as_ref(), seen.as_ref()))
                .flatten();
            before = seen;
            let views = self.window.views();
            let travels = if j > 0 {
                views[j - 1].travel.zip(views[j].travel)
            } else {
                None
            };
            let Some((a, b)) = travels else {
                if j > 0 && self.scale.state == ScaleState::Wheels {
                    self.scale.state = ScaleState::Held;
                }
                continue;
            };
            let turn = 0.5 * (b.heading_rad - a.heading_rad);
            let arc_to_chord = if turn.abs() < 1e-6 { 1.0 } else { turn.sin() / turn };
            let chord_m = (b.distance_m - a.distance_m).abs() * arc_to_chord.abs();
            match self.scale.judge(chord_m, visual) {
                Verdict::Believe => self.window.views_mut()[j].wheel_step = Some(WheelStep { chord_m }),
                Verdict::Reject => {}
                Verdict::Relock(ratio) => {
                    self.multiply_lengths(ratio);
                    self.window.views_mut()[j].wheel_step = Some(WheelStep { chord_m });
                    before = None;
                }
            }
        }
    }

    /// Start of a view's resection: the tracked step from where the view before was seen.
    fn start_of(&self, view: usize, before: Option<&Resection>) -> Pose {
        let views = self.window.views();
        before.map_or(views[view].world_from_camera, |b| {
            b.world_from_camera * views[view].tracked_step
        })
    }

    fn visual_step(
        &self,
        view: usize,
        before: Option<&Resection>,
        seen: Option<&Resection>,
    ) -> Option<VisualStep> {
        let seen = seen?;
        let old = &self.window.views()[view - 1].world_from_camera;
        let first = before.map_or(old, |b| &b.world_from_camera);
        let along =
            (seen.world_from_camera.translation.vector - first.translation.vector).try_normalize(1e-3);
        let variance = |r: &Resection| {
            along
                .map_or(r.position_covariance.trace(), |u| {
                    (r.position_covariance * u).dot(&u)
                })
                .max(0.0)
        };
        Some(VisualStep {
            length_m: self.rig.step_m(first, &seen.world_from_camera),
            sigma_m: (variance(seen) + before.map_or(0.0, variance)).sqrt(),
        })
    }

    /// Leaves out sightings of known landmarks that are far off, before they pull at the adjustment.
    fn gate_new_sightings(&mut self, first_new: usize) {
        for v in first_new..self.window.views().len() {
            let camera_from_world = self.window.views()[v].world_from_camera.inverse();
            for s in 0..self.window.views()[v].sightings.len() {
                let sighting = self.window.views()[v].sightings[s];
                if sighting.point == NO_POINT {
                    continue;
                }
                let point = &self.window.points[usize::from(sighting.point)];
                let agrees = !point.located
                    || sighting
                        .error_px(&(camera_from_world * point.point_in_world))
                        .is_some_and(|e| e < START_GATE_PX);
                self.window.views_mut()[v].sightings[s].agrees = agrees;
            }
        }
    }

    /// Locates points that are not yet.
    fn triangulate_new(&mut self) {
        for p in 0..self.window.points.len() {
            let point = self.window.points[p];
            let entries = self.window.entries_of(p);
            if point.located || point.strikes >= MAX_STRIKES || entries.len() < 2 {
                continue;
            }
            if let Some(found) = triangulate(&self.window, entries) {
                let point = &mut self.window.points[p];
                point.located = true;
                point.point_in_world = found.point_in_world;
                point.depth_sigma_m = found.depth_sigma_m as f32;
            }
        }
    }

    /// Judges each sighting of a landmark anew; the landmark goes where too few agree.
    fn cull(&mut self, p: usize) {
        if !self.window.points[p].in_bundle
            && let Some(found) = triangulate(&self.window, self.window.entries_of(p))
        {
            self.window.points[p].point_in_world = found.point_in_world;
        }
        let position: Point3<f64> = self.window.points[p].point_in_world;
        let count = self.window.entries_of(p).len();
        let mut agreeing = 0;
        for k in 0..count {
            let entry = self.window.entries_of(p)[k];
            let pose = &self.window.views()[usize::from(entry.view)].world_from_camera;
            let in_camera = pose.inverse_transform_point(&position);
            let sighting = self.window.sighting_mut(entry);
            sighting.agrees = sighting.error_px(&in_camera).is_some_and(|e| e < FINISH_GATE_PX);
            agreeing += usize::from(sighting.agrees);
        }
        let sigma = landmark_depth_sigma(&self.window, p);
        let point = &mut self.window.points[p];
        point.depth_sigma_m = sigma.map_or(f32::INFINITY, |s| s as f32);
        if agreeing < 2 || (agreeing as f64) < MIN_AGREEMENT * count as f64 {
            point.located = false;
            point.strikes = point.strikes.saturating_add(1);
            // Another try later takes every sighting into account again.
            for k in 0..count {
                let entry = self.window.entries_of(p)[k];
                self.window.sighting_mut(entry).agrees = true;
            }
        }
    }

    fn list_landmarks(&mut self) {
        self.landmarks.clear();
        for (p, point) in self.window.points.iter().enumerate() {
            if !point.located || self.landmarks.len() == MAX_LANDMARKS {
                continue;
            }
            let mut views = 0;
            let mut latest = None;
            for &entry in self.window.entries_of(p) {
                if self.window.sighting(entry).agrees {
                    views += 1;
                    latest = Some(&self.window.views()[usize::from(entry.view)].world_from_camera);
                }
            }
            let Some(latest) = latest else { continue };
            let depth = (point.point_in_world.coords - latest.translation.vector).norm();
            if views >= 3 && f64::from(point.depth_sigma_m) * MIN_DEPTH_CERTAINTY < depth {
                self.landmarks.push(Landmark {
                    track: point.track,
                    point_in_world: point.point_in_world,
                    depth_sigma_m: point.depth_sigma_m,
                    views,
                });
            }
        }
    }
}

#[cfg(test)]
#[path = "robust_slam_tests.rs"]
mod tests;
