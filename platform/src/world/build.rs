//! Builders: a car, a house, a tree and the rest, each as a few parts.
//!
//! In: a place, a heading, the seeded sequence. Out: parts appended to a list. Sizes are those of the real things.

use super::noise::Seeded;
use super::shape::{Material, Part, Shape};
use super::style::Style;
use super::truth::Label;

/// Lays parts out in the axes of one object.
struct Builder<'a> {
    parts: &'a mut Vec<Part>,
    base: [f32; 3],
    sin: f32,
    cos: f32,
    label: Label,
    detail: f32,
}

impl Builder<'_> {
    fn part(
        &mut self,
        shape: Shape,
        material: Material,
        at: [f32; 3],
        size: [f32; 3],
        rgb: [f32; 3],
    ) -> &mut Part {
        let [x, y, z] = at;
        let base = [
            self.base[0] + x * self.cos - y * self.sin,
            self.base[1] + x * self.sin + y * self.cos,
            self.base[2] + z,
        ];
        let at = self.parts.len();
        self.parts.push(Part {
            shape,
            material,
            label: self.label as u8,
            base,
            sin: self.sin,
            cos: self.cos,
            half: [size[0], size[1]],
            height: size[2],
            lean: [0.0; 3],
            rgb,
            detail: self.detail,
        });
        &mut self.parts[at]
    }
}

fn builder<'a>(
    parts: &'a mut Vec<Part>,
    random: &mut Seeded,
    base: [f32; 3],
    yaw: f32,
    label: Label,
) -> Builder<'a> {
    let (sin, cos) = yaw.sin_cos();
    Builder {
        parts,
        base,
        sin,
        cos,
        label,
        detail: random.range(0.0, 1.0),
    }
}

fn paint(random: &mut Seeded) -> [f32; 3] {
    let tone = random.pick(&[0.03, 0.05, 0.12, 0.3, 0.45, 0.7]);
    if random.chance(0.3) {
        random.pick(&[
            [0.35, 0.03, 0.03],
            [0.03, 0.06, 0.3],
            [0.05, 0.18, 0.08],
            [0.4, 0.3, 0.05],
            [0.1, 0.25, 0.4],
        ])
    } else {
        [tone, tone, tone * 1.03]
    }
}

/// A car of 3.6 to 4.9 m, or a van, its middle at `at`.
pub(super) fn car(parts: &mut Vec<Part>, random: &mut Seeded, at: [f32; 3], yaw: f32) {
    let van = random.chance(0.15);
    let half = if van {
        random.range(2.4, 2.8)
    } else {
        random.range(1.8, 2.4)
    };
    let wide = if van { 0.95 } else { random.range(0.82, 0.92) };
    let tall = if van {
        random.range(1.9, 2.3)
    } else {
        random.range(1.4, 1.65)
    };
    let waist = if van { 1.15 } else { random.range(0.85, 0.98) };
    let rgb = paint(random);
    let dark = [0.02; 3];
    let mut b = builder(parts, random, at, yaw, Label::Vehicle);
    let body = b.part(
        Shape::Frustum,
        Material::Body,
        [0.0, 0.0, 0.28],
        [half, wide, waist - 0.28],
        rgb,
    );
    body.lean = [0.22, 0.08, 0.06];
    b.part(
        Shape::Frustum,
        Material::Plain,
        [0.0, 0.0, 0.16],
        [half - 0.12, wide - 0.06, 0.2],
        dark,
    );
    let (front, back) = if van {
        (half - 0.7, half - 0.05)
    } else {
        (half - 1.05, half - 0.25)
    };
    let middle = 0.5 * (front - back);
    let rise = tall - waist;
    let cabin = b.part(
        Shape::Frustum,
        Material::Glass,
        [middle, 0.0, waist],
        [0.5 * (front + back), wide - 0.06, rise - 0.04],
        rgb,
    );
    cabin.lean = if van { [0.6, 0.05, 0.12] } else { [1.05, 0.55, 0.3] };
    let [f, r, k] = cabin.lean.map(|l| l * (rise - 0.05));
    let roof_half = 0.5 * (front + back - f - r);
    b.part(
        Shape::Frustum,
        Material::Body,
        [middle + 0.5 * (r - f), 0.0, tall - 0.06],
        [roof_half, wide - 0.06 - k, 0.05],
        rgb,
    )
    .lean = [1.0, 1.0, 0.6];
    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        b.part(
            Shape::Wheel,
            Material::Tyre,
            [x * (half - 0.8), y * (wide - 0.1), 0.0],
            [0.32, 0.11, 0.64],
            dark,
        );
    }
}

/// A house of `storeys`, its front along the road.
pub(super) fn house(
    parts: &mut Vec<Part>,
    random: &mut Seeded,
    at: [f32; 2],
    yaw: f32,
    half: [f32; 2],
    storeys: f32,
) {
    let tone = random.range(0.15, 0.75);
    let warm = random.range(0.0, 0.3);
    let brick = random.chance(0.3);
    let rgb = if brick {
        [0.32, 0.16 + 0.1 * warm, 0.1]
    } else {
        [tone, tone * (1.0 - 0.4 * warm), tone * (1.0 - warm)]
    };
    let roof = random.pick(&[[0.25, 0.09, 0.05], [0.1, 0.09, 0.09], [0.16, 0.11, 0.08]]);
    let flat = random.chance(0.2);
    let pitch = random.range(0.7, 1.2);
    let mut b = builder(parts, random, [at[0], at[1], 0.0], yaw, Label::Far);
    let tall = storeys * 2.9 + 0.6;
    let walls = if brick { Material::Brick } else { Material::Plaster };
    b.part(Shape::Frustum, walls, [0.0; 3], [half[0], half[1], tall], rgb);
    if !flat {
        let rise = (half[1] + 0.4) * pitch;
        b.part(
            Shape::Frustum,
            Material::Roof,
            [0.0, 0.0, tall],
            [half[0] + 0.3, half[1] + 0.4, rise],
            roof,
        )
        .lean = [0.02, 0.02, 1.0 / pitch];
    }
}

/// A trunk with two or three crowns.
pub(super) fn tree(parts: &mut Vec<Part>, random: &mut Seeded, at: [f32; 2], size: f32, style: &Style) {
    let size = size * random.range(0.7, 1.4);
    let green = random.range(0.7, 1.35);
    let rgb = style.leaf_rgb.map(|c| c * green);
    let bark = [0.09, 0.075, 0.06];
    let yaw = random.range(0.0, 6.0);
    let slim = random.chance(0.2);
    let trunk = random.range(1.6, 2.6) * size;
    let crowns = if slim { 1 } else { 4 };
    let offsets = [0; 12].map(|_| random.range(-1.0, 1.0));
    let mut b = builder(parts, random, [at[0], at[1], 0.0], yaw, Label::Far);
    b.part(
        Shape::Post,
        Material::Bark,
        [0.0; 3],
        [0.15 * size, 0.15 * size, trunk + 1.5],
        bark,
    )
    .label = Label::Roadside as u8;
    let r = if slim { 1.2 } else { 2.2 } * size;
    b.part(
        Shape::Ellipsoid,
        Material::Foliage,
        [0.0, 0.0, trunk],
        [r, r, if slim { 6.0 } else { 4.6 } * size],
        rgb,
    );
    for k in 1..crowns {
        let [x, y, z] = [0, 1, 2].map(|i| offsets[3 * k + i]);
        let place = [0.75 * x * r, 0.75 * y * r, trunk + (1.1 + 1.1 * z) * size];
        let wide = r * (0.62 + 0.12 * z);
        b.detail = (b.detail + 0.37).fract();
        b.part(
            Shape::Ellipsoid,
            Material::Foliage,
            place,
            [wide, wide * 1.1, 2.9 * size],
            rgb.map(|c| c * (1.0 + 0.12 * x)),
        );
    }
}

/// A stretch of hedge: a box of leaves with a bumpy top.
pub(super) fn hedge(
    parts: &mut Vec<Part>,
    random: &mut Seeded,
    at: [f32; 2],
    yaw: f32,
    half: f32,
    tall: f32,
    style: &Style,
) {
    let wild = random.chance(0.4);
    let rgb = style.leaf_rgb.map(|c| c * 0.85);
    let bump = random.range(-1.2, 1.2);
    let mut b = builder(parts, random, [at[0], at[1], 0.0], yaw, Label::Far);
    b.part(
        Shape::Frustum,
        Material::Foliage,
        [0.0; 3],
        [half, 0.45, tall],
        rgb,
    )
    .lean = [0.0, 0.0, 0.06];
    if wild {
        b.part(
            Shape::Ellipsoid,
            Material::Foliage,
            [bump, 0.0, 0.2 * tall],
            [1.7, 0.9, 1.15 * tall],
            rgb,
        );
    }
}

/// A stretch of fence, low wall or guard rail.
pub(super) fn fence(
    parts: &mut Vec<Part>,
    random: &mut Seeded,
    at: [f32; 2],
    yaw: f32,
    half: f32,
    tall: f32,
    kind: u32,
) {
    let mut b = builder(parts, random, [at[0], at[1], 0.0], yaw, Label::Roadside);
    match kind % 4 {
        0 => b.part(
            Shape::Frustum,
            Material::Brick,
            [0.0; 3],
            [half, 0.14, tall],
            [0.33, 0.24, 0.18],
        ),
        1 => b.part(
            Shape::Frustum,
            Material::Pickets,
            [0.0; 3],
            [half, 0.03, tall],
            [0.3, 0.22, 0.14],
        ),
        2 => b.part(
            Shape::Frustum,
            Material::Plaster,
            [0.0; 3],
            [half, 0.12, tall],
            [0.42, 0.4, 0.37],
        ),
        _ => {
            b.part(
                Shape::Post,
                Material::Plain,
                [0.0; 3],
                [0.06, 0.06, tall],
                [0.25; 3],
            );
            b.part(
                Shape::Frustum,
                Material::Plain,
                [0.0, 0.0, 0.6 * tall],
                [half, 0.04, 0.4 * tall],
                [0.35; 3],
            )
        }
    };
}

/// A lamp post or a traffic sign, its arm towards `yaw`.
pub(super) fn post(parts: &mut Vec<Part>, random: &mut Seeded, at: [f32; 2], yaw: f32) {
    let lamp = random.chance(0.55);
    let grey = random.range(0.08, 0.35);
    let sign = random.pick(&[
        [0.5, 0.03, 0.03],
        [0.04, 0.08, 0.4],
        [0.55, 0.5, 0.1],
        [0.6, 0.6, 0.6],
    ]);
    let mut b = builder(parts, random, [at[0], at[1], 0.0], yaw, Label::Roadside);
    if lamp {
        b.part(
            Shape::Post,
            Material::Plain,
            [0.0; 3],
            [0.08, 0.08, 6.5],
            [grey; 3],
        );
        b.part(
            Shape::Frustum,
            Material::Plain,
            [0.7, 0.0, 6.4],
            [0.8, 0.05, 0.1],
            [grey; 3],
        );
        b.part(
            Shape::Frustum,
            Material::Plain,
            [1.5, 0.0, 6.3],
            [0.35, 0.14, 0.16],
            [grey * 1.2; 3],
        );
    } else {
        b.part(
            Shape::Post,
            Material::Plain,
            [0.0; 3],
            [0.04, 0.04, 2.9],
            [grey; 3],
        );
        b.part(
            Shape::Frustum,
            Material::Plain,
            [0.0, 0.05, 2.2],
            [0.32, 0.02, 0.6],
            sign,
        );
    }
}

/// A person; `stride` is the way walked, which swings the legs.
pub(super) fn person(parts: &mut Vec<Part>, random: &mut Seeded, at: [f32; 3], yaw: f32, stride: f32) {
    let size = random.range(0.88, 1.08);
    let (coat, trousers) = (paint(random), paint(random).map(|c| 0.6 * c));
    let skin = random.pick(&[[0.45, 0.28, 0.2], [0.2, 0.11, 0.07], [0.5, 0.35, 0.27]]);
    let swing = 0.22 * (stride * 4.2).sin();
    let mut b = builder(parts, random, at, yaw, Label::Living);
    let part = |b: &mut Builder<'_>, shape, at: [f32; 3], half: [f32; 3], rgb| {
        b.part(
            shape,
            Material::Plain,
            at.map(|c| c * size),
            half.map(|c| c * size),
            rgb,
        );
    };
    part(
        &mut b,
        Shape::Ellipsoid,
        [0.0, 0.0, 0.82],
        [0.15, 0.23, 0.68],
        coat,
    );
    part(
        &mut b,
        Shape::Post,
        [swing, 0.09, 0.0],
        [0.085, 0.085, 0.9],
        trousers,
    );
    part(
        &mut b,
        Shape::Post,
        [-swing, -0.09, 0.0],
        [0.085, 0.085, 0.9],
        trousers,
    );
    part(
        &mut b,
        Shape::Ellipsoid,
        [-0.6 * swing, 0.27, 0.75],
        [0.07, 0.06, 0.65],
        coat,
    );
    part(
        &mut b,
        Shape::Ellipsoid,
        [0.6 * swing, -0.27, 0.75],
        [0.07, 0.06, 0.65],
        coat,
    );
    part(
        &mut b,
        Shape::Ellipsoid,
        [0.0, 0.0, 1.48],
        [0.1, 0.085, 0.25],
        skin,
    );
}
