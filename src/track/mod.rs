//! Stage 2, track: keypoints from frame to frame, and the pose of each frame.
//!
//! In: luma pyramids and wheel travel. Out: a pose a frame and, where the map asks, a view of observations. Corners are
//! bucketed, followed by pyramidal Lucas-Kanade from a predicted place, and checked there and back; the pose is solved from
//! landmarks, epipolar geometry and the wheels together. Without a map it is visual odometry of metric scale.

mod corner_score;
mod corners;
mod keypoint;
mod klt;
mod motion;
mod pose;
mod predict;
mod rolling;
mod search;
mod tracker;
mod wheels;

#[cfg(test)]
mod tracker_tests;

pub use tracker::{FrameEstimate, TrackConfig, Tracker};
pub use wheels::{Travel, WheelConfig, WheelOdometer, WheelReading};

/// Identity of a keypoint track, never used twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrackId(pub u32);
