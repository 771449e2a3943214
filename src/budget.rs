//! Every capacity, cap and time slice, in one place to review.
//!
//! Capacities bound memory, caps bound work, slices bound time. What happens when one is reached is written at its use
//! and counted there.

/// Bytes of a pixel row are never padded: a frame is at most this wide and high.
pub const MAX_WIDTH_PX: usize = 1920;
/// See [`MAX_WIDTH_PX`].
pub const MAX_HEIGHT_PX: usize = 1280;

/// Keypoint tracks alive at once.
pub const MAX_TRACKS: usize = 800;
/// Wheel readings kept for interpolation: 2 s at 100 Hz.
pub const WHEEL_HISTORY: usize = 200;

/// Views handed to the map at one key frame.
pub const BATCH_VIEWS: usize = 6;
/// Landmarks in the map.
pub const MAX_LANDMARKS: usize = 3000;

// Map.
/// Views in the bundle-adjustment window: two seconds at city speed, three key frames.
pub const WINDOW_VIEWS: usize = 16;
/// Tracks of the window, landmarks or not yet.
pub const MAX_POINTS: usize = 6000;
/// Landmarks that one bundle adjustment moves; the best seen first.
pub const BUNDLE_LANDMARKS: usize = 800;
/// Earlier views that a new one is paired with.
pub const VIEW_GRAPH_SPAN: usize = 3;
/// Five-point samples a pair; the tracked motion makes a handful enough.
pub const RANSAC_SAMPLES: usize = 64;
/// Bundle-adjustment iterations inside an insertion.
pub const BASE_ITERATIONS: usize = 2;
/// Bundle-adjustment iterations a batch, base and refinement together.
pub const MAX_ITERATIONS: usize = 12;

/// Obstacle boxes, the k of k-means.
pub const MAX_BOXES: usize = 48;

/// Classes a network may know.
pub const MAX_CLASSES: usize = 32;
/// Concentric spheres of the colour-line model.
pub const COLOUR_SLICES: usize = 32;

/// A grid for every key frame is out this long after its capture (section 1 of the promise).
pub const DEADLINE_MICROS: u64 = 500_000;
