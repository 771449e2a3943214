//! Shadows of everything that stands, baked onto the road once.
//!
//! A raster in road coordinates holds how much of the sun solid things and foliage hide; leaves then break the edge up
//! with their texture. In: parts and the sun. Out: the share of sunlight at a place. Memory: 2 bytes a cell of [`CELL_M`].
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "cell indices are clamped to the raster"
)]

use super::ground::{Footprint, Places};
use super::lanes::{LANES, Lanes, lanes, range};
use super::noise::smoothstep;
use super::road::{BEHIND_M, BEYOND_M, Road};
use super::scene::Scene;
use super::shape::{Material, Part, Seen};
use super::texture::Textures;

const CELL_M: f32 = 0.25;
const COLUMNS: usize = 128;
const REACH_M: f32 = 0.5 * COLUMNS as f32 * CELL_M;

/// Hidden share of the sun, solid things first, then foliage, 0 to 255.
#[derive(Clone, Debug)]
pub(super) struct Shadow {
    cells: Vec<[u8; 2]>,
    rows: usize,
    /// Of each block of cells, with a margin: whether anything is hidden there.
    dark: Vec<bool>,
}

/// Cells along a side of a block.
const BLOCK: usize = 8;
const BLOCK_COLUMNS: usize = COLUMNS / BLOCK;

impl Shadow {
    /// Casts every part of `scene`; empty where no sun shines.
    pub(super) fn new(scene: &Scene, road: &Road, sun: [f32; 3], length_m: f64, textures: &Textures) -> Self {
        let rows = ((BEHIND_M + length_m + BEYOND_M) as f32 / CELL_M) as usize;
        let mut shadow = Self {
            cells: vec![[0; 2]; rows * COLUMNS],
            rows,
            dark: vec![false; (rows / BLOCK + 1) * BLOCK_COLUMNS],
        };
        for object in &scene.objects {
            for part in &scene.parts[object.first..object.first + object.count] {
                shadow.cast(part, object.s, road, sun, textures);
            }
        }
        shadow.mark();
        shadow
    }

    /// Marks the blocks from which a hidden cell, or the neighbour of one, may be read.
    fn mark(&mut self) {
        for (i, _) in self.cells.iter().enumerate().filter(|(_, cell)| **cell != [0; 2]) {
            let (row, column) = (i / COLUMNS, i % COLUMNS);
            for row in [row.saturating_sub(2), (row + 2).min(self.rows - 1)] {
                for column in [column.saturating_sub(2), (column + 2).min(COLUMNS - 1)] {
                    self.dark[row / BLOCK * BLOCK_COLUMNS + column / BLOCK] = true;
                }
            }
        }
    }

    /// Whether nothing is hidden anywhere between the least and greatest coordinates of some places.
    fn open(&self, at: &Places) -> bool {
        const SIDE_M: f32 = BLOCK as f32 * CELL_M;
        let ((s0, s1), (d0, d1)) = (range(&at.s), range(&at.d));
        let last = (self.rows / BLOCK) as f32;
        let row = |s: f32| ((s + BEHIND_M as f32) * (1.0 / SIDE_M)).clamp(0.0, last) as i32 as usize;
        let column =
            |d: f32| ((d + REACH_M) * (1.0 / SIDE_M)).clamp(0.0, BLOCK_COLUMNS as f32 - 1.0) as i32 as usize;
        let (first, end) = (column(d0), column(d1));
        (row(s0)..=row(s1)).all(|row| {
            let blocks = &self.dark[row * BLOCK_COLUMNS..(row + 1) * BLOCK_COLUMNS];
            !blocks[first.min(end)..=end].contains(&true)
        })
    }

    fn cast(&mut self, part: &Part, s: f32, road: &Road, sun: [f32; 3], textures: &Textures) {
        let (_, _, heading) = road.at(f64::from(s));
        let (sin, cos) = (heading.sin() as f32, heading.cos() as f32);
        let top = part.base[2] + part.top();
        let (dx, dy) = (-sun[0] / sun[2] * top, -sun[1] / sun[2] * top);
        let shift = [dx * cos + dy * sin, dy * cos - dx * sin];
        let (cs, cd) = road.locate(f64::from(part.base[0]), f64::from(part.base[1]));
        let [a, b] = part.half_extent();
        let reach = a.hypot(b) + 0.5;
        let bound =
            |centre: f32, shift: f32| (centre - reach + shift.min(0.0), centre + reach + shift.max(0.0));
        let (s0, s1) = bound(cs as f32, shift[0]);
        let (d0, d1) = bound(cd as f32, shift[1]);
        let row = |s: f32| ((s + BEHIND_M as f32) / CELL_M).clamp(0.0, self.rows as f32) as usize;
        let column = |d: f32| ((d + REACH_M) / CELL_M).clamp(0.0, COLUMNS as f32) as usize;
        let (rows, columns) = (row(s0)..row(s1 + CELL_M), column(d0)..column(d1 + CELL_M));
        let channel = usize::from(part.material == Material::Foliage);
        for row in rows {
            let s = (row as f32 + 0.5) * CELL_M - BEHIND_M as f32;
            let (x, y, heading) = road.at(f64::from(s));
            let (sin, cos) = (heading.sin() as f32, heading.cos() as f32);
            for column in columns.clone() {
                let d = (column as f32 + 0.5) * CELL_M - REACH_M;
                let origin = [x as f32 - d * sin, y as f32 + d * cos, 0.0];
                let cell = &mut self.cells[row * COLUMNS + column][channel];
                if *cell < 255
                    && Seen::new(part, origin)
                        .distance(sun, f32::MAX, textures)
                        .is_some()
                {
                    *cell = 255;
                }
            }
        }
    }

    /// Share of sunlight at places on the ground.
    pub(super) fn sunlight(&self, textures: &Textures, at: &Places, foot: Footprint) -> Lanes {
        if self.open(at) {
            return [1.0; LANES];
        }
        let (mut solid, mut leafy, mut any) = ([0.0; LANES], [0.0; LANES], false);
        for i in 0..LANES {
            if let Some([s, l]) = self.hidden(at.s[i], at.d[i]) {
                (solid[i], leafy[i]) = (s, l);
                any |= l > 0.0;
            }
        }
        let open = lanes(|i| 1.0 - smoothstep(0.2, 0.8, solid[i]));
        if !any {
            return open;
        }
        let leaves = at.tones(&textures.leaves, [75.0, 75.0], 0.0, foot);
        lanes(|i| {
            let shade = smoothstep(0.35, 0.7, leafy[i] * 0.95 + 0.65 * leaves[i]);
            open[i] * if leafy[i] > 0.0 { 1.0 - shade } else { 1.0 }
        })
    }

    /// What solid things and foliage hide of the sun; none in the open.
    #[inline]
    fn hidden(&self, s: f32, d: f32) -> Option<[f32; 2]> {
        let x = (d + REACH_M) * (1.0 / CELL_M) - 0.5;
        let y = (s + BEHIND_M as f32) * (1.0 / CELL_M) - 0.5;
        if x < 0.0 || y < 0.0 {
            return None;
        }
        let (i, j) = (x as i32 as usize, y as i32 as usize);
        if i + 1 >= COLUMNS || j + 1 >= self.rows {
            return None;
        }
        let (fx, fy) = (x - i as f32, y - j as f32);
        let at = j * COLUMNS + i;
        let (top, bottom) = (
            &self.cells[at..at + 2],
            &self.cells[at + COLUMNS..at + COLUMNS + 2],
        );
        let (a, b, c, e) = (top[0], top[1], bottom[0], bottom[1]);
        if [a, b, c, e] == [[0; 2]; 4] {
            return None;
        }
        let blend = |k: usize| {
            let [a, b, c, e] = [a[k], b[k], c[k], e[k]].map(|x| f32::from(x) * (1.0 / 255.0));
            let (top, bottom) = (a + (b - a) * fx, c + (e - c) * fx);
            top + (bottom - top) * fy
        };
        Some([blend(0), blend(1)])
    }
}
