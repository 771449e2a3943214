//! Stage 7, grid: road pixels to metres, fused over time.
//!
//! In: labels, `P(road)` and surfaces at the CRF resolution, the road plane in camera space, the vehicle's pose.
//! Out: [`Grid`] around the vehicle and the free distance in each bearing sector.
//! Invariant: a cell is free only where road was seen in it, not too long ago; everything else is unknown or occupied.
//! Cost: one projection a cell, a walk over the cells in the view, a few hundred steps a sector.
//! Source: "For each pixel detected as the road by our method, we shoot back a 3D ray and compute its intersection with
//! the 3D road plane"; here each cell looks up its pixel instead, so that none is missed far away.

mod boundary;
mod fusion;
mod stage;
mod view;

pub use boundary::Boundary;
pub use stage::GridStage;

use alloc::boxed::Box;
use alloc::vec;

use crate::budget::MAX_CELLS;

/// Why a cell is what it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Reason {
    /// Never seen, or too long ago.
    #[default]
    Unseen = 0,
    /// Road seen on the plane.
    Plane = 1,
    /// The foot of a box of landmarks.
    Box = 2,
    /// On the plane, but labelled as not road.
    Network = 3,
    /// Known from earlier key frames only.
    Previous = 4,
}

/// Size and memory of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct GridConfig {
    /// Edge of a cell.
    pub cell_m: f32,
    /// Reach ahead of the vehicle's origin.
    pub ahead_m: f32,
    /// Reach to either side.
    pub side_m: f32,
    /// Evidence of one confident road cell, log-odds.
    pub free_evidence: f32,
    /// Evidence of one confident not-road cell, log-odds.
    pub occupied_evidence: f32,
    /// Log-odds never leave plus or minus this.
    pub limit: f32,
    /// Log-odds nearer to zero than this are unknown.
    pub unknown_below: f32,
    /// Half-life of what was free and is out of sight now; what is hidden is unknown at once.
    pub free_half_life_s: f32,
    /// Half-life of what was occupied and is out of sight now.
    pub occupied_half_life_s: f32,
    /// Half-life of cells under the lower image edge, where the car itself is about to drive.
    pub covered_half_life_s: f32,
    /// Older cells are unknown whatever they were.
    pub max_age_s: f32,
    /// Not-road farther than this behind the road's edge may be hidden by what stands there, and is unknown.
    pub flat_m: f32,
    /// Height over the road of a vehicle's lower edge in the picture: one sees under it onto the road that it stands on.
    pub clearance_m: f32,
    /// Distance covered by one image row at which evidence counts half.
    pub row_span_m: f32,
}

impl Default for GridConfig {
    fn default() -> Self {
        Self {
            cell_m: 0.2,
            ahead_m: 40.0,
            side_m: 12.0,
            free_evidence: 2.0,
            occupied_evidence: 2.5,
            limit: 3.0,
            unknown_below: 0.3,
            free_half_life_s: 0.7,
            occupied_half_life_s: 2.0,
            covered_half_life_s: 3.0,
            max_age_s: 5.0,
            flat_m: 4.0,
            clearance_m: 0.15,
            row_span_m: 2.5,
        }
    }
}

impl GridConfig {
    /// Rows and columns of the grid; its cells grow where they would be more than [`MAX_CELLS`].
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "bounded by the clamp"
    )]
    pub fn size(&self) -> (usize, usize, f32) {
        let span = |m: f32, cell_m: f32| ((m / cell_m + 0.5) as usize).clamp(1, MAX_CELLS);
        let mut cell_m = if self.cell_m > 0.01 { self.cell_m } else { 0.2 };
        while span(self.ahead_m, cell_m).saturating_mul(span(2.0 * self.side_m, cell_m)) > MAX_CELLS {
            cell_m *= 1.25;
        }
        (
            span(self.ahead_m, cell_m),
            span(2.0 * self.side_m, cell_m),
            cell_m,
        )
    }
}

/// Occupancy around the vehicle, `[rows, columns]`: row 0 begins at the vehicle's origin and rows go ahead, column 0 is the
/// right edge and columns go left.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Cells ahead.
    pub rows: usize,
    /// Cells from right to left.
    pub columns: usize,
    /// Edge of a cell.
    pub cell_m: f32,
    /// -1 unknown, 0 free to 100 occupied (as in `nav_msgs/OccupancyGrid`).
    pub occupancy: Box<[i8]>,
    /// [`Reason`] of each cell.
    pub reason: Box<[u8]>,
    /// Time since a cell was last seen, in 0.1 s, at most 255.
    pub age: Box<[u8]>,
}

impl Grid {
    /// Cells of at most this occupancy are free.
    pub const FREE_AT_MOST: i8 = 35;

    /// A grid that knows nothing.
    #[must_use]
    pub fn new(rows: usize, columns: usize, cell_m: f32) -> Self {
        Self {
            rows,
            columns,
            cell_m,
            occupancy: vec![-1; rows * columns].into_boxed_slice(),
            reason: vec![0; rows * columns].into_boxed_slice(),
            age: vec![u8::MAX; rows * columns].into_boxed_slice(),
        }
    }

    /// A grid of the configured size that knows nothing.
    #[must_use]
    pub fn sized(config: &GridConfig) -> Self {
        let (rows, columns, cell_m) = config.size();
        Self::new(rows, columns, cell_m)
    }

    /// Forgets every cell.
    pub fn clear(&mut self) {
        self.occupancy.fill(-1);
        self.reason.fill(0);
        self.age.fill(u8::MAX);
    }

    /// Takes the cells of a grid of the same size.
    ///
    /// # Panics
    /// Where the sizes differ.
    pub fn copy_from(&mut self, other: &Self) {
        self.cell_m = other.cell_m;
        self.occupancy.copy_from_slice(&other.occupancy);
        self.reason.copy_from_slice(&other.reason);
        self.age.copy_from_slice(&other.age);
    }

    /// Whether a cell may be driven on.
    #[must_use]
    pub fn is_free(&self, row: usize, column: usize) -> bool {
        (0..=Self::FREE_AT_MOST).contains(&self.occupancy[row * self.columns + column])
    }

    /// The cell at vehicle coordinates; none outside.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked against the grid"
    )]
    pub fn cell_at(&self, x_m: f32, y_m: f32) -> Option<(usize, usize)> {
        let row = (x_m / self.cell_m).floor();
        let column = (y_m / self.cell_m + 0.5 * self.columns as f32).floor();
        let inside = row >= 0.0 && column >= 0.0 && row < self.rows as f32 && column < self.columns as f32;
        inside.then_some((row as usize, column as usize))
    }

    /// Vehicle coordinates of a cell's centre.
    #[must_use]
    pub fn centre(&self, row: usize, column: usize) -> (f32, f32) {
        (
            (row as f32 + 0.5) * self.cell_m,
            (column as f32 + 0.5 - 0.5 * self.columns as f32) * self.cell_m,
        )
    }
}

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

#[cfg(test)]
mod tests;
