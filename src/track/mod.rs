//! Stage 2, track: keypoints from frame to frame, and the pose of each frame.

mod wheels;

pub use wheels::{Travel, WheelConfig, WheelOdometer, WheelReading};

/// Identity of a keypoint track, never used twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrackId(pub u32);
