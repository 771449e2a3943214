//! What the ground looks like at a place on or beside the road.
//!
//! In: road coordinates, signed distance to the kerb, the pixel's footprint along and across the road. Out: reflectance.
//! Everything is averaged over the footprint: textures by their rip maps, lines and patches by their covered share, so
//! that the far road does not shimmer. Pixels come in spans, each with one footprint. Cost: at most five texture samples a
//! pixel.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "cell indices are clamped to the road's length"
)]

use super::lanes::{Colours, LANES, Lanes, coloured, lanes, put, range};
use super::noise::{Seeded, smoothstep};
use super::road::{BEHIND_M, BEYOND_M};
use super::style::{Kind, Style, Surface};
use super::texture::{Textures, Tile, level};

/// Length of road that holds at most one patch.
const CELL_M: f32 = 9.0;
const LINE_M: f32 = 0.12;
const DASH_M: f32 = 3.0;
const DASH_PERIOD_M: f32 = 7.5;
const KERB_STONE_M: f32 = 0.15;

/// Something let into or painted on one cell of the road.
#[derive(Clone, Copy, Debug)]
enum Inlay {
    None,
    /// A repair: ends along and across, tone, strength of its seam.
    Patch {
        s: [f32; 2],
        d: [f32; 2],
        tone: f32,
        seam: f32,
    },
    Manhole {
        s: f32,
        d: f32,
        radius: f32,
        tone: f32,
    },
    Zebra {
        s: f32,
    },
}

/// A painted line along the road.
#[derive(Clone, Copy, Debug)]
struct Line {
    d: f32,
    dashed: bool,
}

/// The pixel's footprint on the ground.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    pub(super) along_m: f32,
    pub(super) across_m: f32,
}

/// A span of places on the ground.
#[derive(Clone, Copy, Debug)]
pub(super) struct Places {
    pub(super) s: Lanes,
    pub(super) d: Lanes,
    /// Signed distance outside the kerb.
    pub(super) edge: Lanes,
}

impl Places {
    /// A tile's tones there, at so many texels a metre along and across, shifted by texels along the road.
    #[inline]
    pub(super) fn tones(&self, tile: &Tile, scale: [f32; 2], shift: f32, foot: Footprint) -> Lanes {
        tile.span(
            &lanes(|i| self.s[i] * scale[0] + shift),
            &lanes(|i| self.d[i] * scale[1]),
            level(foot.along_m * scale[0]),
            level(foot.across_m * scale[1]),
        )
    }
}

/// The ground's drawing, fixed for a world.
#[derive(Clone, Debug)]
pub(super) struct Ground {
    inlays: Vec<Inlay>,
    lines: Vec<Line>,
}

/// Share of `[at - width / 2, at + width / 2]` inside `[low, high]`.
#[inline]
fn covered(at: f32, width: f32, low: f32, high: f32) -> f32 {
    let width = width.max(0.004);
    (((at + 0.5 * width).min(high) - (at - 0.5 * width).max(low)) / width).clamp(0.0, 1.0)
}

#[inline]
fn scaled(rgb: [f32; 3], by: f32) -> [f32; 3] {
    [rgb[0] * by, rgb[1] * by, rgb[2] * by]
}

#[inline]
fn mix(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    let at = |k: usize| a[k] + (b[k] - a[k]) * share;
    [at(0), at(1), at(2)]
}

impl Ground {
    /// Draws the inlays and lines of a road for a drive of `length_m`.
    pub(super) fn new(seed: u64, style: &Style, length_m: f64) -> Self {
        let mut random = Seeded::new(seed, 5);
        let count = ((BEHIND_M + length_m + BEYOND_M) as f32 / CELL_M) as usize + 1;
        let half = style.half_width_m;
        let inlays = (0..count)
            .map(|i| {
                let start = i as f32 * CELL_M - BEHIND_M as f32;
                let s = start + random.range(0.5, 5.0);
                if random.chance(style.patches) {
                    let d = random.range(-half, 0.7 * half);
                    let (long, wide) = if random.chance(0.3) {
                        (3.8, half + 3.0)
                    } else {
                        (random.range(0.8, 3.8), random.range(0.5, 2.6))
                    };
                    let tone = if random.chance(0.6) {
                        random.range(0.55, 0.9)
                    } else {
                        random.range(1.05, 1.4)
                    };
                    Inlay::Patch {
                        s: [s, s + long],
                        d: [d, d + wide],
                        tone,
                        seam: random.range(0.0, 0.6),
                    }
                } else if random.chance(0.12) {
                    Inlay::Manhole {
                        s,
                        d: random.range(-0.7, 0.7) * half,
                        radius: random.range(0.27, 0.36),
                        tone: random.range(0.35, 0.9),
                    }
                } else if style.kind == Kind::Urban && random.chance(0.05) {
                    Inlay::Zebra { s }
                } else {
                    Inlay::None
                }
            })
            .collect();
        let mut lines = Vec::new();
        if style.kind == Kind::Highway {
            let lanes = (half / 1.9).round().max(2.0);
            for k in 1..lanes as usize {
                lines.push(Line {
                    d: -half + 2.0 * half * k as f32 / lanes,
                    dashed: true,
                });
            }
        } else if style.centre_dashes {
            lines.push(Line {
                d: 0.0,
                dashed: random.chance(0.8),
            });
        }
        if style.edge_lines {
            let inset = if style.kind == Kind::Highway { 1.2 } else { 0.3 };
            lines.extend([half - inset, inset - half].map(|d| Line { d, dashed: false }));
        }
        Self { inlays, lines }
    }

    /// Reflectance of the carriageway.
    pub(super) fn road(&self, style: &Style, textures: &Textures, at: &Places, foot: Footprint) -> Colours {
        let track = lanes(|i| {
            let lane = (at.d[i].abs() - 0.5 * style.half_width_m).abs() - 0.75;
            (1.0 - lane * lane * 8.0).max(0.0)
        });
        let stain = at.tones(&textures.stains, [11.0, 11.0], 0.0, foot);
        let streak = at.tones(&textures.stains, [2.3, 21.0], 0.0, foot);
        let asphalt = asphalt(style, textures, at, foot);
        let tone =
            lanes(|i| asphalt[i] + style.stains * (0.7 * stain[i] + 0.6 * streak[i] + 0.12 * track[i]));
        let mut rgb = coloured(style.road_rgb, &lanes(|i| tone[i].max(0.25)));
        self.inlay(&mut rgb, at, foot, style);
        kerbside(&mut rgb, &tone, at, foot, style);
        let paint = self.paint(at, foot);
        for i in 0..LANES {
            if paint[i] > 0.0 && at.edge[i] < -0.12 {
                let worn = smoothstep(-0.3, 0.5, stain[i] + streak[i] + 0.3 * track[i]);
                let whole = 1.0 - style.marking_wear * worn;
                let fresh = scaled(style.marking_rgb, 0.8 + 0.25 * asphalt[i]);
                change(&mut rgb, i, |old| mix(old, fresh, paint[i] * whole));
            }
        }
        rgb
    }

    /// Draws what is let into the road.
    fn inlay(&self, rgb: &mut Colours, at: &Places, foot: Footprint, style: &Style) {
        let cell = |s: f32| {
            let place = (s + BEHIND_M as f32) * (1.0 / CELL_M);
            place.clamp(0.0, (self.inlays.len() - 1) as f32) as usize
        };
        let (s, d) = (range(&at.s), range(&at.d));
        let (first, last) = (cell(s.0), cell(s.1));
        if !self.inlays[first..=last.max(first)]
            .iter()
            .any(|inlay| inlay.near(s, d, foot))
        {
            return;
        }
        for i in 0..LANES {
            let inlay = self.inlays[cell(at.s[i])];
            change(rgb, i, |old| inlaid(old, inlay, at.s[i], at.d[i], foot, style));
        }
    }

    /// Share of each footprint that is painted.
    fn paint(&self, at: &Places, foot: Footprint) -> Lanes {
        let mut paint = [0.0; LANES];
        let (low, high) = range(&at.d);
        let reach = 0.5 * (LINE_M + foot.across_m.max(0.004));
        for line in &self.lines {
            if line.d + reach < low || line.d - reach > high {
                continue;
            }
            for i in 0..LANES {
                let share = covered(at.d[i] - line.d, foot.across_m, -0.5 * LINE_M, 0.5 * LINE_M);
                let dash = if !line.dashed {
                    1.0
                } else if foot.along_m > 0.6 * DASH_PERIOD_M {
                    DASH_M / DASH_PERIOD_M
                } else {
                    let phase = modulo(at.s[i] - 0.5 * DASH_M, DASH_PERIOD_M) - 0.5 * DASH_PERIOD_M;
                    covered(phase, foot.along_m, -0.5 * DASH_M, 0.5 * DASH_M)
                };
                paint[i] += share * dash;
            }
        }
        paint
    }

    /// Reflectance of raised ground outside the kerb.
    pub(super) fn verge(&self, style: &Style, textures: &Textures, at: &Places, foot: Footprint) -> Colours {
        let kerb_m = if style.kerb_m > 0.05 { KERB_STONE_M } else { 0.0 };
        let (mut rgb, mut painted) = ([[0.0; LANES]; 3], [false; LANES]);
        let mut fill = |wanted: [bool; LANES], drawn: &dyn Fn() -> Colours| {
            if !wanted.contains(&true) {
                return;
            }
            let new = drawn();
            for i in 0..LANES {
                if wanted[i] && !painted[i] {
                    change(&mut rgb, i, |_| [new[0][i], new[1][i], new[2][i]]);
                    painted[i] = true;
                }
            }
        };
        let (mut kerb, mut pavement, mut beyond) = ([false; LANES], [false; LANES], [false; LANES]);
        for i in 0..LANES {
            kerb[i] = at.edge[i] < kerb_m;
            pavement[i] = !kerb[i] && at.edge[i] < style.pavement_m[usize::from(at.d[i] < 0.0)];
            beyond[i] = !kerb[i] && !pavement[i];
        }
        fill(kerb, &|| {
            let grain = at.tones(&textures.grain, [90.0, 90.0], 0.0, foot);
            let tone = lanes(|i| {
                let joint = covered(modulo(at.s[i], 1.0), foot.along_m, 0.0, 0.02);
                1.0 + 0.25 * grain[i] - 0.5 * joint
            });
            coloured(style.kerb_rgb, &tone)
        });
        fill(pavement, &|| {
            surface(style.pavement, style.pavement_rgb, style, textures, at, foot)
        });
        fill(beyond, &|| {
            surface(style.beyond, style.beyond_rgb, style, textures, at, foot)
        });
        rgb
    }
}

/// `x` brought into `[0, period)`.
#[inline]
fn modulo(x: f32, period: f32) -> f32 {
    x - period * (x * (1.0 / period)).floor()
}

/// Changes the colour of one pixel of a span.
#[inline]
fn change(rgb: &mut Colours, i: usize, by: impl FnOnce([f32; 3]) -> [f32; 3]) {
    let new = by([rgb[0][i], rgb[1][i], rgb[2][i]]);
    put(rgb, i, new);
}

/// Draws the gutter, or the dirt that gathers along the kerb.
fn kerbside(rgb: &mut Colours, tone: &Lanes, at: &Places, foot: Footprint, style: &Style) {
    if range(&at.edge).1 <= -style.gutter_m.max(0.35) {
        return;
    }
    for i in 0..LANES {
        let edge = at.edge[i];
        if edge > -style.gutter_m {
            let joint = covered(modulo(at.s[i], 0.5), foot.along_m, 0.0, 0.02);
            let stone = scaled(style.gutter_rgb, tone[i] * (1.0 - 0.4 * joint));
            let share = covered(edge, foot.across_m, -style.gutter_m, 1.0);
            change(rgb, i, |old| mix(old, stone, share));
        } else if edge > -0.35 {
            let dirt = 0.25 * style.stains * smoothstep(-0.35, 0.0, edge);
            change(rgb, i, |old| scaled(old, 1.0 - dirt));
        }
    }
}

/// Tone of bare asphalt, about 1.
fn asphalt(style: &Style, textures: &Textures, at: &Places, foot: Footprint) -> Lanes {
    let mut tone = [1.0; LANES];
    // Averaged over more than this, the tiles are flat.
    if foot.along_m < 0.8 {
        let grain = at.tones(&textures.grain, [128.0, 128.0], 0.0, foot);
        tone = lanes(|i| tone[i] + style.grain * grain[i]);
    }
    if style.cracks > 0.0 && foot.along_m < 1.6 {
        let cracks = at.tones(&textures.cracks, [47.0, 47.0], 100.0, foot);
        tone = lanes(|i| tone[i] + style.cracks * cracks[i]);
    }
    tone
}

impl Inlay {
    /// Whether it may touch places within ranges of `s` and `d`.
    fn near(&self, s: (f32, f32), d: (f32, f32), foot: Footprint) -> bool {
        let (more_s, more_d) = (0.5 * foot.along_m + 0.01, 0.5 * foot.across_m + 0.01);
        let meets = |low: [f32; 2], high: [f32; 2]| {
            low[0] - more_s < s.1 && high[0] + more_s > s.0 && low[1] - more_d < d.1 && high[1] + more_d > d.0
        };
        match *self {
            Self::None => false,
            Self::Patch { s, d, .. } => meets([s[0], d[0]], [s[1], d[1]]),
            Self::Manhole { s, d, radius, .. } => {
                let reach = radius + foot.along_m;
                meets([s - reach, d - reach], [s + reach, d + reach])
            }
            Self::Zebra { s } => meets([s, f32::MIN], [s + 3.0, f32::MAX]),
        }
    }
}

fn inlaid(rgb: [f32; 3], inlay: Inlay, s: f32, d: f32, foot: Footprint, style: &Style) -> [f32; 3] {
    match inlay {
        Inlay::None => rgb,
        Inlay::Patch {
            s: ss,
            d: ds,
            tone,
            seam,
        } => {
            let inside = covered(s, foot.along_m, ss[0], ss[1]) * covered(d, foot.across_m, ds[0], ds[1]);
            if inside <= 0.0 {
                return rgb;
            }
            let core = covered(s, foot.along_m, ss[0] + 0.04, ss[1] - 0.04)
                * covered(d, foot.across_m, ds[0] + 0.04, ds[1] - 0.04);
            scaled(rgb, 1.0 + (tone - 1.0) * inside - seam * (inside - core))
        }
        Inlay::Manhole {
            s: ms,
            d: md,
            radius,
            tone,
        } => {
            let (x, y) = (s - ms, d - md);
            let near = (x * x + y * y).sqrt();
            if near > radius + 0.5 * foot.along_m {
                return rgb;
            }
            let inside = covered(near, 0.7 * foot.along_m + 0.3 * foot.across_m, -1.0, radius);
            let ring = covered(near, foot.across_m, radius - 0.05, radius);
            let ribs = if foot.along_m < 0.06 {
                0.2 * ((x * 90.0).sin() * (y * 90.0).sin()).signum()
            } else {
                0.0
            };
            scaled(rgb, 1.0 + inside * (tone - 1.0 + ribs * tone) - 0.3 * ring)
        }
        Inlay::Zebra { s: zs } => {
            let phase = modulo(d, 1.0);
            let stripe = covered(phase, foot.across_m.min(1.0), 0.25, 0.75);
            mix(
                rgb,
                style.marking_rgb,
                0.9 * stripe * covered(s, foot.along_m, zs, zs + 3.0),
            )
        }
    }
}

/// Reflectance of a pavement, lawn or yard.
fn surface(
    kind: Surface,
    rgb: [f32; 3],
    style: &Style,
    textures: &Textures,
    at: &Places,
    foot: Footprint,
) -> Colours {
    let stain = at.tones(&textures.stains, [13.0, 13.0], 200.0, foot);
    let tone = match kind {
        Surface::Grass => {
            let blades = at.tones(&textures.leaves, [140.0, 140.0], 0.0, foot);
            let tufts = at.tones(&textures.leaves, [23.0, 23.0], 0.0, foot);
            let tone = lanes(|i| 1.0 + 0.6 * blades[i] + 0.3 * tufts[i]);
            let dry = lanes(|i| 1.0 + 0.9 * stain[i]);
            return [
                lanes(|i| rgb[0] * tone[i] * dry[i].max(0.4)),
                lanes(|i| rgb[1] * tone[i] * (0.5 + 0.5 * dry[i]).max(0.4)),
                lanes(|i| rgb[2] * tone[i]),
            ];
        }
        Surface::Slabs => {
            let slabs = at.tones(&textures.slabs, [128.0, 128.0], 0.0, foot);
            lanes(|i| 1.0 + 0.8 * slabs[i] + 0.3 * stain[i])
        }
        Surface::Tarmac => {
            let moved = Places {
                s: lanes(|i| at.s[i] + 3.3),
                d: lanes(|i| at.d[i] + 1.7),
                edge: at.edge,
            };
            let asphalt = asphalt(style, textures, &moved, foot);
            lanes(|i| asphalt[i] + 0.3 * stain[i])
        }
        Surface::Gravel => {
            let grain = at.tones(&textures.grain, [60.0, 60.0], 0.0, foot);
            lanes(|i| 1.0 + 0.8 * grain[i] + 0.5 * stain[i])
        }
    };
    coloured(rgb, &lanes(|i| tone[i].max(0.25)))
}
