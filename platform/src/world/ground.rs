//! What the ground looks like at a place on or beside the road.
//!
//! In: road coordinates, signed distance to the kerb, the pixel's footprint along and across the road. Out: reflectance.
//! Everything is averaged over the footprint: textures by their rip maps, lines and patches by their covered share, so
//! that the far road does not shimmer. Cost: at most five texture samples.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "cell indices are clamped to the road's length"
)]

use super::noise::{Seeded, smoothstep};
use super::road::{BEHIND_M, BEYOND_M};
use super::style::{Kind, Style, Surface};
use super::texture::{Textures, level};

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
    pub(super) fn road(
        &self,
        style: &Style,
        textures: &Textures,
        s: f32,
        d: f32,
        edge: f32,
        foot: Footprint,
    ) -> [f32; 3] {
        let lanes = (d.abs() - 0.5 * style.half_width_m).abs() - 0.75;
        let track = (1.0 - lanes * lanes * 8.0).max(0.0);
        let (along, across) = (foot.along_m, foot.across_m);
        let stain = textures
            .stains
            .sample(s * 11.0, d * 11.0, level(along * 11.0), level(across * 11.0));
        let streak = textures
            .stains
            .sample(s * 2.3, d * 21.0, level(along * 2.3), level(across * 21.0));
        let asphalt = asphalt(style, textures, s, d, foot);
        let tone = asphalt + style.stains * (0.7 * stain + 0.6 * streak + 0.12 * track);
        let mut rgb = scaled(style.road_rgb, tone.max(0.25));
        let cell = ((s + BEHIND_M as f32) * (1.0 / CELL_M)).clamp(0.0, (self.inlays.len() - 1) as f32);
        rgb = inlaid(rgb, self.inlays[cell as usize], s, d, foot, style);
        if edge > -style.gutter_m {
            let joint = covered(s.rem_euclid(0.5), along, 0.0, 0.02);
            rgb = mix(
                rgb,
                scaled(style.gutter_rgb, tone * (1.0 - 0.4 * joint)),
                covered(edge, across, -style.gutter_m, 1.0),
            );
        } else if edge > -0.35 {
            // Dirt gathers along the kerb.
            rgb = scaled(rgb, 1.0 - 0.25 * style.stains * smoothstep(-0.35, 0.0, edge));
        }
        let paint = self.paint(s, d, foot);
        if paint > 0.0 && edge < -0.12 {
            let whole = 1.0 - style.marking_wear * smoothstep(-0.3, 0.5, stain + streak + 0.3 * track);
            rgb = mix(
                rgb,
                scaled(style.marking_rgb, 0.8 + 0.25 * asphalt),
                paint * whole,
            );
        }
        rgb
    }

    fn paint(&self, s: f32, d: f32, foot: Footprint) -> f32 {
        let mut paint = 0.0;
        for line in &self.lines {
            let share = covered(d - line.d, foot.across_m, -0.5 * LINE_M, 0.5 * LINE_M);
            if share > 0.0 {
                let dash = if !line.dashed {
                    1.0
                } else if foot.along_m > 0.6 * DASH_PERIOD_M {
                    DASH_M / DASH_PERIOD_M
                } else {
                    let phase = (s - 0.5 * DASH_M).rem_euclid(DASH_PERIOD_M) - 0.5 * DASH_PERIOD_M;
                    covered(phase, foot.along_m, -0.5 * DASH_M, 0.5 * DASH_M)
                };
                paint += share * dash;
            }
        }
        paint
    }

    /// Reflectance of raised ground at `edge` metres outside the kerb.
    pub(super) fn verge(
        &self,
        style: &Style,
        textures: &Textures,
        s: f32,
        d: f32,
        edge: f32,
        foot: Footprint,
    ) -> [f32; 3] {
        let kerbed = style.kerb_m > 0.05;
        if kerbed && edge < KERB_STONE_M {
            let joint = covered(s.rem_euclid(1.0), foot.along_m, 0.0, 0.02);
            let grain = textures.grain.sample(
                s * 90.0,
                d * 90.0,
                level(foot.along_m * 90.0),
                level(foot.across_m * 90.0),
            );
            return scaled(style.kerb_rgb, 1.0 + 0.25 * grain - 0.5 * joint);
        }
        let pavement = style.pavement_m[usize::from(d < 0.0)];
        if edge < pavement {
            return surface(style.pavement, style.pavement_rgb, style, textures, s, d, foot);
        }
        surface(style.beyond, style.beyond_rgb, style, textures, s, d, foot)
    }
}

/// Tone of bare asphalt, about 1.
fn asphalt(style: &Style, textures: &Textures, s: f32, d: f32, foot: Footprint) -> f32 {
    let (along, across) = (foot.along_m, foot.across_m);
    // Averaged over this much, the tiles are flat.
    let grain = if along < 0.8 {
        textures
            .grain
            .sample(s * 128.0, d * 128.0, level(along * 128.0), level(across * 128.0))
    } else {
        0.0
    };
    let cracks = if style.cracks > 0.0 && along < 1.6 {
        textures.cracks.sample(
            s * 47.0 + 100.0,
            d * 47.0,
            level(along * 47.0),
            level(across * 47.0),
        )
    } else {
        0.0
    };
    1.0 + style.grain * grain + style.cracks * cracks
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
            let phase = d.rem_euclid(1.0);
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
    s: f32,
    d: f32,
    foot: Footprint,
) -> [f32; 3] {
    let (along, across) = (foot.along_m, foot.across_m);
    let stain = textures.stains.sample(
        s * 13.0 + 200.0,
        d * 13.0,
        level(along * 13.0),
        level(across * 13.0),
    );
    let tone = match kind {
        Surface::Grass => {
            let blades =
                textures
                    .leaves
                    .sample(s * 140.0, d * 140.0, level(along * 140.0), level(across * 140.0));
            let tufts = textures
                .leaves
                .sample(s * 23.0, d * 23.0, level(along * 23.0), level(across * 23.0));
            let dry = 1.0 + 0.9 * stain;
            let tone = 1.0 + 0.6 * blades + 0.3 * tufts;
            return [
                rgb[0] * tone * dry.max(0.4),
                rgb[1] * tone * (0.5 + 0.5 * dry).max(0.4),
                rgb[2] * tone,
            ];
        }
        Surface::Slabs => {
            1.0 + 0.8
                * textures
                    .slabs
                    .sample(s * 128.0, d * 128.0, level(along * 128.0), level(across * 128.0))
                + 0.3 * stain
        }
        Surface::Tarmac => asphalt(style, textures, s + 3.3, d + 1.7, foot) + 0.3 * stain,
        Surface::Gravel => {
            1.0 + 0.8
                * textures
                    .grain
                    .sample(s * 60.0, d * 60.0, level(along * 60.0), level(across * 60.0))
                + 0.5 * stain
        }
    };
    scaled(rgb, tone.max(0.25))
}
