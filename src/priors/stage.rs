//! The stage: landmarks of the map to plane, boxes, `I(p)` and its soft form.
//!
//! In: landmarks in world space, the key frame's pose. Out: [`Priors`] in world space and, at the CRF resolution, the
//! indicator, surface and belief of this key frame and of the previous one seen from here (the paper's `D2`).
//! Invariant: after every step all buffers are of this step. Cost: the sum of its parts; nothing is allocated in a step.

#![allow(clippy::cast_possible_truncation, reason = "metres fit f32")]

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::{Point3, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::belief::{BeliefConfig, BeliefRaster};
use super::boxes::{BoxBuilder, BoxConfig};
use super::ground::{Ground, vehicle_forward};
use super::plane::{
    PlaneConfig, PlaneFilter, PlaneScratch, PlaneSearch, ScaleEstimate, ScaleSearch, SupportPoint,
    find_plane, find_scale,
};
use super::ray_cast::{RayCaster, Surface};
use super::{ObstacleBox, PlaneEstimate, Priors};
use crate::budget::{MAX_BOXES, MAX_LANDMARKS};
use crate::frame::{Camera, RayTable};
use crate::map::Landmark;
use crate::space::{Micros, Plane, Pose};

/// Configuration of the stage.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct PriorsConfig {
    /// Road plane.
    pub plane: PlaneConfig,
    /// Obstacle boxes.
    pub boxes: BoxConfig,
    /// Soft evidence.
    pub belief: BeliefConfig,
    /// Rays longer than this meet no plane.
    pub max_range_m: f32,
}

impl Default for PriorsConfig {
    fn default() -> Self {
        Self {
            plane: PlaneConfig::default(),
            boxes: BoxConfig::default(),
            belief: BeliefConfig::default(),
            max_range_m: 60.0,
        }
    }
}

/// A slower car stands.
const STILL_MPS: f64 = 0.1;
/// After this way landmarks say something new of the plane; before, their errors are those of the key frame before, and what is
/// counted again and again would pull the plane of a car that stands or crawls after them. A longer way follows the bends of a
/// real road too slowly: F on KITTI 03 is 90.6 % with 3 m, 89.8 % with 10 m, 90.5 % where all is new each time.
const NEWS_M: f64 = 3.0;
/// How much the camera bobs on the springs while it travels.
const TRAVEL_SHAKE_M: f64 = 0.01;

/// Seen-from-here buffers of one set of priors, `[H, W]`.
#[derive(Clone, Debug)]
struct View {
    indicator: Box<[u8]>,
    surface: Box<[u8]>,
    belief: Box<[f32]>,
}

impl View {
    fn new(pixels: usize) -> Self {
        Self {
            indicator: vec![0; pixels].into_boxed_slice(),
            surface: vec![0; pixels].into_boxed_slice(),
            belief: vec![0.5; pixels].into_boxed_slice(),
        }
    }
}

/// A key frame before this one.
#[derive(Clone, Copy, Debug)]
struct Past {
    world_from_camera: Pose,
    stamp: Micros,
}

/// Stage 4.
#[derive(Clone, Debug)]
pub struct PriorsStage {
    config: PriorsConfig,
    forward: Vector3<f64>,
    caster: RayCaster,
    filter: PlaneFilter,
    plane_scratch: PlaneScratch,
    scale_search: ScaleSearch,
    builder: BoxBuilder,
    points: Box<[SupportPoint]>,
    priors: Priors,
    previous: Priors,
    raster: BeliefRaster,
    raster_previous: BeliefRaster,
    current_view: View,
    previous_view: View,
    past: Option<Past>,
    plane_in_camera: Plane,
    curvature_per_m: f64,
    /// Way since landmarks last made the plane.
    since_fit_m: f64,
}

impl PriorsStage {
    /// The stage for a camera whose CRF image is `crf_width x crf_height`.
    #[must_use]
    pub fn new(camera: &Camera, config: PriorsConfig, crf_width: usize, crf_height: usize) -> Self {
        let scale = |crf: usize, full: usize| crf as f64 / full.max(1) as f64;
        let lens = camera
            .lens
            .scaled(scale(crf_width, camera.width), scale(crf_height, camera.height));
        let nowhere = SupportPoint {
            point: Point3::origin(),
            depth_sigma_m: 0.0,
        };
        let pixels = crf_width * crf_height;
        Self {
            config,
            forward: vehicle_forward(&camera.mount),
            caster: RayCaster::new(&RayTable::new(&lens, crf_width, crf_height), config.max_range_m),
            filter: PlaneFilter::new(&camera.mount, &config.plane),
            plane_scratch: PlaneScratch::new(MAX_LANDMARKS),
            scale_search: ScaleSearch::new(MAX_LANDMARKS),
            builder: BoxBuilder::new(config.boxes, MAX_LANDMARKS),
            points: vec![nowhere; MAX_LANDMARKS].into_boxed_slice(),
            priors: Priors::default(),
            previous: Priors::default(),
            raster: BeliefRaster::new(config.belief),
            raster_previous: BeliefRaster::new(config.belief),
            current_view: View::new(pixels),
            previous_view: View::new(pixels),
            past: None,
            plane_in_camera: camera.mount.plane_in_camera(),
            curvature_per_m: 0.0,
            since_fit_m: f64::INFINITY,
        }
    }

    /// Plane, boxes and beliefs of a key frame.
    pub fn step(&mut self, landmarks: &[Landmark], world_from_camera: &Pose, stamp: Micros) -> &Priors {
        core::mem::swap(&mut self.priors, &mut self.previous);
        core::mem::swap(&mut self.raster, &mut self.raster_previous);
        let count = self.gather(landmarks, world_from_camera);
        self.predict(world_from_camera, stamp);
        let found = find_plane(
            &self.points[..count],
            &self.search(),
            &self.config.plane,
            &mut self.plane_scratch,
        );
        if let Some(fit) = &found {
            self.filter.update(fit);
            self.since_fit_m = 0.0;
        }
        let plane = self.filter.plane();
        self.plane_in_camera = plane;
        let ground = Ground::new(&plane, &self.forward);
        let mut boxes = heapless::Vec::<ObstacleBox, MAX_BOXES>::new();
        self.builder.build(&self.points[..count], &ground, &mut boxes);
        self.caster.cast(
            Some(&plane),
            &boxes,
            &mut self.current_view.indicator,
            &mut self.current_view.surface,
        );
        self.raster
            .fill(&self.points[..count], &ground, &self.filter, self.curvature_per_m);
        let pitch_sigma_rad = self.filter.variance()[1].sqrt();
        believe(
            &self.caster,
            &plane,
            &ground,
            &self.raster,
            &self.config.belief,
            pitch_sigma_rad,
            &mut self.current_view,
        );
        self.look_back(world_from_camera, pitch_sigma_rad);
        self.priors.stamp = stamp;
        self.priors.plane = Some(PlaneEstimate {
            plane: plane.moved(world_from_camera),
            inliers: found.map_or(0, |fit| fit.inliers),
            sigma_m: found.map_or(self.config.plane.distance_sigma_m as f32, |fit| fit.sigma_m),
        });
        self.priors.boxes.clear();
        for obstacle in &boxes {
            // As many as there is room for: both lists have the same capacity.
            let _ = self.priors.boxes.push(obstacle.moved(world_from_camera));
        }
        self.past = Some(Past {
            world_from_camera: *world_from_camera,
            stamp,
        });
        &self.priors
    }

    /// Without a fresh map: the last plane, boxes and belief as seen from a new pose, the plane marked as held.
    pub fn hold(&mut self, world_from_camera: &Pose, stamp: Micros) -> &Priors {
        if self.past.is_none() {
            return self.step(&[], world_from_camera, stamp);
        }
        core::mem::swap(&mut self.priors, &mut self.previous);
        core::mem::swap(&mut self.raster, &mut self.raster_previous);
        self.look_back(world_from_camera, self.filter.variance()[1].sqrt());
        core::mem::swap(&mut self.priors, &mut self.previous);
        core::mem::swap(&mut self.raster, &mut self.raster_previous);
        self.current_view
            .indicator
            .copy_from_slice(&self.previous_view.indicator);
        self.current_view
            .surface
            .copy_from_slice(&self.previous_view.surface);
        self.current_view
            .belief
            .copy_from_slice(&self.previous_view.belief);
        if let Some(estimate) = &mut self.priors.plane {
            estimate.inliers = 0;
            self.plane_in_camera = estimate.plane.moved(&world_from_camera.inverse());
        }
        &self.priors
    }

    /// The map's metric scale from the camera height, for a car without encoders. Does not change the stage's state.
    pub fn measure_scale(
        &mut self,
        landmarks: &[Landmark],
        world_from_camera: &Pose,
    ) -> Option<ScaleEstimate> {
        let count = self.gather(landmarks, world_from_camera);
        find_scale(
            &self.points[..count],
            &self.search(),
            &self.config.plane,
            &mut self.scale_search,
            &mut self.plane_scratch,
        )
    }

    /// The priors of the latest key frame, in world space.
    #[must_use]
    pub const fn priors(&self) -> &Priors {
        &self.priors
    }

    /// The latest plane in the key frame's camera space; the mount's before the first step.
    #[must_use]
    pub const fn plane_in_camera(&self) -> Plane {
        self.plane_in_camera
    }

    /// `I(p)` of the latest key frame, `[H, W]`, 1 = road plane first.
    #[must_use]
    pub fn indicator(&self) -> &[u8] {
        &self.current_view.indicator
    }

    /// What each ray meets first, `[H, W]` of [`Surface`].
    #[must_use]
    pub fn surface(&self) -> &[u8] {
        &self.current_view.surface
    }

    /// `I(p)` of the key frame before, seen from here; equal to [`Self::indicator`] where there is none.
    #[must_use]
    pub fn indicator_previous(&self) -> &[u8] {
        &self.previous_view.indicator
    }

    /// Soft form of `I(p)`, `[H, W]` in [0, 1].
    #[must_use]
    pub fn belief(&self) -> &[f32] {
        &self.current_view.belief
    }

    /// Soft form of the key frame before, seen from here; equal to [`Self::belief`] where there is none.
    #[must_use]
    pub fn belief_previous(&self) -> &[f32] {
        &self.previous_view.belief
    }

    /// Curvature of the car's path as driven since the last key frame, positive left.
    #[must_use]
    pub const fn curvature_per_m(&self) -> f64 {
        self.curvature_per_m
    }

    fn search(&self) -> PlaneSearch {
        PlaneSearch {
            expected: self.filter.expected(),
            variance: self.filter.variance(),
            forward: self.forward,
            curvature_per_m: self.curvature_per_m,
            news: (self.since_fit_m / NEWS_M).min(1.0),
        }
    }

    fn gather(&mut self, landmarks: &[Landmark], world_from_camera: &Pose) -> usize {
        let camera_from_world = world_from_camera.inverse();
        let mut count = 0;
        for (support, landmark) in self.points.iter_mut().zip(landmarks) {
            *support = SupportPoint {
                point: camera_from_world * landmark.point_in_world,
                depth_sigma_m: landmark.depth_sigma_m,
            };
            count += 1;
        }
        count
    }

    /// Moves the plane's expectation on and reads the path's curvature off the last two poses.
    fn predict(&mut self, world_from_camera: &Pose, stamp: Micros) {
        let Some(past) = self.past else { return };
        let past_from_now = past.world_from_camera.inverse() * world_from_camera;
        let driven_m = past_from_now.translation.vector.norm();
        self.filter.turn(&past_from_now.rotation.inverse());
        let seconds = stamp.seconds_since(past.stamp);
        // Under a car that stands the road stays as it is.
        if driven_m > STILL_MPS * seconds {
            self.filter.predict(seconds);
        }
        self.since_fit_m += driven_m;
        let up = self.filter.plane().normal;
        let turned = past_from_now.rotation * self.forward;
        let yaw_rad = up
            .dot(&self.forward.cross(&turned))
            .atan2(self.forward.dot(&turned));
        // Standing still keeps the last curvature; a car turns no tighter than 5 m.
        if driven_m > 0.5 {
            let travelled = past_from_now
                .rotation
                .inverse_transform_vector(&past_from_now.translation.vector);
            let shake_rad = TRAVEL_SHAKE_M / driven_m;
            let sigma_rad = self.config.plane.travel_sigma_rad.hypot(shake_rad);
            self.filter.travel(&travelled, sigma_rad);
            let measured = (yaw_rad / driven_m).clamp(-0.2, 0.2);
            self.curvature_per_m = 0.5 * (self.curvature_per_m + measured);
        }
    }

    /// The previous priors, moved to this camera by the pose.
    fn look_back(&mut self, world_from_camera: &Pose, pitch_sigma_rad: f64) {
        let (Some(past), Some(estimate)) = (self.past, self.previous.plane) else {
            self.previous_view
                .indicator
                .copy_from_slice(&self.current_view.indicator);
            self.previous_view
                .surface
                .copy_from_slice(&self.current_view.surface);
            self.previous_view
                .belief
                .copy_from_slice(&self.current_view.belief);
            return;
        };
        let camera_from_world = world_from_camera.inverse();
        let plane = estimate.plane.moved(&camera_from_world);
        let mut boxes = heapless::Vec::<ObstacleBox, MAX_BOXES>::new();
        for obstacle in &self.previous.boxes {
            // Same capacity on both sides.
            let _ = boxes.push(obstacle.moved(&camera_from_world));
        }
        self.caster.cast(
            Some(&plane),
            &boxes,
            &mut self.previous_view.indicator,
            &mut self.previous_view.surface,
        );
        // The raster belongs to the ground below the previous camera; its frame moves like the plane does.
        let camera_from_past = camera_from_world * past.world_from_camera;
        let past_plane = estimate.plane.moved(&past.world_from_camera.inverse());
        let there = Ground::new(&past_plane, &self.forward);
        let ground = Ground {
            foot: camera_from_past * there.foot,
            ahead: camera_from_past.rotation * there.ahead,
            left: camera_from_past.rotation * there.left,
            up: camera_from_past.rotation * there.up,
        };
        believe(
            &self.caster,
            &plane,
            &ground,
            &self.raster_previous,
            &self.config.belief,
            pitch_sigma_rad,
            &mut self.previous_view,
        );
    }
}

/// Belief of every pixel: the raster's where its ray meets the plane, against road where it is blocked or over the horizon.
fn believe(
    caster: &RayCaster,
    plane: &Plane,
    ground: &Ground,
    raster: &BeliefRaster,
    config: &BeliefConfig,
    pitch_sigma_rad: f64,
    view: &mut View,
) {
    let blocked = 1.0 / (1.0 + (-config.blocked_log_odds).exp());
    let (ahead, left): (Vector3<f32>, Vector3<f32>) = (ground.ahead.cast(), ground.left.cast());
    let foot_ahead_m = ground.ahead.dot(&ground.foot.coords) as f32;
    let foot_left_m = ground.left.dot(&ground.foot.coords) as f32;
    let normal: Vector3<f32> = plane.normal.cast();
    let horizon_rad = (2.0 * pitch_sigma_rad + 0.004) as f32;
    for (index, belief) in view.belief.iter_mut().enumerate() {
        let ray = caster.ray(index);
        let surface = view.surface[index];
        *belief = if surface == Surface::Plane as u8 {
            let distance_m = caster.plane_distance_m()[index];
            raster.at(
                distance_m * ahead.dot(&ray) - foot_ahead_m,
                distance_m * left.dot(&ray) - foot_left_m,
            )
        } else if surface == Surface::Box as u8 {
            blocked
        } else {
            // Between the farthest plane pixel and the horizon nothing is known; over it, soon not road.
            let rise = (normal.dot(&ray) / horizon_rad).clamp(0.0, 1.0);
            0.5 + rise * (blocked - 0.5)
        };
    }
}

#[cfg(test)]
mod tests;
