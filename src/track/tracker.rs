//! The tracker: one step a frame, from the last pyramid to the new one.
//!
//! In: the pyramids of the last and this frame, the stamp, wheel [`Travel`] where there is any, and the road plane in camera
//! space. Out: a [`FrameEstimate`]; observations for the map by [`Tracker::view_into`]. The map answers late by
//! [`Tracker::apply`]: the poses since its view are carried over, landmarks replaced.
//!
//! Invariant: tracks are ordered by [`TrackId`]; the pose is always finite and always answered, by dead reckoning if by
//! nothing else, and then all tracks end. Cost: at most [`MAX_TRACKS`] tracks, each followed there and back. When all places are
//! taken no corner is added.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use heapless::Deque;
use nalgebra::{Vector2, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::corners::CornerFinder;
use super::keypoint::Keypoint;
use super::motion::{Foretold, MotionModel};
use super::pose::{Residual, Sighting, solve};
use super::predict::Predictor;
use super::search::{guesses, there_and_back};
use super::{TrackId, Travel};
use crate::budget::{MAX_TRACKS, RECENT_POSES};
use crate::frame::{Camera, Pyramid};
use crate::health::TrackingState;
use crate::map::{MapUpdate, Observation, View};
use crate::space::{Micros, Plane, Pose};

/// Residual above which a track contradicts the pose: epipolar, and by its landmark.
const STRIKE_PX: f32 = 2.0;
const STRIKE_LANDMARK_PX: f32 = 4.0;
/// Strikes that end a track: a car that overtakes, a reflection.
const MAX_STRIKES: u8 = 3;
/// Sightings that agree: below the first the pose is dead reckoning, below the second it is weak.
const MIN_INLIERS: usize = 15;
const GOOD_INLIERS: usize = 60;
/// Share of agreeing sightings below which a pose is weak.
const GOOD_SHARE: f64 = 0.5;
/// After a longer time without a frame a pose on which fewer than this share agree must also be one that a car can have come to:
/// much that looks alike is matched by chance, and half of it may agree on a jump. A step between two frames of an undisturbed
/// camera may well be one, over a bump.
const LOST_FRAMES_S: f64 = 0.2;
const SURE_SHARE: f64 = 0.7;
/// Farthest that such a pose may lie off the path, sideways and up, in standard deviations of the prior. Over gaps of 0.2 to 1 s on
/// two simulated roads, right ones lie 0.7 off at most, wrong ones 2.6 at least.
const MAX_ACROSS_SIGMAS: f64 = 2.0;
/// Median flow of a standing car: sensor noise.
const STANDING_PX: f32 = 0.3;
/// Wheel travel between frames that is none; a few tenths of a count.
const STANDING_M: f64 = 0.006;
/// A view is wanted after this much travel, or this much parallax, or when so many tracks of the last view are lost.
const VIEW_TRAVEL_M: f64 = 1.2;
const VIEW_PARALLAX_PX: f32 = 20.0;
const VIEW_SURVIVORS: f64 = 0.6;
/// Parallax below which even lost tracks are no reason: nothing could be triangulated.
const VIEW_MIN_TRAVEL_M: f64 = 0.1;
/// Longest time between two frames over which a car that drives follows its tracks: after 0.7 s half of what is found at 640x480 is
/// something else, after 0.6 s at 320x240.
const MAX_GAP_S: f64 = 0.5;
/// How the tracker starts and how much it follows.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(deny_unknown_fields, default)
)]
pub struct TrackConfig {
    /// Tracks wanted at once; spread over the image.
    pub wanted_tracks: usize,
    /// Speed assumed before anything is known, where there are no wheels.
    pub initial_speed_mps: f64,
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self {
            wanted_tracks: 600,
            initial_speed_mps: 8.0,
        }
    }
}

/// What the stage says of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameEstimate {
    /// Capture stamp.
    pub stamp: Micros,
    /// Pose of the camera.
    pub world_from_camera: Pose,
    /// How it came about.
    pub state: TrackingState,
    /// Tracks alive.
    pub tracks: usize,
    /// Tracks that agree with the pose.
    pub inliers: usize,
    /// Wheel travel as given.
    pub travel: Option<Travel>,
}

/// A frame behind: its number is its place in the row of all frames.
#[derive(Clone, Copy, Debug)]
struct Past {
    frame: u64,
    stamp: Micros,
    world_from_camera: Pose,
}

/// Follows keypoints and the pose.
#[derive(Clone, Debug)]
pub struct Tracker {
    camera: Camera,
    focal_px: f64,
    tracks: Vec<Keypoint>,
    /// Tracks alive at most: cells with many old tracks must not push the total up.
    most_tracks: usize,
    next_id: u32,
    finder: CornerFinder,
    /// Newest last.
    past: Deque<Past, RECENT_POSES>,
    frame: u64,
    motion: MotionModel,
    state: TrackingState,
    inliers: usize,
    /// Stamp, pose and number of observations of the last view.
    viewed: Option<(Micros, Pose, usize)>,
    wants_view: bool,
    previous_rays: Box<[Vector3<f64>]>,
    sightings: Vec<Sighting>,
    residuals: Box<[Residual]>,
    sorted: Vec<f32>,
    earlier: Vec<Pose>,
    /// Pose of the first frame.
    origin: Pose,
}

impl Tracker {
    /// A tracker that has seen nothing.
    #[must_use]
    pub fn new(camera: &Camera, config: &TrackConfig) -> Self {
        let wanted = config.wanted_tracks.clamp(50, MAX_TRACKS);
        let horizon = camera.lens.project(&Vector3::new(
            0.0,
            -camera.mount.pitch_rad.sin(),
            camera.mount.pitch_rad.cos(),
        ));
        let horizon_px = horizon.map_or(camera.height / 2, |p| {
            p.y.clamp(0.0, camera.height as f64) as usize
        });
        Self {
            camera: *camera,
            focal_px: camera.lens.focal_px(),
            tracks: Vec::with_capacity(MAX_TRACKS),
            most_tracks: (wanted + wanted / 10).min(MAX_TRACKS),
            next_id: 0,
            finder: CornerFinder::new(camera.width, camera.height, horizon_px, wanted),
            past: Deque::new(),
            frame: 0,
            motion: MotionModel::new(&camera.mount, config.initial_speed_mps),
            state: TrackingState::DeadReckoning,
            inliers: 0,
            viewed: None,
            wants_view: false,
            previous_rays: vec![Vector3::z(); MAX_TRACKS].into_boxed_slice(),
            sightings: Vec::with_capacity(MAX_TRACKS),
            residuals: vec![Residual::default(); MAX_TRACKS].into_boxed_slice(),
            sorted: Vec::with_capacity(MAX_TRACKS),
            earlier: Vec::with_capacity(RECENT_POSES),
            origin: camera.mount.vehicle_from_camera(),
        }
    }

    /// A tracker to go on in place of this one, from a pose; no track of it shares a number with the old ones.
    #[must_use]
    pub fn renewed(&self, config: &TrackConfig, origin: Pose) -> Self {
        Self {
            next_id: self.next_id,
            origin,
            ..Self::new(&self.camera, config)
        }
    }

    /// Tracks into a new frame. `previous` is the pyramid of the last frame given to this function.
    pub fn step(
        &mut self,
        previous: &Pyramid,
        current: &Pyramid,
        stamp: Micros,
        travel: Option<Travel>,
        plane_in_camera: &Plane,
    ) -> FrameEstimate {
        let foretold = self.foretell(stamp, travel);
        self.motion.travel = travel;
        let Some(foretold) = foretold else {
            let world_from_camera = self.origin;
            self.remember(stamp, world_from_camera);
            self.add_corners(current, plane_in_camera);
            self.state = TrackingState::DeadReckoning;
            return self.estimate(stamp, world_from_camera);
        };
        let flow_px = self.follow_tracks(
            previous,
            current,
            plane_in_camera,
            &foretold.previous_from_current,
        );
        let standing = flow_px.is_some_and(|px| px < STANDING_PX)
            && (foretold.prior.distance_m.abs() < STANDING_M || !foretold.measured);
        let pose = if standing {
            self.stand(&foretold)
        } else {
            if foretold.dt_s > MAX_GAP_S {
                self.tracks.clear();
            }
            self.solve_pose(&foretold)
        };
        self.remember(stamp, pose);
        self.consider_view(&pose);
        self.add_corners(current, plane_in_camera);
        self.estimate(stamp, pose)
    }

    /// A frame without a usable picture: the pose is dead-reckoned, the tracks wait for the next good one, half a second at most.
    pub fn coast(&mut self, stamp: Micros, travel: Option<Travel>) -> FrameEstimate {
        let pose = match self.foretell(stamp, travel) {
            Some(foretold) => {
                self.state = TrackingState::DeadReckoning;
                self.inliers = 0;
                foretold.pose()
            }
            None => self.origin,
        };
        // Not remembered: the tracks still belong to the last good frame, and so does its pose.
        FrameEstimate {
            travel,
            ..self.estimate(stamp, pose)
        }
    }

    /// Takes the map's answer: landmarks, and the correction of every pose since its newest view.
    pub fn apply(&mut self, update: &MapUpdate) {
        let Some(stamp) = update.stamp else { return };
        let sound = update.rescale.is_finite()
            && update.rescale > 0.0
            && update
                .world_from_camera
                .to_homogeneous()
                .iter()
                .all(|v| v.is_finite());
        if !sound {
            return;
        }
        // The row of poses has been corrected by earlier answers, the pose recorded in the view has not.
        let tracked = self
            .past
            .iter()
            .rev()
            .find(|p| p.stamp == stamp)
            .map(|p| p.world_from_camera)
            // The last view may be older than the row, when the car stands.
            .or_else(|| {
                self.viewed
                    .filter(|viewed| viewed.0 == stamp)
                    .map(|viewed| viewed.1)
            })
            .unwrap_or(update.world_from_camera_tracked);
        let correct = |pose: &Pose| {
            let mut since = tracked.inv_mul(pose);
            since.translation.vector *= update.rescale;
            let mut corrected = update.world_from_camera * since;
            // The inverse of a rotation is taken to be its conjugate, so that an error of its length is doubled here; while the car
            // stands, the same pose passes here at every key frame.
            corrected.rotation.renormalize();
            corrected
        };
        for past in self.past.iter_mut() {
            past.world_from_camera = correct(&past.world_from_camera);
        }
        if let Some((_, pose, _)) = &mut self.viewed {
            *pose = correct(pose);
        }
        self.motion.rescale(update.rescale);
        let mut landmarks = update.landmarks.iter().peekable();
        for track in &mut self.tracks {
            track.inverse_m /= update.rescale;
            track.inverse_sigma /= update.rescale;
            while landmarks.next_if(|(id, _)| *id < track.id).is_some() {}
            track.landmark = landmarks
                .next_if(|(id, _)| *id == track.id)
                .map(|(_, point)| *point)
                .filter(|point| point.coords.iter().all(|v| v.is_finite()));
        }
    }

    /// Writes the newest frame as a view and counts parallax from here on.
    pub fn view_into(&mut self, out: &mut View) {
        out.observations.clear();
        out.travel = self.motion.travel;
        if let Some(past) = self.past.back() {
            out.stamp = past.stamp;
            out.world_from_camera = past.world_from_camera;
        }
        for track in &mut self.tracks {
            track.viewed = None;
            if track.age >= 1 && track.strikes == 0 {
                track.viewed = Some(track.ray);
                // As many places as tracks.
                let _ = out.observations.push(Observation {
                    track: track.id,
                    pixel: track.pixel,
                });
            }
        }
        self.viewed = Some((out.stamp, out.world_from_camera, out.observations.len()));
        self.wants_view = false;
    }

    /// Pose of the last view, as later updates have corrected it.
    #[must_use]
    pub fn world_from_view(&self) -> Option<Pose> {
        self.viewed.map(|viewed| viewed.1)
    }

    /// Whether the newest frame differs enough from the last view to be one.
    #[must_use]
    pub const fn wants_view(&self) -> bool {
        self.wants_view
    }

    /// Pixels of all live tracks, ordered by id, with their id and whether they agree with the pose.
    pub fn tracks(&self) -> impl Iterator<Item = (TrackId, Vector2<f32>, bool)> + '_ {
        self.tracks.iter().map(|t| (t.id, t.pixel, t.strikes == 0))
    }

    fn estimate(&self, stamp: Micros, world_from_camera: Pose) -> FrameEstimate {
        FrameEstimate {
            stamp,
            world_from_camera,
            state: self.state,
            tracks: self.tracks.len(),
            inliers: self.inliers,
            travel: self.motion.travel,
        }
    }

    fn remember(&mut self, stamp: Micros, mut world_from_camera: Pose) {
        // Each frame's pose is a product with the last one's.
        world_from_camera.rotation.renormalize();
        if self.past.is_full() {
            self.past.pop_front();
        }
        self.frame += 1;
        // Just made room.
        let _ = self.past.push_back(Past {
            frame: self.frame,
            stamp,
            world_from_camera,
        });
    }
}

impl Tracker {
    /// Moves every track into the new frame, drops those that are lost; the median flow.
    fn follow_tracks(
        &mut self,
        previous: &Pyramid,
        current: &Pyramid,
        plane: &Plane,
        previous_from_current: &Pose,
    ) -> Option<f32> {
        let predictor = Predictor {
            lens: &self.camera.lens,
            plane,
            current_from_previous: previous_from_current.inverse(),
        };
        let baseline_m = previous_from_current.translation.vector.norm();
        let current_from_world = self
            .past
            .back()
            .map(|past| past.world_from_camera.inverse())
            .unwrap_or_default();
        let (mut kept, total) = (0, self.tracks.len());
        self.sorted.clear();
        for index in 0..total {
            let mut track = self.tracks[index];
            let guesses = guesses(&predictor, &track, &current_from_world, baseline_m, self.focal_px);
            let Some(found) = there_and_back(previous, current, &track.pixel, &guesses) else {
                continue;
            };
            let Some(ray) = self.camera.lens.unproject(&found.pixel.cast()) else {
                continue;
            };
            self.sorted.push((found.pixel - track.pixel).norm());
            self.previous_rays[kept] = track.ray;
            track.pixel = found.pixel;
            track.ray = ray;
            track.age += 1;
            self.tracks[kept] = track;
            kept += 1;
        }
        self.tracks.truncate(kept);
        median(&mut self.sorted)
    }

    /// What is foretold from the last frame on; none before the first.
    fn foretell(&self, stamp: Micros, travel: Option<Travel>) -> Option<Foretold> {
        let last = self.past.back()?;
        let dt_s = stamp.seconds_since(last.stamp).max(1e-3);
        let is_turn_seen = matches!(self.state, TrackingState::Good | TrackingState::Weak);
        Some(
            self.motion
                .foretell(last.world_from_camera, dt_s, travel, is_turn_seen),
        )
    }

    fn stand(&mut self, foretold: &Foretold) -> Pose {
        self.state = TrackingState::Standstill;
        self.inliers = self.tracks.len();
        self.motion.stood(foretold);
        foretold.prior.world_from_previous
    }

    fn solve_pose(&mut self, foretold: &Foretold) -> Pose {
        let oldest = self.past.front().map_or(0, |past| past.frame);
        self.earlier.clear();
        self.earlier
            .extend(self.past.iter().map(|past| past.world_from_camera));
        let newest = self.earlier.len() - 1;
        let slot = |frame: u64| {
            frame
                .checked_sub(oldest)
                .map(|s| s as usize)
                .filter(|s| *s < newest)
        };
        self.sightings.clear();
        for (track, previous_ray) in self.tracks.iter().zip(&self.previous_rays) {
            self.sightings.push(Sighting {
                ray: track.ray,
                landmark: track.landmark,
                earlier: [
                    Some((newest, *previous_ray)),
                    slot(track.anchor.frame).map(|s| (s, track.anchor.ray)),
                ],
            });
        }
        let count = self.sightings.len();
        let mut pose = solve(
            &self.motion.rolling,
            &foretold.prior,
            &self.earlier,
            self.focal_px,
            &self.sightings,
            &mut self.residuals[..count],
        );
        self.inliers = self.residuals[..count].iter().filter(|r| agrees(r)).count();
        let is_short_of = |share: f64| (self.inliers as f64) < share * count as f64;
        let is_jump = foretold.dt_s > LOST_FRAMES_S
            && is_short_of(SURE_SHARE)
            && foretold.prior.across_sigmas(&self.motion.rolling, &pose) > MAX_ACROSS_SIGMAS;
        self.state = if self.inliers < MIN_INLIERS || is_jump {
            pose = foretold.pose();
            TrackingState::DeadReckoning
        } else if self.inliers < GOOD_INLIERS || is_short_of(GOOD_SHARE) {
            TrackingState::Weak
        } else {
            TrackingState::Good
        };
        let previous_from_current = foretold.prior.world_from_previous.inv_mul(&pose);
        self.motion.moved(foretold, &previous_from_current);
        if self.state == TrackingState::DeadReckoning {
            // Too few, or what was matched by chance: neither the next frame nor the map may take it for a sighting of what was
            // known before.
            self.tracks.clear();
            self.inliers = 0;
        } else {
            self.judge_tracks(&pose, &previous_from_current, oldest);
        }
        pose
    }

    /// Strikes for tracks that contradict the pose, distances for the others.
    fn judge_tracks(&mut self, pose: &Pose, previous_from_current: &Pose, oldest: u64) {
        let current_from_previous = previous_from_current.inverse();
        let current_from_world = pose.inverse();
        let sigma_rad = 0.7 / self.focal_px;
        let frame = self.frame + 1;
        let mut kept = 0;
        for index in 0..self.tracks.len() {
            let mut track = self.tracks[index];
            let residual = &self.residuals[index];
            if agrees(residual) {
                track.strikes = track.strikes.saturating_sub(1);
            } else {
                track.strikes += 1;
                if residual.epipolar_px < STRIKE_PX {
                    // The track is fine, its landmark is not.
                    track.landmark = None;
                }
            }
            if track.strikes >= MAX_STRIKES {
                continue;
            }
            let slot = track.anchor.frame.checked_sub(oldest);
            let anchor = slot.and_then(|s| self.earlier.get(s as usize));
            match anchor {
                Some(anchor) => {
                    track.measure_distance(
                        &self.previous_rays[index],
                        &current_from_previous,
                        &(current_from_world * anchor),
                        sigma_rad,
                    );
                    track.renew_anchor(frame);
                }
                None => track.anchor.frame = frame,
            }
            self.tracks[kept] = track;
            kept += 1;
        }
        self.tracks.truncate(kept);
    }

    fn add_corners(&mut self, current: &Pyramid, plane: &Plane) {
        let lens = self.camera.lens;
        let room = self.most_tracks.saturating_sub(self.tracks.len());
        let corners = self
            .finder
            .find(current.base(), self.tracks.iter().map(|t| t.pixel), room, 200);
        for pixel in corners {
            let Some(ray) = lens.unproject(&pixel.cast()) else {
                continue;
            };
            let inverse_m = plane.ray_distance(&ray).map_or(0.0, |d| 1.0 / d.max(1.0));
            let id = TrackId(self.next_id);
            self.next_id = self.next_id.wrapping_add(1);
            self.tracks
                .push(Keypoint::new(id, *pixel, ray, self.frame, inverse_m));
        }
    }

    fn consider_view(&mut self, pose: &Pose) {
        let is_anything_seen = self.tracks.iter().any(|track| track.age >= 1);
        if self.state == TrackingState::Standstill || !is_anything_seen {
            self.wants_view = false;
            return;
        }
        let Some((_, view, observed)) = self.viewed else {
            self.wants_view = true;
            return;
        };
        let view_from_current = view.inv_mul(pose);
        let travel_m = view_from_current.translation.vector.norm();
        self.sorted.clear();
        for track in &self.tracks {
            if let Some(viewed) = &track.viewed {
                let parallax_rad = (view_from_current.rotation * track.ray).cross(viewed).norm();
                self.sorted.push((parallax_rad * self.focal_px) as f32);
            }
        }
        let survivors = self.sorted.len();
        let lost = (survivors as f64) < VIEW_SURVIVORS * observed as f64;
        let parallax_px = median(&mut self.sorted).unwrap_or(0.0);
        self.wants_view = travel_m > VIEW_TRAVEL_M
            || parallax_px > VIEW_PARALLAX_PX
            || (lost && travel_m > VIEW_MIN_TRAVEL_M);
    }
}

fn agrees(residual: &Residual) -> bool {
    residual.epipolar_px < STRIKE_PX && residual.landmark_px.is_none_or(|px| px < STRIKE_LANDMARK_PX)
}

fn median(values: &mut [f32]) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
