//! Tiles of surface texture, filtered for every footprint.
//!
//! A tile is periodic and kept as a rip map: every power of two of shrinking along each axis on its own, so that a road
//! seen at a grazing angle is averaged along the road and stays sharp across it, and motion blur is a longer footprint.
//! In: texel coordinates and the footprint in texels. Out: a deviation in `[-1, 1]` from the tile's mean tone.
//! Cost: two loads a sample, for every texel is kept with its right neighbour; 2 MiB a tile. Source: rip maps after Larson
//! and Shah (1990).
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "texel arithmetic: coordinates are bounded by the tile"
)]

use super::lanes::{LANES, Lanes, lanes};
use super::noise::{floor, hash, smoothstep, unit};

/// Texels a side at the finest level.
pub(super) const SIZE: usize = 512;
const LEVELS: usize = 9;

/// One periodic texture at all footprints.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    /// Of each texel: itself in the low byte, its right neighbour in the high one.
    pairs: Box<[u16]>,
    offsets: [[u32; LEVELS]; LEVELS],
}

/// A tile shrunk to one footprint.
#[derive(Clone, Copy, Debug)]
struct Plane<'a> {
    pairs: &'a [u16],
    shrink: [f32; 2],
    /// Binary logarithm of the width, then of the height.
    bits: [u32; 2],
}

impl Plane<'_> {
    /// Indices of the pairs above and below a place, and the place's share of the way to the next along both axes.
    #[inline(always)]
    fn locate(&self, u: f32, v: f32) -> ([u32; 2], f32, f32) {
        // Adding this leaves the whole part in the low bits, for magnitudes below 2^22.
        const WHOLE: f32 = 12_582_912.0;
        let (x, y) = (u * self.shrink[0] - 0.5, v * self.shrink[1] - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let column = (x0 + WHOLE).to_bits() & ((1 << self.bits[0]) - 1);
        let row = |below: u32| ((y0 + WHOLE).to_bits() + below) & ((1 << self.bits[1]) - 1);
        let at = [0, 1].map(|below| row(below) << self.bits[0] | column);
        (at, x - x0, y - y0)
    }

    /// The four texels around a place, from the lowest byte up: two above, two below.
    #[inline(always)]
    fn quad(&self, [above, below]: [u32; 2]) -> u32 {
        u32::from(self.pairs[above as usize]) | u32::from(self.pairs[below as usize]) << 16
    }
}

/// Bilinear mean of a quad's texels, as a deviation from the mean tone.
#[inline(always)]
fn blend(quad: u32, fx: f32, fy: f32) -> f32 {
    let texel = |shift: u32| (quad >> shift & 255) as i32 as f32;
    let top = texel(0) + (texel(8) - texel(0)) * fx;
    let bottom = texel(16) + (texel(24) - texel(16)) * fx;
    (top + (bottom - top) * fy - 128.0) * (1.0 / 127.0)
}

/// The level whose texels are about as long as `footprint` base texels.
pub(super) fn level(footprint: f32) -> usize {
    let exponent = ((footprint.max(0.5) * 1.15).to_bits() >> 23) as i32 - 127;
    exponent.clamp(0, LEVELS as i32 - 1) as usize
}

impl Tile {
    /// Evaluates `tone` (mean 0, about `[-1, 1]`) at every texel and shrinks it along both axes.
    fn new(tone: impl Fn(f32, f32) -> f32) -> Self {
        let mut offsets = [[0; LEVELS]; LEVELS];
        let mut total = 0;
        for (v, row) in offsets.iter_mut().enumerate() {
            for (u, offset) in row.iter_mut().enumerate() {
                *offset = total as u32;
                total += (SIZE >> u) * (SIZE >> v);
            }
        }
        let mut base: Vec<f32> = (0..SIZE * SIZE)
            .map(|i| tone((i % SIZE) as f32, (i / SIZE) as f32))
            .collect();
        let mean = base.iter().map(|&x| f64::from(x)).sum::<f64>() / base.len() as f64;
        for x in &mut base {
            *x -= mean as f32;
        }
        let mut pairs = vec![0_u16; total].into_boxed_slice();
        let mut rows = base;
        for v in 0..LEVELS {
            let mut columns = rows.clone();
            for u in 0..LEVELS {
                let start = offsets[v][u] as usize;
                let (width, height) = (SIZE >> u, SIZE >> v);
                let texels: Vec<u8> = columns
                    .iter()
                    .map(|x| (128.5 + 127.0 * x).clamp(0.0, 255.0) as u8)
                    .collect();
                for (i, pair) in pairs[start..start + width * height].iter_mut().enumerate() {
                    let (x, y) = (i % width, i / width);
                    *pair = u16::from_le_bytes([texels[i], texels[y * width + (x + 1) % width]]);
                }
                columns = columns.chunks_exact(2).map(|p| 0.5 * (p[0] + p[1])).collect();
            }
            let width = SIZE;
            rows = (0..rows.len() / (2 * width) * width)
                .map(|i| {
                    let (y, x) = (i / width, i % width);
                    0.5 * (rows[2 * y * width + x] + rows[(2 * y + 1) * width + x])
                })
                .collect();
        }
        Self { pairs, offsets }
    }

    #[inline]
    fn plane(&self, level_u: usize, level_v: usize) -> Plane<'_> {
        let shrink = |level: usize| f32::from_bits((127 - level as u32) << 23);
        let (level_u, level_v) = (level_u.min(LEVELS - 1), level_v.min(LEVELS - 1));
        let start = self.offsets[level_v][level_u] as usize;
        Plane {
            pairs: &self.pairs[start..start + ((SIZE >> level_u) * (SIZE >> level_v))],
            shrink: [shrink(level_u), shrink(level_v)],
            bits: [SIZE.ilog2() - level_u as u32, SIZE.ilog2() - level_v as u32],
        }
    }

    /// The tone at base texel `(u, v)`, averaged over texels of the given levels.
    #[inline]
    pub(super) fn sample(&self, u: f32, v: f32, level_u: usize, level_v: usize) -> f32 {
        let plane = self.plane(level_u, level_v);
        let (at, fx, fy) = plane.locate(u, v);
        blend(plane.quad(at), fx, fy)
    }

    /// The tones at a span of base texels.
    #[inline]
    pub(super) fn span(&self, u: &Lanes, v: &Lanes, level_u: usize, level_v: usize) -> Lanes {
        let plane = self.plane(level_u, level_v);
        let (mut at, mut fx, mut fy) = ([[0; 2]; LANES], [0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            (at[i], fx[i], fy[i]) = plane.locate(u[i], v[i]);
        }
        let mut quads = [0; LANES];
        for i in 0..LANES {
            quads[i] = plane.quad(at[i]);
        }
        lanes(|i| blend(quads[i], fx[i], fy[i]))
    }
}

/// Periodic value noise with `period` cells over the tile.
fn lattice(seed: u32, period: u32, x: f32, y: f32) -> f32 {
    let scale = period as f32 / SIZE as f32;
    let (x, y) = (x * scale, y * scale);
    let (xi, yi) = (floor(x), floor(y));
    let (fx, fy) = (x - xi as f32, y - yi as f32);
    let (fx, fy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    let wrap = |i: i32| i.rem_euclid(period as i32) as u32;
    let at = |i: i32, j: i32| 2.0 * unit(hash(seed ^ (period << 8), wrap(xi + i) | wrap(yi + j) << 12)) - 1.0;
    let top = at(0, 0) + (at(1, 0) - at(0, 0)) * fx;
    let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * fx;
    top + (bottom - top) * fy
}

fn octaves(seed: u32, weights: &[(u32, f32)], x: f32, y: f32) -> f32 {
    weights
        .iter()
        .map(|&(period, weight)| weight * lattice(seed, period, x, y))
        .sum()
}

/// Every tile the world draws with; the same for all worlds, which mix them differently.
#[derive(Clone, Debug)]
pub struct Textures {
    /// Stones and pores of asphalt.
    pub(super) grain: Tile,
    /// Cracks, dark on zero.
    pub(super) cracks: Tile,
    /// Broad stains; also plaster and clouds.
    pub(super) stains: Tile,
    /// Leaves, grass blades.
    pub(super) leaves: Tile,
    /// Paving slabs with joints, eight by eight in a tile.
    pub(super) slabs: Tile,
    /// Courses of brick or stone, 32 rows of 8.
    pub(super) bricks: Tile,
}

impl Default for Textures {
    fn default() -> Self {
        Self::new()
    }
}

impl Textures {
    /// Builds every tile; takes a fraction of a second.
    #[must_use]
    pub fn new() -> Self {
        let grain = Tile::new(|x, y| {
            let stone = unit(hash(77, x as u32 | (y as u32) << 12));
            let speckle = if stone > 0.985 { 0.45 } else { 0.0 } - if stone < 0.03 { 0.35 } else { 0.0 };
            speckle
                + octaves(
                    1,
                    &[
                        (6, 0.08),
                        (16, 0.09),
                        (32, 0.10),
                        (64, 0.14),
                        (128, 0.24),
                        (256, 0.30),
                    ],
                    x,
                    y,
                )
        });
        let cracks = Tile::new(|x, y| {
            let wx = x + 14.0 * lattice(2, 24, x, y) + 5.0 * lattice(3, 80, x, y);
            let wy = y + 14.0 * lattice(4, 24, x, y) + 5.0 * lattice(5, 80, x, y);
            let line = |seed, period, width: f32, from: f32| {
                let ridge = lattice(seed, period, wx, wy).abs() * SIZE as f32 / period as f32;
                (1.0 - ridge / width).clamp(0.0, 1.0)
                    * smoothstep(from, from + 0.2, lattice(seed + 9, period, x, y))
            };
            -line(20, 4, 3.0, -0.1).max(0.8 * line(21, 9, 2.6, 0.25))
        });
        let stains = Tile::new(|x, y| {
            octaves(
                6,
                &[
                    (3, 0.35),
                    (7, 0.3),
                    (15, 0.25),
                    (33, 0.2),
                    (70, 0.15),
                    (150, 0.12),
                    (256, 0.1),
                ],
                x,
                y,
            )
        });
        let leaves = Tile::new(|x, y| {
            let clump = octaves(7, &[(5, 0.3), (12, 0.3), (28, 0.3)], x, y);
            let leaf = octaves(8, &[(64, 0.5), (128, 0.5), (256, 0.3)], x, y);
            (0.9 * clump + 1.1 * smoothstep(-0.35, 0.45, leaf) - 0.55).clamp(-1.0, 1.0)
        });
        let slabs = Tile::new(|x, y| {
            let (column, row) = (x as u32 / 64, y as u32 / 64);
            let near = |c: f32| (c % 64.0).min(63.0 - c % 64.0);
            let joint = 1.0 - smoothstep(0.4, 1.8, near(x).min(near(y)));
            0.28 * (unit(hash(9, column + 8 * row)) - 0.5) - 0.5 * joint
                + octaves(10, &[(20, 0.1), (90, 0.12), (256, 0.14)], x, y)
        });
        let bricks = Tile::new(|x, y| {
            let row = y as u32 / 16;
            let shifted = (x + if row.is_multiple_of(2) { 32.0 } else { 0.0 }) % SIZE as f32;
            let near = |c: f32, n: f32| (c % n).min(n - 1.0 - c % n);
            let joint = 1.0 - smoothstep(0.3, 1.6, near(shifted, 64.0).min(near(y, 16.0)));
            0.7 * (unit(hash(11, row * 8 + shifted as u32 / 64)) - 0.5)
                + 0.35 * joint
                + octaves(12, &[(40, 0.1), (160, 0.15)], x, y)
        });
        Self {
            grain,
            cracks,
            stains,
            leaves,
            slabs,
            bricks,
        }
    }
}
