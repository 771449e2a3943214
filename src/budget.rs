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
/// Passes of k-means over the points above the road; its centres hardly move after six.
pub const CLUSTER_PASSES: usize = 8;
/// Re-weighted fits of the road plane.
pub const PLANE_PASSES: usize = 8;
/// Bins of the plane's Hough space: distance by angle.
pub const HOUGH_DISTANCES: usize = 64;
/// See [`HOUGH_DISTANCES`].
pub const HOUGH_ANGLES: usize = 41;

/// Bearing sectors of the free-distance boundary; eight CAN frames of four.
pub const SECTORS: usize = 32;
/// Cells a grid may have: 60 m by 40 m at 0.1 m.
pub const MAX_CELLS: usize = 240_000;

/// Classes a network may know.
pub const MAX_CLASSES: usize = 128;
/// Concentric spheres of the colour-line model.
pub const COLOUR_SLICES: usize = 32;
/// Network runs a key frame at most, side by side across the image.
pub const MAX_TILES: usize = 3;
/// Part of a tile's width that it shares with its neighbour; the joint is blended over it.
pub const TILE_OVERLAP: f32 = 0.2;
/// Source samples a resampled pixel takes along an axis: enough to average when shrinking 5 times.
pub const MAX_TAPS: usize = 10;

/// A grid for every key frame is out this long after its capture (section 1 of the promise).
pub const DEADLINE_MICROS: u64 = 500_000;

/// Bundle-adjustment iterations a key frame, at most.
pub const BUNDLE_REFINEMENTS: usize = 10;
/// Quanta of the cut a key frame, at most; reached only on instances that would miss the deadline.
pub const CUT_QUANTA: usize = 400;
/// Steps of a quantum: about half a millisecond.
pub const CUT_QUANTUM_STEPS: u32 = 20_000;

/// A patch of road that begins nearer than this and is cut off from the car's own is no road the car can reach.
pub const ISLAND_RANGE_M: f64 = 12.0;
