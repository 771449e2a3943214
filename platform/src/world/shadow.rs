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

use super::ground::Footprint;
use super::noise::smoothstep;
use super::road::{BEHIND_M, BEYOND_M, Road};
use super::scene::Scene;
use super::shape::{Material, Part, Seen};
use super::texture::{Textures, level};

const CELL_M: f32 = 0.25;
const COLUMNS: usize = 128;
const REACH_M: f32 = 0.5 * COLUMNS as f32 * CELL_M;

/// Hidden share of the sun, solid things first, then foliage, 0 to 255.
#[derive(Clone, Debug)]
pub(super) struct Shadow {
    cells: Vec<[u8; 2]>,
    rows: usize,
}

impl Shadow {
    /// Casts every part of `scene`; empty where no sun shines.
    pub(super) fn new(scene: &Scene, road: &Road, sun: [f32; 3], length_m: f64, textures: &Textures) -> Self {
        let rows = ((BEHIND_M + length_m + BEYOND_M) as f32 / CELL_M) as usize;
        let mut shadow = Self {
            cells: vec![[0; 2]; rows * COLUMNS],
            rows,
        };
        for object in &scene.objects {
            for part in &scene.parts[object.first..object.first + object.count] {
                shadow.cast(part, object.s, road, sun, textures);
            }
        }
        shadow
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

    /// Share of sunlight at a place on the ground.
    pub(super) fn sunlight(&self, textures: &Textures, s: f32, d: f32, foot: Footprint) -> f32 {
        let x = (d + REACH_M) * (1.0 / CELL_M) - 0.5;
        let y = (s + BEHIND_M as f32) * (1.0 / CELL_M) - 0.5;
        if x < 0.0 || y < 0.0 {
            return 1.0;
        }
        let (i, j) = (x as usize, y as usize);
        if i + 1 >= COLUMNS || j + 1 >= self.rows {
            return 1.0;
        }
        let (fx, fy) = (x - i as f32, y - j as f32);
        let at = j * COLUMNS + i;
        let corners = [
            self.cells[at],
            self.cells[at + 1],
            self.cells[at + COLUMNS],
            self.cells[at + COLUMNS + 1],
        ];
        if corners == [[0; 2]; 4] {
            return 1.0;
        }
        let hidden = |k: usize| {
            let c = corners.map(|corner| f32::from(corner[k]) * (1.0 / 255.0));
            let (top, bottom) = (c[0] + (c[1] - c[0]) * fx, c[2] + (c[3] - c[2]) * fx);
            top + (bottom - top) * fy
        };
        let solid = smoothstep(0.2, 0.8, hidden(0));
        let leafy = hidden(1);
        if leafy <= 0.0 {
            return 1.0 - solid;
        }
        let leaves = textures.leaves.sample(
            s * 75.0,
            d * 75.0,
            level(foot.along_m * 75.0),
            level(foot.across_m * 75.0),
        );
        (1.0 - solid) * (1.0 - smoothstep(0.35, 0.7, leafy * 0.95 + 0.65 * leaves))
    }
}
