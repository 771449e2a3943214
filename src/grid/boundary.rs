//! Free distance in each bearing sector.
//!
//! In: the fused grid. Out: metres from the vehicle's origin (on the ground under the rear axle) to the first cell that is
//! not free. Invariant: never farther than the nearest cell that is not free on any of the sector's rays; zero where none
//! is free. Cost: three rays a sector, each at most the grid's diagonal in half cells.

use super::Grid;
use crate::budget::SECTORS;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

/// Free distance by bearing, sector 0 at the right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Boundary {
    /// Bearing of sector 0's right edge, positive left of the vehicle's x axis.
    pub first_rad: f32,
    /// Width of each sector.
    pub sector_rad: f32,
    /// Free distance from the vehicle's origin, metres.
    pub free_m: [f32; SECTORS],
}

impl Boundary {
    /// Nothing is free between the two bearings.
    #[must_use]
    pub fn new(right_rad: f32, left_rad: f32) -> Self {
        Self {
            first_rad: right_rad,
            sector_rad: (left_rad - right_rad) / SECTORS as f32,
            free_m: [0.0; SECTORS],
        }
    }

    /// Reads the grid. Cells nearer than `blind_m` that are unknown are passed over: no camera sees under its own car.
    pub(super) fn read(&mut self, grid: &Grid, blind_m: f32) {
        for sector in 0..SECTORS {
            let mut free_m = f32::INFINITY;
            for ray in 0..3 {
                let bearing = self.first_rad + self.sector_rad * (sector as f32 + 0.1 + 0.4 * ray as f32);
                free_m = free_m.min(free_along(grid, bearing, blind_m));
            }
            self.free_m[sector] = free_m;
        }
    }
}

fn free_along(grid: &Grid, bearing_rad: f32, blind_m: f32) -> f32 {
    let (sin, cos) = bearing_rad.sin_cos();
    let step_m = 0.5 * grid.cell_m;
    let mut free_m = 0.0;
    let mut range_m = step_m;
    while let Some((row, column)) = grid.cell_at(cos * range_m, sin * range_m) {
        let occupancy = grid.occupancy[row * grid.columns + column];
        if (0..=Grid::FREE_AT_MOST).contains(&occupancy) {
            free_m = range_m;
        } else if occupancy >= 0 || range_m > blind_m {
            break;
        }
        range_m += step_m;
    }
    free_m
}
