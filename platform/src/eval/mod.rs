//! Comparison with truth: masks, trajectories and grids.
//!
//! Pure functions over decoded values in [`masks`], [`trajectory`] and [`grid`]; what they read from disk they read
//! through `*_in` and `read*` functions, whose faults are [`crate::bad_input::BadInput`]. [`Truth`] is what a report says,
//! [`page`] shows it in pictures, and [`fleet`] adds up many drives.

pub mod fleet;
pub mod grid;
pub mod masks;
pub mod npy;
pub mod page;
pub mod reference;
pub mod trajectory;

use serde::Serialize;

/// Comparison of a run with the truth; a key is null where there was no truth of its kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Truth {
    /// Intersection over union of free cells among the cells that the truth has seen, 0 to 30 m ahead.
    pub free_space_iou: Option<f64>,
    /// Road pixels.
    pub road: Option<RoadScore>,
    /// Root mean square position error after the best rigid motion.
    pub ate_se3_m: Option<f64>,
    /// The same after the best rigid motion and scale.
    pub ate_sim3_m: Option<f64>,
    /// `|s - 1|` of that scale.
    pub scale_error: Option<f64>,
    /// Length of the true path.
    pub distance_m: Option<f64>,
    /// Length of the estimated path.
    pub estimated_distance_m: Option<f64>,
    /// KITTI's translation error over segments of 100 to 800 m, in percent.
    pub segment_translation_percent: Option<f64>,
    /// KITTI's rotation error over the same segments.
    pub segment_rotation_deg_per_m: Option<f64>,
}

/// Road pixels against truth, pooled over all frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RoadScore {
    /// Share of road among what was called road.
    pub precision: f64,
    /// Share of what was called road among road.
    pub recall: f64,
    /// Harmonic mean of both.
    pub f: f64,
    /// Frames compared.
    pub frames: usize,
}

impl Truth {
    /// Adds what a trajectory comparison found.
    #[must_use]
    pub fn with_trajectory(mut self, score: &trajectory::TrajectoryScore) -> Self {
        self.ate_se3_m = Some(score.ate_se3_m);
        self.ate_sim3_m = score.ate_sim3_m;
        self.scale_error = score.scale.map(|scale| (scale - 1.0).abs());
        self.distance_m = Some(score.distance_m);
        self.estimated_distance_m = Some(score.estimated_distance_m);
        self.segment_translation_percent = score.segments.map(|s| s.translation_percent);
        self.segment_rotation_deg_per_m = score.segments.map(|s| s.rotation_deg_per_m);
        self
    }

    /// Adds what a mask comparison found.
    #[must_use]
    pub fn with_road(mut self, count: &masks::PixelCount, frames: usize) -> Self {
        self.road = Some(RoadScore {
            precision: count.precision(),
            recall: count.recall(),
            f: count.f(),
            frames,
        });
        self
    }

    /// Adds what a grid comparison found.
    #[must_use]
    pub fn with_grid(mut self, count: &grid::CellCount) -> Self {
        self.free_space_iou = Some(count.iou());
        self
    }
}

#[cfg(test)]
mod tests;
