//! A synthetic street for the map's tests: road, house fronts on both sides, bends, and a tracker that errs as real ones do.

#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "tests"
)]

use alloc::vec::Vec;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};

use super::two_view::Pcg;
use super::{Map, MapConfig, MapUpdate, Observation, View, ViewBatch};
use crate::frame::{Camera, Lens};
use crate::space::{Micros, Mount, Pose};
use crate::track::{TrackId, Travel};

const STEP_M: f64 = 1.2;
const FOCAL_PX: f64 = 720.0;
const SIGHT_M: f64 = 60.0;

pub(super) fn camera() -> Camera {
    Camera {
        lens: Lens::pinhole(FOCAL_PX, FOCAL_PX, 620.0, 187.0),
        width: 1242,
        height: 375,
        mount: Mount {
            height_m: 1.65,
            ahead_m: 1.7,
            left_m: 0.0,
            pitch_rad: 0.01,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        },
    }
}

/// Faults of the encoders: from which view on, and what the wheels report of each metre.
#[derive(Clone, Copy)]
pub(super) struct WheelFault {
    pub(super) from: usize,
    pub(super) until: usize,
    pub(super) ratio: f64,
}

pub(super) struct Street {
    random: Pcg,
    /// World from vehicle of each view.
    truth: Vec<Pose>,
    points: Vec<Point3<f64>>,
    /// Points of tracks that belong to nothing fixed.
    wrong: Vec<bool>,
    pub(super) fault: Option<WheelFault>,
    pub(super) has_wheels: bool,
}

impl Street {
    pub(super) fn new(seed: u64, views: usize) -> Self {
        let mut random = Pcg::new(seed);
        let mut truth = Vec::new();
        let mut points = Vec::new();
        let mut pose = Pose::identity();
        for k in 0..views + (SIGHT_M / STEP_M) as usize {
            truth.push(pose);
            for n in 0..16 {
                let ahead = STEP_M * random.unit();
                let side = if n % 2 == 0 { 1.0 } else { -1.0 };
                let local = match n % 8 {
                    0..=2 => Point3::new(ahead, 9.0 * random.unit() - 4.5, 0.0),
                    3 => Point3::new(ahead, side * (3.0 + random.unit()), 1.5 * random.unit()),
                    _ => Point3::new(ahead, side * 8.0, 7.0 * random.unit()),
                };
                points.push(pose * local);
            }
            // Straight, a bend to the left, straight, a bend to the right: 45 degrees each.
            let bend = match k % 80 {
                20..40 => 0.039,
                60..80 => -0.039,
                _ => 0.0,
            };
            let turn =
                UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.004 * (k as f64 * 0.7).sin(), bend));
            // The rear axle moves along the mean heading.
            let heading = UnitQuaternion::from_scaled_axis(turn.scaled_axis() * 0.5);
            pose = Pose::from_parts(
                (pose.translation.vector + pose.rotation * (heading * Vector3::new(STEP_M, 0.0, 0.0))).into(),
                pose.rotation * turn,
            );
        }
        let wrong = points.iter().map(|_| random.unit() < 0.05).collect();
        Self {
            random,
            truth,
            points,
            wrong,
            fault: None,
            has_wheels: true,
        }
    }

    fn gauss(&mut self) -> f64 {
        (0..12).map(|_| self.random.unit()).sum::<f64>() - 6.0
    }

    pub(super) fn world_from_camera(&self, view: usize) -> Pose {
        self.truth[view] * camera().mount.vehicle_from_camera()
    }

    fn observe(&mut self, k: usize, view: &mut View) {
        let camera_from_world = self.world_from_camera(k).inverse();
        for p in 0..self.points.len() {
            let in_camera = camera_from_world * self.points[p];
            if in_camera.z < 2.0 || in_camera.z > SIGHT_M {
                continue;
            }
            let Some(pixel) = camera().lens.project(&in_camera.coords) else {
                continue;
            };
            if !(0.0..1242.0).contains(&pixel.x) || !(0.0..375.0).contains(&pixel.y) {
                continue;
            }
            // A track lives eight views or so; then the same point is a new track.
            let life = (k + p % 8) / 8;
            let track = TrackId((p * 64 + life % 64) as u32);
            let mut noisy = pixel + Vector2::new(self.gauss(), self.gauss()) * 0.5;
            if self.wrong[p] {
                noisy += Vector2::new(3.0, 1.0) * (k as f64 + p as f64).sin() * 5.0;
            }
            if self.random.unit() < 0.05 {
                noisy += Vector2::new(self.gauss(), self.gauss()) * 20.0;
            }
            let observation = Observation {
                track,
                pixel: noisy.cast(),
            };
            if view.observations.push(observation).is_err() {
                break;
            }
        }
    }

    /// Drives through the street in batches of four views; returns the map's error in position and the true distance at each key frame.
    pub(super) fn drive(&mut self, map: &mut Map, views: usize) -> Vec<Pose> {
        let mut found = Vec::new();
        let mut tracked = self.world_from_camera(0);
        let mut travel = Travel::default();
        let mut update = alloc::boxed::Box::<MapUpdate>::default();
        let mut batch = ViewBatch::new();
        for k in 0..views {
            if k > 0 {
                let step = self.world_from_camera(k - 1).inverse() * self.world_from_camera(k);
                let noise = UnitQuaternion::from_scaled_axis(
                    Vector3::new(self.gauss(), self.gauss(), self.gauss()) * 0.002,
                );
                let length = 1.0 + 0.01 * self.gauss();
                tracked *= Pose::from_parts((step.translation.vector * length).into(), step.rotation * noise);
                let wheel = (self.truth[k - 1].inverse() * self.truth[k])
                    .translation
                    .vector
                    .norm();
                let fault = self
                    .fault
                    .filter(|f| (f.from..f.until).contains(&k))
                    .map_or(1.0, |f| f.ratio);
                travel.distance_m += wheel * fault * (1.0 + 0.003 * self.gauss());
            }
            let mut view = View {
                stamp: Micros(100_000 * k as u64),
                world_from_camera: tracked,
                travel: self.has_wheels.then_some(travel),
                ..View::default()
            };
            self.observe(k, &mut view);
            batch.push(view).unwrap();
            if batch.len() == 4 {
                map.insert(&batch);
                while map.refine() {}
                map.finish();
                map.update_into(&mut update);
                tracked = update.world_from_camera;
                found.push(map.newest_pose());
                batch.clear();
            }
        }
        found
    }
}

pub(super) fn map() -> Map {
    Map::new(&camera(), &MapConfig::default())
}
