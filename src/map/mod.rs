//! Stage 3, map: the paper's Robust SLAM over a bounded window of views, metric through the wheel distance.
//!
//! In: a [`ViewBatch`] a key frame, tracked pixels and wheel travel. Out: [`Landmark`]s and the newest pose in world space, and
//! a [`MapUpdate`] for the tracker. [`Map`] tells how.

mod bundle;
mod dense;
mod five_point;
mod motion_factor;
mod resection;
mod robust_slam;
mod rotation_averaging;
mod scale;
#[cfg(test)]
mod street;
mod translation_averaging;
mod triangulate;
mod two_view;
mod window;

pub use robust_slam::{Map, MapConfig};

use nalgebra::{Point3, Vector2};

use crate::budget::{BATCH_VIEWS, MAX_LANDMARKS, MAX_TRACKS};
use crate::space::{Micros, Pose};
use crate::track::{TrackId, Travel};

/// Where a track was seen in one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The track seen.
    pub track: TrackId,
    /// Where, in full-size pixels of the distorted image.
    pub pixel: Vector2<f32>,
}

/// A frame that the map keeps: enough motion since the last one, or a key frame.
#[derive(Clone, Debug, Default)]
pub struct View {
    /// Capture stamp.
    pub stamp: Micros,
    /// Pose as tracked, before the map has refined it.
    pub world_from_camera: Pose,
    /// Wheel travel at the stamp; none without encoders or when they are silent.
    pub travel: Option<Travel>,
    /// What was seen, ordered by track; at most one observation a track.
    pub observations: heapless::Vec<Observation, MAX_TRACKS>,
}

/// The views since the last key frame, oldest first.
pub type ViewBatch = heapless::Vec<View, BATCH_VIEWS>;

/// A point of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    /// The track it was triangulated from.
    pub track: TrackId,
    /// Position in world space.
    pub point_in_world: Point3<f64>,
    /// Standard deviation along the ray of its latest view.
    pub depth_sigma_m: f32,
    /// Views of the window that see it.
    pub views: u8,
}

/// What the tracker learns from the map at a key frame.
#[derive(Clone, Debug, Default)]
pub struct MapUpdate {
    /// Stamp of the newest view in the map; none while the map is empty, and there is nothing to learn.
    pub stamp: Option<Micros>,
    /// Pose of that view as the tracker had it.
    pub world_from_camera_tracked: Pose,
    /// Pose of that view as the map has it now.
    pub world_from_camera: Pose,
    /// Lengths of the map now over lengths as tracked; 1 with wheels, near 1 without.
    pub rescale: f64,
    /// Landmarks whose tracks may still be alive, ordered by track.
    pub landmarks: heapless::Vec<(TrackId, Point3<f64>), MAX_LANDMARKS>,
}

impl MapUpdate {
    /// Takes over another update, in place.
    pub fn copy_from(&mut self, other: &Self) {
        self.stamp = other.stamp;
        self.world_from_camera_tracked = other.world_from_camera_tracked;
        self.world_from_camera = other.world_from_camera;
        self.rescale = other.rescale;
        self.landmarks.clear();
        // Same capacity on both sides.
        let _ = self.landmarks.extend_from_slice(&other.landmarks);
    }

    /// A tracked pose, moved as the map moved its newest view; `world_from_view` is that view's pose in the tracker's present
    /// chain, which earlier updates have corrected since the view was taken.
    #[must_use]
    pub fn moved(&self, world_from_view: &Pose, world_from_camera: &Pose) -> Pose {
        let mut since = world_from_view.inv_mul(world_from_camera);
        since.translation.vector *= self.rescale;
        self.world_from_camera * since
    }
}
