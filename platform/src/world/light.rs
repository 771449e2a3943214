//! Colours of objects and of the sky.
//!
//! In: where a ray meets a part, or its direction. Out: linear radiance. Textures are fixed to the part's own axes.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "table indices are bounded by the table"
)]

use super::lanes::{Colours, LANES, Lanes, lanes, range};
use super::noise::{floor, hash, smoothstep, unit, wave};
use super::shape::{Hit, Material, Part};
use super::style::Style;
use super::texture::{Textures, level};

const SKYLINE_BINS: usize = 2048;

/// Far tree line and clouds.
#[derive(Clone, Debug)]
pub(super) struct Sky {
    skyline: Vec<f32>,
}

impl Sky {
    /// Draws the far tree line of a world.
    pub(super) fn new(seed: u32, style: &Style) -> Self {
        let skyline = (0..=SKYLINE_BINS)
            .map(|i| {
                let a = i as f32 / SKYLINE_BINS as f32;
                // Fades to the same height at both ends, straight behind the start.
                let fade = (8.0 * a.min(1.0 - a)).min(1.0);
                let hills = 0.5 * wave(seed, a * 22.0) + 0.25 * wave(seed ^ 1, a * 60.0);
                let trees = 0.25 * wave(seed ^ 2, a * 260.0) + 0.12 * wave(seed ^ 3, a * 900.0);
                style.skyline * (0.6 + fade * (hills + trees)).max(0.1)
            })
            .collect();
        Self { skyline }
    }

    /// Radiance along a span of unit rays, and where the far tree line is seen.
    pub(super) fn seen(
        &self,
        rays: &[Lanes; 3],
        style: &Style,
        textures: &Textures,
    ) -> (Colours, [bool; LANES]) {
        let mut rgb = clouds(rays, style, textures);
        let mut far = [false; LANES];
        let slope = lanes(|i| {
            rays[2][i]
                / (rays[0][i] * rays[0][i] + rays[1][i] * rays[1][i])
                    .sqrt()
                    .max(1e-3)
        });
        if range(&slope).0 >= 1.6 * style.skyline {
            return (rgb, far);
        }
        let turn_of = |i: usize| rays[1][i].atan2(rays[0][i]) / std::f32::consts::TAU + 0.5;
        let (from, to) = (turn_of(0), turn_of(LANES - 1));
        // The short way round.
        let step = (to - from - (to - from).round()) / (LANES - 1) as f32;
        let turn = lanes(|i| {
            let turn = from + i as f32 * step;
            turn - turn.floor()
        });
        for i in 0..LANES {
            let place = turn[i] * SKYLINE_BINS as f32;
            let bin = (place as usize).min(SKYLINE_BINS - 1);
            let f = place - bin as f32;
            far[i] = slope[i] < self.skyline[bin] + f * (self.skyline[bin + 1] - self.skyline[bin]);
        }
        if !far.contains(&true) {
            return (rgb, far);
        }
        let leaves = textures
            .leaves
            .span(&lanes(|i| turn[i] * 6000.0), &lanes(|i| slope[i] * 1300.0), 0, 0);
        let haze = 0.2 + 0.6 * 300.0 / (300.0 + style.haze_m);
        for (k, channel) in rgb.iter_mut().enumerate() {
            let lit = style.leaf_rgb[k] * (style.sky_light_rgb[k] + 0.3 * style.sun_rgb[k]);
            for i in 0..LANES {
                let lit = lit * (0.7 + 0.45 * leaves[i]);
                if far[i] {
                    channel[i] = lit + haze * (0.5 * style.horizon_rgb[k] - lit);
                }
            }
        }
        (rgb, far)
    }
}

/// Radiance of the sky, clouds and all.
fn clouds(rays: &[Lanes; 3], style: &Style, textures: &Textures) -> Colours {
    let height = lanes(|i| rays[2][i].max(0.0));
    let blue = lanes(|i| (height[i] * 2.2).min(1.0).sqrt());
    let reach = lanes(|i| 1.0 / (height[i] + 0.06));
    let middle = reach[LANES / 2];
    let l = level(0.5 * middle * middle);
    let cloud = textures.stains.span(
        &lanes(|i| rays[0][i] * reach[i] * 42.0),
        &lanes(|i| rays[1][i] * reach[i] * 42.0),
        l,
        l,
    );
    let (low, high) = (0.65 - 1.3 * style.clouds, 1.0 - 1.1 * style.clouds);
    let cover = lanes(|i| smoothstep(low, high, cloud[i] + 0.12));
    let channel = |k: usize| {
        lanes(|i| {
            let white = 0.9 + 0.35 * cloud[i] + 0.15 * style.sun_rgb[1];
            let clear = style.horizon_rgb[k] + blue[i] * (style.zenith_rgb[k] - style.horizon_rgb[k]);
            clear + cover[i] * (white * style.sky_light_rgb[k] * 1.25 - clear)
        })
    };
    [channel(0), channel(1), channel(2)]
}

/// Radiance of a part where a ray meets it.
pub(super) fn lit(part: &Part, hit: &Hit, style: &Style, textures: &Textures, pixel_rad: f32) -> [f32; 3] {
    let foot_m = hit.distance * pixel_rad;
    let mut gloss = 0.0;
    let mut rgb = reflectance(part, hit, textures, foot_m, &mut gloss);
    let [nx, ny, nz] = hit.normal;
    let world = [nx * part.cos - ny * part.sin, nx * part.sin + ny * part.cos, nz];
    let sun = (world[0] * style.sun[0] + world[1] * style.sun[1] + world[2] * style.sun[2]).max(0.0);
    let open = openness(nz, hit.point[2] + part.base[2]);
    for (k, c) in rgb.iter_mut().enumerate() {
        let sky = 0.5 * style.horizon_rgb[k] * (0.4 + 0.6 * nz.max(0.0));
        *c = *c * (open * style.sky_light_rgb[k] + sun * style.sun_rgb[k]) + gloss * sky;
    }
    rgb
}

/// Radiance of a span of foliage, all of one part.
pub(super) fn lit_foliage(
    part: &Part,
    hits: &[Hit; LANES],
    style: &Style,
    textures: &Textures,
    pixel_rad: f32,
) -> Colours {
    let foot_m = hits[LANES / 2].distance * pixel_rad;
    let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
    for i in 0..LANES {
        (u[i], v[i]) = part.foliage_texel(hits[i].point, hits[i].normal);
    }
    let (l, m) = (level(foot_m * 110.0), level(foot_m * 22.0));
    let fine = textures.leaves.span(&u, &v, l, l);
    let coarse = textures
        .leaves
        .span(&lanes(|i| 0.2 * u[i]), &lanes(|i| 0.2 * v[i]), m, m);
    let height = 1.0 / part.height;
    let tone = lanes(|i| {
        let under = 0.5 + 0.5 * (hits[i].point[2] * height).clamp(0.0, 1.0);
        ((0.85 + 0.85 * fine[i] + 0.6 * coarse[i]) * under).max(0.08)
    });
    let ahead = style.sun[0] * part.cos + style.sun[1] * part.sin;
    let aside = style.sun[1] * part.cos - style.sun[0] * part.sin;
    let sun = lanes(|i| {
        let n = hits[i].normal;
        (n[0] * ahead + n[1] * aside + n[2] * style.sun[2]).max(0.0)
    });
    let open = lanes(|i| openness(hits[i].normal[2], hits[i].point[2] + part.base[2]));
    let channel = |k: usize| {
        lanes(|i| part.rgb[k] * tone[i] * (open[i] * style.sky_light_rgb[k] + sun[i] * style.sun_rgb[k]))
    };
    [channel(0), channel(1), channel(2)]
}

/// Share of the sky's light: less is seen from low down and by surfaces that face the ground.
#[inline]
fn openness(up: f32, height: f32) -> f32 {
    (0.62 + 0.38 * up) * (0.6 + 0.4 * height.clamp(0.0, 1.0))
}

fn reflectance(part: &Part, hit: &Hit, textures: &Textures, foot_m: f32, gloss: &mut f32) -> [f32; 3] {
    let [x, y, z] = hit.point;
    // On upright faces: metres along the face.
    let along = if hit.normal[0].abs() > hit.normal[1].abs() {
        y
    } else {
        x
    };
    let at = |scale: f32, tile: &super::texture::Tile| {
        let l = level(foot_m * scale);
        tile.sample(along * scale + part.detail * 5000.0, z * scale, l, l)
    };
    let tone = match part.material {
        Material::Plain => 1.0,
        Material::Bark => 1.0 + 0.7 * at(60.0, &textures.leaves),
        Material::Roof => {
            let rows = if foot_m < 0.15 {
                0.25 * ((z * 18.0).sin())
            } else {
                0.0
            };
            1.0 + 0.4 * at(40.0, &textures.stains) + rows
        }
        Material::Foliage => {
            let (u, v) = part.foliage_texel(hit.point, hit.normal);
            let (l, m) = (level(foot_m * 110.0), level(foot_m * 22.0));
            let fine = textures.leaves.sample(u, v, l, l);
            let coarse = textures.leaves.sample(0.2 * u, 0.2 * v, m, m);
            (0.85 + 0.85 * fine + 0.6 * coarse) * (0.5 + 0.5 * (z / part.height).clamp(0.0, 1.0))
        }
        Material::Plaster | Material::Brick => return wall(part, hit, along, textures, foot_m, gloss),
        Material::Pickets => {
            let gap = (along * 8.0).rem_euclid(1.0) < 0.3 && foot_m < 0.06;
            if gap {
                0.3
            } else {
                1.0 + 0.3 * at(70.0, &textures.stains)
            }
        }
        Material::Body => return body(part, hit, along, gloss),
        Material::Glass => {
            *gloss = 0.3;
            // Pillars in the paint of the car.
            let side = hit.normal[1].abs() > 0.5;
            let pillar = side && ((x + 0.1).abs() < 0.06 || x.abs() > 0.8 * part.half[0] - 0.55 * z)
                || z > part.height - 0.05;
            if pillar {
                return part.rgb;
            }
            return [0.02, 0.024, 0.028];
        }
        Material::Tyre => {
            let hub = (x * x + (z - part.half[0]).powi(2)).sqrt() < 0.6 * part.half[0];
            return if hub && hit.normal[1].abs() > 0.5 {
                [0.22; 3]
            } else {
                [0.018; 3]
            };
        }
    };
    part.rgb.map(|c| c * tone.max(0.08))
}

fn body(part: &Part, hit: &Hit, along: f32, gloss: &mut f32) -> [f32; 3] {
    *gloss = 0.16;
    let z = hit.point[2];
    if part.height < 0.1 {
        return part.rgb;
    }
    if hit.normal[0].abs() > 0.5 {
        let lamp = along.abs() > 0.62 * part.half[1] && (0.6..0.88).contains(&(z / part.height));
        if lamp {
            return if hit.normal[0] > 0.0 {
                [0.6, 0.6, 0.58]
            } else {
                [0.4, 0.02, 0.02]
            };
        }
        if along.abs() < 0.26 && (0.3..0.48).contains(&(z / part.height)) {
            return [0.6, 0.6, 0.55];
        }
        if z < 0.16 {
            return part.rgb.map(|c| 0.35 * c);
        }
    } else if hit.normal[1].abs() > 0.5 {
        // Wheel arches, sill, door gaps.
        let arch = (hit.point[0].abs() - (part.half[0] - 0.8)).abs();
        if arch * arch + z * z < 0.145 || z < 0.05 {
            return [0.015; 3];
        }
        if (hit.point[0] + 0.15).abs() < 0.012 {
            return part.rgb.map(|c| 0.4 * c);
        }
    }
    part.rgb
}

fn wall(part: &Part, hit: &Hit, along: f32, textures: &Textures, foot_m: f32, gloss: &mut f32) -> [f32; 3] {
    let z = hit.point[2];
    let l = level(foot_m * 22.0);
    let dirt = textures
        .stains
        .sample(along * 22.0 + part.detail * 3000.0, z * 22.0, l, l);
    let mut tone = 1.0 + 0.22 * dirt - 0.15 * smoothstep(0.8, 0.0, z);
    if part.material == Material::Brick {
        let l = level(foot_m * 200.0);
        tone += 0.7 * textures.bricks.sample(along * 200.0, z * 200.0, l, l);
    }
    let plain = part.rgb.map(|c| c * tone);
    if part.height < 3.0 || hit.normal[2].abs() > 0.5 {
        return plain;
    }
    let half = if hit.normal[0].abs() > hit.normal[1].abs() {
        part.half[1]
    } else {
        part.half[0]
    };
    let count = (2.0 * half / (2.1 + 1.4 * part.detail)).floor().max(1.0);
    let pitch = 2.0 * half / count;
    let column = floor((along + half) / pitch);
    let u = (along + half) - (column as f32 + 0.5) * pitch;
    let storey = floor((z - 0.4) / 2.9);
    let v = z - 0.4 - storey as f32 * 2.9 - 1.55;
    let (half_u, half_v) = (0.4 + 0.25 * part.detail, 0.68);
    let foot = foot_m.max(0.01);
    let inside = |a: f32, b: f32| {
        ((a - u.abs()) / foot + 0.5).clamp(0.0, 1.0) * ((b - v.abs()) / foot + 0.5).clamp(0.0, 1.0)
    };
    let (frame, pane) = (inside(half_u + 0.09, half_v + 0.09), inside(half_u, half_v));
    let curtain = unit(hash((column as u32) ^ (part.detail * 1e4) as u32, storey as u32));
    let glass = if curtain > 0.7 {
        0.25
    } else {
        0.03 + 0.05 * curtain
    };
    let bar = ((0.035 - u.abs()) / foot + 0.5).clamp(0.0, 1.0);
    let white = if part.detail > 0.4 { 0.6 } else { 0.25 };
    let pane_tone = glass + (white - glass) * bar;
    *gloss = 0.25 * pane;
    plain.map(|c| {
        let framed = c + (white - c) * frame;
        framed + (pane_tone - framed) * pane
    })
}
