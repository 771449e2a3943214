//! The road's centre line and edges, in world space and in road coordinates.
//!
//! Road coordinates: `s` metres along the centre line (0 where the drive starts), `d` metres to its left. The heading is
//! a smooth bounded function of `s`, so the curvature is continuous, as in a chain of clothoids, and the road never
//! meets itself. In: seed and style. Out: positions, `(s, d)` of any point, signed distance to the kerb.
//! Invariant: the first pose of the drive is the identity. Cost: a nearest point is at most [`NEWTON_STEPS`] steps.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "table indices are clamped to the road's length"
)]

use super::noise::{Seeded, wave};
use super::style::Style;

/// Metres between samples of the centre line.
pub(super) const STEP_M: f64 = 0.5;
/// Road behind the start of the drive.
pub(super) const BEHIND_M: f64 = 80.0;
/// Road beyond the end of the drive: what a camera there still sees.
pub(super) const BEYOND_M: f64 = 260.0;
const NEWTON_STEPS: usize = 8;
/// A nearest point that moves less than this is found: the next step would move it far less.
const SETTLED_M: f64 = 1e-5;
/// Side streets end this far from the kerb line.
const SIDE_STREET_M: f32 = 42.0;
/// Radius of the kerb at a side street's corner.
const CORNER_M: f32 = 4.5;

#[derive(Clone, Copy, Debug)]
struct Sample {
    x: f64,
    y: f64,
    heading: f64,
    /// Unit vector along the road.
    along: [f64; 2],
}

/// The cross-section at one sample, left side first.
#[derive(Clone, Copy, Debug)]
struct Section {
    half_width: [f32; 2],
    /// Distance to the nearest side street's straight edge, negative inside its mouth.
    gap: [f32; 2],
}

/// A side street: where its middle meets the road, half its width, and on which side (0 left, 1 right).
#[derive(Clone, Copy, Debug)]
struct SideStreet {
    s: f32,
    half: f32,
    side: usize,
}

/// Centre line and edges.
#[derive(Clone, Debug)]
pub(super) struct Road {
    samples: Vec<Sample>,
    sections: Vec<Section>,
    s_by_x: Vec<f32>,
    x0: f64,
}

impl Road {
    /// Lays out a road long enough for a drive of `length_m`, its ego lane at `style.ego_d`.
    pub(super) fn new(seed: u64, length_m: f64, style: &Style) -> Self {
        let mut random = Seeded::new(seed, 1);
        let count = ((BEHIND_M + length_m + BEYOND_M) / STEP_M) as usize + 2;
        let samples = centre_line(random.word(), count, style);
        let streets = side_streets(&mut random, length_m, style);
        let sections = (0..count)
            .map(|i| section(i as f64 * STEP_M - BEHIND_M, &streets, style, seed as u32))
            .collect();
        let x0 = samples[0].x;
        let span = samples[count - 1].x - x0;
        let mut s_by_x = Vec::with_capacity(span as usize + 2);
        let mut i = 0;
        for metre in 0..=span as usize {
            while i + 1 < count && samples[i].x < x0 + metre as f64 {
                i += 1;
            }
            s_by_x.push((i as f64 * STEP_M - BEHIND_M) as f32);
        }
        Self {
            samples,
            sections,
            s_by_x,
            x0,
        }
    }

    /// Position and heading of the centre line.
    pub(super) fn at(&self, s: f64) -> (f64, f64, f64) {
        let place = ((s + BEHIND_M) / STEP_M).clamp(0.0, (self.samples.len() - 2) as f64);
        let i = place as usize;
        // Beyond either end the line goes straight on.
        let f = (s + BEHIND_M) / STEP_M - i as f64;
        let (a, b) = (self.samples[i], self.samples[i + 1]);
        if !(0.0..=1.0).contains(&f) {
            let (from, run) = if f < 0.0 {
                (a, f * STEP_M)
            } else {
                (b, (f - 1.0) * STEP_M)
            };
            let [cos, sin] = from.along;
            return (from.x + run * cos, from.y + run * sin, from.heading);
        }
        let heading = a.heading + f * (b.heading - a.heading);
        // Cubic Hermite: the tangents are the unit headings.
        let (f2, f3) = (f * f, f * f * f);
        let (h00, h10) = (2.0 * f3 - 3.0 * f2 + 1.0, (f3 - 2.0 * f2 + f) * STEP_M);
        let (h01, h11) = (3.0 * f2 - 2.0 * f3, (f3 - f2) * STEP_M);
        let ([ca, sa], [cb, sb]) = (a.along, b.along);
        (
            h00 * a.x + h10 * ca + h01 * b.x + h11 * cb,
            h00 * a.y + h10 * sa + h01 * b.y + h11 * sb,
            heading,
        )
    }

    /// World position of a point in road coordinates, and the heading there.
    pub(super) fn world(&self, s: f64, d: f64) -> (f64, f64, f64) {
        let (x, y, heading) = self.at(s);
        let (sin, cos) = heading.sin_cos();
        (x - d * sin, y + d * cos, heading)
    }

    /// Curvature of the centre line, positive to the left.
    pub(super) fn curvature(&self, s: f64) -> f64 {
        let heading = |s: f64| {
            let last = self.samples.len() - 1;
            let place = ((s + BEHIND_M) / STEP_M).clamp(0.0, last as f64);
            let i = (place as usize).min(last - 1);
            let (a, b) = (self.samples[i].heading, self.samples[i + 1].heading);
            a + (place - i as f64) * (b - a)
        };
        (heading(s + 0.5) - heading(s - 0.5)) / 1.0
    }

    /// Road coordinates of a world point.
    pub(super) fn locate(&self, x: f64, y: f64) -> (f64, f64) {
        let bin = (x - self.x0).clamp(0.0, (self.s_by_x.len() - 1) as f64) as usize;
        let mut s = f64::from(self.s_by_x[bin]);
        for _ in 0..NEWTON_STEPS {
            let (px, py, heading) = self.at(s);
            let (sin, cos) = heading.sin_cos();
            let (dx, dy) = (x - px, y - py);
            let along = dx * cos + dy * sin;
            let left = dy * cos - dx * sin;
            let slope = (1.0 - self.curvature(s) * left).clamp(0.5, 2.0);
            let step = (along / slope).clamp(-40.0, 40.0);
            s += step;
            if step.abs() < SETTLED_M {
                break;
            }
        }
        let (px, py, heading) = self.at(s);
        let (sin, cos) = heading.sin_cos();
        (s, (y - py) * cos - (x - px) * sin)
    }

    /// Half-width and side-street gap at `(s, side)`.
    #[inline]
    fn section(&self, s: f32, side: usize) -> (f32, f32) {
        let place =
            ((s + BEHIND_M as f32) * (1.0 / STEP_M as f32)).clamp(0.0, (self.sections.len() - 2) as f32);
        let i = place as i32 as usize;
        let f = place - i as f32;
        let (a, b) = (&self.sections[i], &self.sections[i + 1]);
        (
            a.half_width[side] + f * (b.half_width[side] - a.half_width[side]),
            a.gap[side] + f * (b.gap[side] - a.gap[side]),
        )
    }

    /// Half-width of the carriageway on a side (0 left, 1 right).
    pub(super) fn half_width(&self, s: f32, side: usize) -> f32 {
        self.section(s, side).0
    }

    /// Distance along the road to the nearest side street's edge on a side, negative in its mouth.
    pub(super) fn gap(&self, s: f32, side: usize) -> f32 {
        self.section(s, side).1
    }

    /// Signed distance to the edge of the road, negative on it.
    #[inline]
    pub(super) fn edge(&self, s: f32, d: f32) -> f32 {
        let (half_width, gap) = self.section(s, usize::from(d < 0.0));
        let beside = d.abs() - half_width;
        if beside <= 0.0 {
            // In front of a mouth no kerb runs along the road.
            return if gap < CORNER_M { beside.min(-3.0) } else { beside };
        }
        if gap <= 0.0 {
            return gap.max(beside - SIDE_STREET_M);
        }
        if gap < CORNER_M && beside < CORNER_M {
            let (a, b) = (CORNER_M - gap, CORNER_M - beside);
            return CORNER_M - (a * a + b * b).sqrt();
        }
        gap.min(beside)
    }
}

fn centre_line(seed: u32, count: usize, style: &Style) -> Vec<Sample> {
    const SUBSTEPS: usize = 5;
    let heading = |s: f64| {
        let x = s as f32 / style.bend_length_m;
        f64::from(style.bend_rad * (wave(seed, x) + 0.3 * wave(seed ^ 5, 2.3 * x)))
    };
    let mut samples = Vec::with_capacity(count);
    let (mut x, mut y) = (0.0, 0.0);
    for i in 0..count {
        let s = i as f64 * STEP_M - BEHIND_M;
        samples.push(Sample {
            x,
            y,
            heading: heading(s),
            along: [0.0; 2],
        });
        for k in 0..SUBSTEPS {
            let step = STEP_M / SUBSTEPS as f64;
            let (sin, cos) = heading(s + (k as f64 + 0.5) * step).sin_cos();
            x += step * cos;
            y += step * sin;
        }
    }
    // Move the whole line so that the drive starts at the origin, looking along x.
    let start = samples[(BEHIND_M / STEP_M) as usize];
    let (sin, cos) = start.heading.sin_cos();
    for sample in &mut samples {
        let (dx, dy) = (sample.x - start.x, sample.y - start.y);
        sample.x = cos * dx + sin * dy;
        sample.y = cos * dy - sin * dx - f64::from(style.ego_d);
        sample.heading -= start.heading;
        let (sin, cos) = sample.heading.sin_cos();
        sample.along = [cos, sin];
    }
    samples
}

fn side_streets(random: &mut Seeded, length_m: f64, style: &Style) -> Vec<SideStreet> {
    let mut streets = Vec::new();
    if style.side_street_every_m <= 0.0 {
        return streets;
    }
    let mut s = -30.0 + random.range(0.0, style.side_street_every_m);
    while f64::from(s) < length_m + BEYOND_M {
        streets.push(SideStreet {
            s,
            half: random.range(2.2, 4.0),
            side: random.pick(&[0, 1]),
        });
        s += random.range(0.5, 1.5) * style.side_street_every_m + 25.0;
    }
    streets
}

fn section(s: f64, streets: &[SideStreet], style: &Style, seed: u32) -> Section {
    let s = s as f32;
    let mut gap = [1e3_f32; 2];
    for street in streets {
        gap[street.side] = gap[street.side].min((s - street.s).abs() - street.half);
    }
    let mut half_width = [0.0; 2];
    for side in 0..2 {
        let sway = style.width_sway_m * wave(seed ^ (31 + side as u32), s / 70.0);
        // A parking bay widens the road between its ends; it ends well before a mouth.
        let bay =
            style.bay_m[side] * (4.0 * (wave(seed ^ (41 + side as u32), s / 45.0) + 0.2)).clamp(0.0, 1.0);
        let clear = ((gap[side] - 8.0) / 3.0).clamp(0.0, 1.0);
        half_width[side] = style.half_width_m + sway + bay * clear;
    }
    Section { half_width, gap }
}

impl Road {
    /// How much of the parking bay is open there, 0 to 1.
    pub(super) fn bay(&self, s: f32, side: usize, style: &Style) -> f32 {
        if style.bay_m[side] <= 0.0 {
            return 0.0;
        }
        ((self.half_width(s, side) - style.half_width_m) / style.bay_m[side]).clamp(0.0, 1.0)
    }
}
