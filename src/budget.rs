//! Every capacity, cap and time slice, in one place to review.
//!
//! Capacities bound memory, caps bound work, slices bound time. What happens when one is reached is written at its use
//! and counted there.

/// Bytes of a pixel row are never padded: a frame is at most this wide and high.
pub const MAX_WIDTH_PX: usize = 1920;
/// See [`MAX_WIDTH_PX`].
pub const MAX_HEIGHT_PX: usize = 1280;

/// Levels of the luma pyramid: motion up to about 60 px is 8 px at the coarsest.
pub const PYRAMID_LEVELS: usize = 4;

/// Keypoint tracks alive at once.
pub const MAX_TRACKS: usize = 800;
/// Wheel readings kept for interpolation: 2 s at 100 Hz.
pub const WHEEL_HISTORY: usize = 200;
/// Cells the image is divided into for new corners: two tracks each.
pub const CORNER_CELLS: usize = 400;
/// Widest corner cell; bounds the buffers of the corner score. 1920 x 1280 over 300 cells is 91 px.
pub const CORNER_CELL_PX: usize = 96;
/// Tracking iterations on one pyramid level; three to five are usual.
pub const KLT_ITERATIONS: usize = 10;
/// Gauss-Newton steps of a frame's pose: six while the weights narrow, eight to converge.
pub const POSE_ITERATIONS: usize = 14;
/// Tracked poses kept to be corrected by a late map: 2 s at 30 frames a second.
pub const RECENT_POSES: usize = 64;

/// Views handed to the map at one key frame.
pub const BATCH_VIEWS: usize = 6;
/// Views in the bundle-adjustment window.
pub const WINDOW_VIEWS: usize = 12;
/// Landmarks in the map.
pub const MAX_LANDMARKS: usize = 3000;

/// Obstacle boxes, the k of k-means.
pub const MAX_BOXES: usize = 48;

/// Classes a network may know.
pub const MAX_CLASSES: usize = 32;
/// Concentric spheres of the colour-line model.
pub const COLOUR_SLICES: usize = 32;

/// A grid for every key frame is out this long after its capture (section 1 of the promise).
pub const DEADLINE_MICROS: u64 = 500_000;
