//! Log-odds of the cells over time.
//!
//! In: a key frame's evidence, the motion since the last one. Out: fused log-odds, reasons and ages.
//! Invariant: an unseen cell's log-odds only ever move towards zero; a hidden cell is not free. Cost: one nearest look-up a cell, in row order.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "occupancy and age are clamped before the cast"
)]

use alloc::boxed::Box;
use alloc::vec;

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::view::Sight;
use super::{Grid, GridConfig, Reason};

/// A cell's memory.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Memory {
    log_odds: f32,
    age_s: f32,
    known: bool,
}

const UNSEEN: Memory = Memory {
    log_odds: 0.0,
    age_s: 25.5,
    known: false,
};

/// Motion in the road plane: where a point of the vehicle now was in the vehicle of the last key frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Motion {
    pub(super) ahead_m: f32,
    pub(super) left_m: f32,
    pub(super) yaw_rad: f32,
    pub(super) seconds: f32,
}

/// Double-buffered memory of the cells.
#[derive(Clone, Debug)]
pub(super) struct Fusion {
    config: GridConfig,
    cells: Box<[Memory]>,
    moved: Box<[Memory]>,
}

impl Fusion {
    pub(super) fn new(config: GridConfig, cells: usize) -> Self {
        Self {
            config,
            cells: vec![UNSEEN; cells].into_boxed_slice(),
            moved: vec![UNSEEN; cells].into_boxed_slice(),
        }
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.cells.fill(UNSEEN);
    }

    /// Takes the memory back from a grid that was published.
    pub(super) fn adopt(&mut self, grid: &Grid) {
        for (index, cell) in self.cells.iter_mut().enumerate() {
            let occupancy = grid.occupancy[index];
            *cell = if occupancy < 0 {
                UNSEEN
            } else {
                let share = (f32::from(occupancy) / 100.0).clamp(0.01, 0.99);
                Memory {
                    log_odds: (share / (1.0 - share)).ln(),
                    age_s: f32::from(grid.age[index]) * 0.1,
                    known: true,
                }
            };
        }
    }

    /// Moves the memory into the vehicle as it stands now.
    pub(super) fn shift(&mut self, motion: &Motion, grid: &Grid) {
        let (sin, cos) = motion.yaw_rad.sin_cos();
        for row in 0..grid.rows {
            for column in 0..grid.columns {
                let (x, y) = grid.centre(row, column);
                let was_x = cos * x - sin * y + motion.ahead_m;
                let was_y = sin * x + cos * y + motion.left_m;
                self.moved[row * grid.columns + column] = grid
                    .cell_at(was_x, was_y)
                    .map_or(UNSEEN, |(r, c)| self.cells[r * grid.columns + c]);
            }
        }
        core::mem::swap(&mut self.cells, &mut self.moved);
    }

    /// Ages all cells and adds what is seen now; `sight` none where nothing was seen at all.
    pub(super) fn fuse(&mut self, seconds: f32, view: Option<(&[f32], &[Sight])>, grid: &mut Grid) {
        let c = self.config;
        let half = |half_life_s: f32| (-seconds / half_life_s.max(1e-3) * core::f32::consts::LN_2).exp();
        let (free, occupied) = (half(c.free_half_life_s), half(c.occupied_half_life_s));
        let covered = half(c.covered_half_life_s);
        for (index, cell) in self.cells.iter_mut().enumerate() {
            let (evidence, sight) = view.map_or((0.0, Sight::Outside), |(e, s)| (e[index], s[index]));
            cell.age_s += seconds;
            // What the car covers cannot change unseen; what is out of sight can. Hidden is unknown, never free.
            cell.log_odds *= match sight {
                Sight::Covered => covered,
                Sight::Hidden if cell.log_odds < 0.0 => 0.0,
                _ if cell.log_odds < 0.0 => free,
                _ => occupied,
            };
            let mut reason = Reason::Previous;
            if let Sight::Seen(seen) = sight {
                // What contradicts the past is news, an obstacle in a free cell as well as road where a car was: it must not be
                // outvoted.
                if evidence * cell.log_odds < 0.0 {
                    cell.log_odds = 0.0;
                }
                cell.log_odds = (cell.log_odds + evidence).clamp(-c.limit, c.limit);
                cell.age_s = 0.0;
                cell.known = true;
                reason = seen;
            }
            if cell.known && (cell.age_s > c.max_age_s || !cell.log_odds.is_finite()) {
                *cell = UNSEEN;
            }
            let unknown = !cell.known || cell.log_odds.abs() < c.unknown_below;
            grid.occupancy[index] = if unknown { -1 } else { percent(cell.log_odds) };
            grid.reason[index] = if unknown { Reason::Unseen } else { reason } as u8;
            grid.age[index] = (cell.age_s * 10.0).clamp(0.0, 255.0) as u8;
        }
    }
}

fn percent(log_odds: f32) -> i8 {
    (100.0 / (1.0 + (-log_odds).exp())).round().clamp(0.0, 100.0) as i8
}
