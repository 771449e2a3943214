//! Every capacity, cap and time slice, in one place to review.
//!
//! Capacities bound memory, caps bound work, slices bound time. What happens when one is reached is written at its use
//! and counted there.

use crate::stage::Stage;

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

/// One line of the deadline's table.
#[derive(Clone, Copy, Debug)]
pub struct Slice {
    /// Whose it is.
    pub stage: Stage,
    /// Its length.
    pub micros: u64,
    /// What happens when it runs out.
    pub when_out: &'static str,
}

const fn slice(stage: Stage, micros: u64, when_out: &'static str) -> Slice {
    Slice {
        stage,
        micros,
        when_out,
    }
}

/// Time slices of a key frame, in the order they are spent; each ends where those before it and itself are spent, counted
/// from the capture. About ten times what the stages take undisturbed on two cores, but for the network.
pub const SLICES: [Slice; Stage::ALL.len()] = [
    slice(Stage::Frame, 10_000, "the frame goes on; later stages have less"),
    slice(Stage::Track, 30_000, "the frame goes on; later stages have less"),
    slice(
        Stage::Map,
        50_000,
        "bundle adjustment stops; may it not start, the map is held",
    ),
    slice(
        Stage::Priors,
        30_000,
        "may it not start, plane and boxes are held",
    ),
    slice(
        Stage::Segmentation,
        50_000,
        "the network is stopped; its last answer, moved, stands in",
    ),
    slice(
        Stage::Crf,
        50_000,
        "the cut stops; may it not start, each pixel decides alone",
    ),
    slice(
        Stage::Grid,
        20_000,
        "may it not start, the key frame is left to the publisher",
    ),
    slice(Stage::Emit, 10_000, "the grid is late, and marked so"),
];

/// Time that stages may be late by and still start.
pub const RESERVE_MICROS: u64 = 150_000;

/// A fallback leaves this long before the deadline: longer than a scheduler that holds the process to half of a core, or
/// halts it, keeps the publisher waiting (periods of 100 ms are usual).
pub const GUARD_MICROS: u64 = 100_000;

const _: () = {
    let mut sum = RESERVE_MICROS + GUARD_MICROS;
    let mut index = 0;
    while index < SLICES.len() {
        assert!(
            SLICES[index].stage as usize == index,
            "slices stand in the order of the stages"
        );
        sum += SLICES[index].micros;
        index += 1;
    }
    assert!(
        sum == DEADLINE_MICROS,
        "slices, reserve and guard make up the deadline"
    );
};

/// An answer older than this is moved no further: what it called free has faded to unknown by then.
pub const STALE_MICROS: u64 = 2_500_000;

/// A task that stays in one stage this long hangs: the process ends, to be started anew by its supervisor.
pub const HANG_MICROS: u64 = 5_000_000;

/// Panics a drive survives by starting a part anew; one more, and the process ends.
pub const RESTARTS: u32 = 3;

/// Bundle-adjustment iterations a key frame, at most.
pub const BUNDLE_REFINEMENTS: usize = 10;
/// Quanta of the cut a key frame, at most; reached only on instances that would miss the deadline.
pub const CUT_QUANTA: usize = 400;
/// Steps of a quantum: about half a millisecond.
pub const CUT_QUANTUM_STEPS: u32 = 20_000;

/// A patch of road that begins nearer than this and is cut off from the car's own is no road the car can reach.
pub const ISLAND_RANGE_M: f64 = 12.0;
