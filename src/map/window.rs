//! The bounded window: its views, the points their tracks may become, and who sees whom.
//!
//! Invariant: a view's sightings and the points are ordered by track; every sighting names its point; `entries` lists the
//! sightings of each point, oldest view first. All storage is reserved by [`Window::new`]. When the window is full the oldest views
//! leave; when the points are full, new tracks are not taken in and counted. Linking costs one merge of both orders a view.

#![allow(
    clippy::cast_possible_truncation,
    reason = "indices are bounded by MAX_POINTS and MAX_TRACKS"
)]

use alloc::vec::Vec;

use nalgebra::{Point3, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::View;
use crate::budget::{MAX_POINTS, MAX_TRACKS, WINDOW_VIEWS};
use crate::frame::{Camera, Lens};
use crate::space::{Micros, Pose};
use crate::track::{TrackId, Travel};

/// Rays this far from the optical axis (cosine) are not used: the normalised image plane stretches without bound.
const MIN_AXIS_COSINE: f64 = 0.2;
/// A sighting whose track no point could be made for.
pub(super) const NO_POINT: u16 = u16::MAX;
/// Failed triangulations after which a track is left alone.
pub(super) const MAX_STRIKES: u8 = 3;

/// A track in a view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    pub(super) track: TrackId,
    pub(super) point: u16,
    /// Whether bundle adjustment believes it.
    pub(super) agrees: bool,
    /// Pixels a unit of the normalised image plane there.
    pub(super) scale_px: f64,
    /// Place in the normalised image plane.
    pub(super) x: f64,
    pub(super) y: f64,
}

impl Sighting {
    pub(super) fn bearing(&self) -> Vector3<f64> {
        Vector3::new(self.x, self.y, 1.0)
    }

    /// Reprojection error in pixels of a point in camera space; none behind the camera.
    pub(super) fn error_px(&self, in_camera: &Point3<f64>) -> Option<f64> {
        (in_camera.z > MIN_DEPTH_M).then(|| {
            let (dx, dy) = (
                in_camera.x / in_camera.z - self.x,
                in_camera.y / in_camera.z - self.y,
            );
            self.scale_px * dx.hypot(dy)
        })
    }
}

/// Points nearer than this to a camera count as behind it.
pub(super) const MIN_DEPTH_M: f64 = 0.2;

#[derive(Clone, Debug)]
pub(super) struct MapView {
    pub(super) stamp: Micros,
    pub(super) tracked: Pose,
    /// Motion from the view before, as tracked, in the map's present scale.
    pub(super) tracked_step: Pose,
    pub(super) world_from_camera: Pose,
    pub(super) travel: Option<Travel>,
    /// Length and turn of the rear axle's step from the view before, where the wheels are believed.
    pub(super) wheel_step: Option<WheelStep>,
    pub(super) sightings: Vec<Sighting>,
}

/// What the wheels say of the step between neighbouring views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WheelStep {
    /// Straight distance, the arc's chord.
    pub(super) chord_m: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct MapPoint {
    pub(super) track: TrackId,
    /// Whether `point_in_world` is known.
    pub(super) located: bool,
    /// Whether the running bundle adjustment moves it.
    pub(super) in_bundle: bool,
    pub(super) strikes: u8,
    pub(super) depth_sigma_m: f32,
    pub(super) point_in_world: Point3<f64>,
}

/// The sighting of a point: which view, which of its sightings.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Entry {
    pub(super) view: u8,
    pub(super) sighting: u16,
}

#[derive(Debug)]
pub(super) struct Window {
    views: Vec<MapView>,
    len: usize,
    pub(super) points: Vec<MapPoint>,
    offsets: Vec<u32>,
    entries: Vec<Entry>,
    untaken: u64,
}

impl Window {
    pub(super) fn new() -> Self {
        let empty = || MapView {
            stamp: Micros(0),
            tracked: Pose::identity(),
            tracked_step: Pose::identity(),
            world_from_camera: Pose::identity(),
            travel: None,
            wheel_step: None,
            sightings: Vec::with_capacity(MAX_TRACKS),
        };
        Self {
            views: (0..WINDOW_VIEWS).map(|_| empty()).collect(),
            len: 0,
            points: Vec::with_capacity(MAX_POINTS),
            offsets: Vec::with_capacity(MAX_POINTS + 1),
            entries: alloc::vec![Entry::default(); WINDOW_VIEWS * MAX_TRACKS],
            untaken: 0,
        }
    }

    pub(super) fn views(&self) -> &[MapView] {
        &self.views[..self.len]
    }

    pub(super) fn views_mut(&mut self) -> &mut [MapView] {
        &mut self.views[..self.len]
    }

    /// Tracks that found no room since the start.
    pub(super) const fn untaken(&self) -> u64 {
        self.untaken
    }

    /// Drops the oldest views until `room` more fit.
    pub(super) fn make_room(&mut self, room: usize) {
        let dropped = (self.len + room).saturating_sub(WINDOW_VIEWS).min(self.len);
        self.views[..self.len].rotate_left(dropped);
        self.len -= dropped;
    }

    /// Takes a view in at `world_from_camera`; rays are computed here, once. Out-of-order and useless observations are left out.
    pub(super) fn push(&mut self, view: &View, world_from_camera: Pose, tracked_step: Pose, camera: &Camera) {
        let Some(slot) = self.views.get_mut(self.len) else {
            return;
        };
        self.len += 1;
        slot.stamp = view.stamp;
        slot.tracked = if is_finite(&view.world_from_camera) {
            view.world_from_camera
        } else {
            world_from_camera
        };
        slot.tracked_step = tracked_step;
        slot.world_from_camera = world_from_camera;
        slot.travel = view
            .travel
            .filter(|t| t.distance_m.is_finite() && t.heading_rad.is_finite());
        slot.wheel_step = None;
        slot.sightings.clear();
        for observation in &view.observations {
            if slot
                .sightings
                .last()
                .is_some_and(|last| last.track >= observation.track)
            {
                continue;
            }
            let pixel = observation.pixel.cast::<f64>();
            if !(pixel.x.is_finite() && pixel.y.is_finite()) {
                continue;
            }
            let Some(ray) = camera
                .lens
                .unproject(&pixel)
                .filter(|ray| ray.z > MIN_AXIS_COSINE)
            else {
                continue;
            };
            let scale_px = match camera.lens {
                Lens::BrownConrady(_) => camera.lens.focal_px(),
                // An equidistant lens has its pixels evenly over the angle, not over its tangent.
                Lens::KannalaBrandt(_) => camera.lens.focal_px() * ray.z * ray.z,
            };
            slot.sightings.push(Sighting {
                track: observation.track,
                point: NO_POINT,
                agrees: true,
                scale_px,
                x: ray.x / ray.z,
                y: ray.y / ray.z,
            });
        }
    }

    /// Brings points and sightings in line after views came or went.
    pub(super) fn link(&mut self) {
        self.take_new_tracks();
        self.count_sightings();
        // Points that no view sees any more leave; what stays is linked again.
        let offsets = &self.offsets;
        let mut index = 0;
        self.points.retain(|_| {
            index += 1;
            offsets[index - 1] > 0
        });
        self.count_sightings();
        let mut start = 0;
        for count in &mut self.offsets {
            let sightings = *count;
            *count = start;
            start += sightings;
        }
        // Filling moves each start to its end, which is the next one's start.
        for (v, view) in self.views[..self.len].iter().enumerate() {
            for (s, sighting) in view.sightings.iter().enumerate() {
                if sighting.point != NO_POINT {
                    let place = &mut self.offsets[usize::from(sighting.point)];
                    self.entries[*place as usize] = Entry {
                        view: v as u8,
                        sighting: s as u16,
                    };
                    *place += 1;
                }
            }
        }
    }

    /// Points for tracks that have none yet; the array is sorted again if any came.
    fn take_new_tracks(&mut self) {
        for v in 0..self.len {
            let known = self.points.len();
            let mut p = 0;
            for s in 0..self.views[v].sightings.len() {
                let track = self.views[v].sightings[s].track;
                while p < known && self.points[p].track < track {
                    p += 1;
                }
                if p < known && self.points[p].track == track {
                    continue;
                }
                if self.points.len() == MAX_POINTS {
                    self.untaken += 1;
                    continue;
                }
                self.points.push(MapPoint {
                    track,
                    located: false,
                    in_bundle: false,
                    strikes: 0,
                    depth_sigma_m: f32::INFINITY,
                    point_in_world: Point3::origin(),
                });
            }
            if self.points.len() > known {
                self.points.sort_unstable_by_key(|point| point.track);
            }
        }
    }

    /// Names each sighting's point and leaves the number of sightings of point `p` in `offsets[p]`.
    fn count_sightings(&mut self) {
        self.offsets.clear();
        self.offsets.resize(self.points.len(), 0);
        for view in &mut self.views[..self.len] {
            let mut p = 0;
            for sighting in &mut view.sightings {
                while p < self.points.len() && self.points[p].track < sighting.track {
                    p += 1;
                }
                sighting.point = NO_POINT;
                if p < self.points.len() && self.points[p].track == sighting.track {
                    sighting.point = p as u16;
                    self.offsets[p] += 1;
                }
            }
        }
    }

    /// The sightings of a point, oldest view first.
    pub(super) fn entries_of(&self, point: usize) -> &[Entry] {
        let start = if point == 0 {
            0
        } else {
            self.offsets[point - 1] as usize
        };
        &self.entries[start..self.offsets[point] as usize]
    }

    pub(super) fn sighting(&self, entry: Entry) -> &Sighting {
        &self.views[usize::from(entry.view)].sightings[usize::from(entry.sighting)]
    }

    pub(super) fn sighting_mut(&mut self, entry: Entry) -> &mut Sighting {
        &mut self.views[usize::from(entry.view)].sightings[usize::from(entry.sighting)]
    }
}

pub(super) fn is_finite(pose: &Pose) -> bool {
    pose.translation
        .vector
        .iter()
        .chain(pose.rotation.coords.iter())
        .all(|x| x.is_finite())
}
