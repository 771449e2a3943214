//! The solids everything on the road is put together from, and their meeting with a ray.
//!
//! A [`Part`] stands upright and is turned about the vertical only. In: a ray in world space. Out: the distance to the
//! part and the place where it is met, in the part's own axes (x ahead, y left, z up from its base). Cost: six divisions.

use super::lanes::{LANES, Lanes, lanes};
use super::texture::{Textures, level};

/// Geometry of a part, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// A box whose four sides may lean inwards: walls, gables, cabins.
    Frustum,
    /// Crowns, heads, bushes.
    Ellipsoid,
    /// An upright cylinder of radius `half[0]`.
    Post,
    /// A cylinder of radius `half[0]` lying across, `2 half[1]` wide.
    Wheel,
}

/// Crowns less deep than this may let the view through between their leaves.
const THIN: f32 = 0.7;

/// What a part's surface looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Material {
    Plain,
    Plaster,
    Brick,
    Roof,
    Foliage,
    Bark,
    Body,
    Glass,
    Tyre,
    Pickets,
}

/// One solid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) shape: Shape,
    pub(super) material: Material,
    pub(super) label: u8,
    /// Base centre in world space.
    pub(super) base: [f32; 3],
    pub(super) sin: f32,
    pub(super) cos: f32,
    pub(super) half: [f32; 2],
    pub(super) height: f32,
    /// Inward lean of front, back and both flanks, metres a metre of height.
    pub(super) lean: [f32; 3],
    pub(super) rgb: [f32; 3],
    /// Varies the texture from part to part.
    pub(super) detail: f32,
}

/// Where a ray meets a part.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) distance: f32,
    /// In the part's axes.
    pub(super) point: [f32; 3],
    /// In the part's axes, unit.
    pub(super) normal: [f32; 3],
}

/// A part seen from one place: all that does not depend on the ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen<'a> {
    pub(super) part: &'a Part,
    /// The eye in the part's axes.
    eye: [f32; 3],
    /// Planes of a frustum and the eye's height over each: first those that face the eye.
    planes: [([f32; 3], f32); 6],
    facing: usize,
    /// Of an ellipsoid: one over its radii, the eye in units of them.
    inverse: [f32; 3],
    unit_eye: [f32; 3],
}

#[inline]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
fn along(from: [f32; 3], ray: [f32; 3], distance: f32) -> [f32; 3] {
    [
        from[0] + distance * ray[0],
        from[1] + distance * ray[1],
        from[2] + distance * ray[2],
    ]
}

impl<'a> Seen<'a> {
    /// `part` seen from `origin` in world space.
    pub(super) fn new(part: &'a Part, origin: [f32; 3]) -> Self {
        let (dx, dy) = (origin[0] - part.base[0], origin[1] - part.base[1]);
        let eye = [
            dx * part.cos + dy * part.sin,
            dy * part.cos - dx * part.sin,
            origin[2] - part.base[2],
        ];
        let mut seen = Self {
            part,
            eye,
            planes: [([0.0; 3], 0.0); 6],
            facing: 0,
            inverse: [0.0; 3],
            unit_eye: [0.0; 3],
        };
        match part.shape {
            Shape::Frustum => seen.sort_planes(),
            Shape::Ellipsoid => {
                let radii = [part.half[0], part.half[1], 0.5 * part.height];
                seen.inverse = radii.map(|r| 1.0 / r);
                seen.unit_eye = [eye[0] / radii[0], eye[1] / radii[1], eye[2] / radii[2] - 1.0];
            }
            Shape::Post | Shape::Wheel => {}
        }
        seen
    }

    fn sort_planes(&mut self) {
        let part = self.part;
        let [front, back, flank] = part.lean;
        let planes = [
            ([1.0, 0.0, front], part.half[0]),
            ([-1.0, 0.0, back], part.half[0]),
            ([0.0, 1.0, flank], part.half[1]),
            ([0.0, -1.0, flank], part.half[1]),
            ([0.0, 0.0, 1.0], part.height),
            ([0.0, 0.0, -1.0], 0.0),
        ];
        let mut last = planes.len();
        for (normal, offset) in planes {
            let height = dot(normal, self.eye) - offset;
            if height > 0.0 {
                self.planes[self.facing] = (normal, height);
                self.facing += 1;
            } else {
                last -= 1;
                self.planes[last] = (normal, height);
            }
        }
    }

    #[inline]
    fn turned(&self, ray: [f32; 3]) -> [f32; 3] {
        let part = self.part;
        [
            ray[0] * part.cos + ray[1] * part.sin,
            ray[1] * part.cos - ray[0] * part.sin,
            ray[2],
        ]
    }

    /// Distance along the unit `ray` at which the part is met before `limit`.
    #[inline]
    pub(super) fn distance(&self, ray: [f32; 3], limit: f32, textures: &Textures) -> Option<f32> {
        let r = self.turned(ray);
        match self.part.shape {
            Shape::Frustum => self.frustum(r, limit).map(|(distance, _)| distance),
            Shape::Ellipsoid => self.ellipsoid(r, limit, textures),
            Shape::Post | Shape::Wheel => self.cylinder(r, limit).map(|(distance, _)| distance),
        }
    }

    /// Where the unit `ray` meets the part, which [`Self::distance`] has found at `distance`.
    #[inline]
    pub(super) fn met(&self, ray: [f32; 3], distance: f32) -> Hit {
        let r = self.turned(ray);
        let normal = match self.part.shape {
            Shape::Frustum => {
                let n = self.planes[self.frustum(r, f32::MAX).map_or(0, |(_, face)| face)].0;
                let scale = 1.0 / dot(n, n).sqrt();
                [n[0] * scale, n[1] * scale, n[2] * scale]
            }
            Shape::Ellipsoid => self.ellipsoid_normal(r, distance),
            Shape::Post | Shape::Wheel => self
                .cylinder(r, f32::MAX)
                .map_or([0.0, 0.0, 1.0], |(_, normal)| normal),
        };
        Hit {
            distance,
            point: along(self.eye, r, distance),
            normal,
        }
    }

    /// The farthest of the facing planes is where a convex solid is entered, if the place lies behind all others.
    #[inline]
    fn frustum(&self, r: [f32; 3], limit: f32) -> Option<(f32, usize)> {
        let (mut near, mut face) = (0.0, 0);
        for (i, (normal, height)) in self.planes[..self.facing].iter().enumerate() {
            let speed = dot(*normal, r);
            if speed > -1e-9 {
                return None;
            }
            let at = -height / speed;
            if at > near {
                near = at;
                face = i;
            }
        }
        if near <= 1e-3 || near >= limit {
            return None;
        }
        let inside = self.planes[self.facing..]
            .iter()
            .all(|(normal, height)| height + near * dot(*normal, r) <= 0.0);
        inside.then_some((near, face))
    }

    #[inline]
    fn ellipsoid_normal(&self, r: [f32; 3], distance: f32) -> [f32; 3] {
        let i = self.inverse;
        let p = along(self.unit_eye, [r[0] * i[0], r[1] * i[1], r[2] * i[2]], distance);
        let n = [p[0] * i[0], p[1] * i[1], p[2] * i[2]];
        let scale = 1.0 / dot(n, n).sqrt().max(1e-9);
        [n[0] * scale, n[1] * scale, n[2] * scale]
    }

    #[inline]
    fn ellipsoid(&self, r: [f32; 3], limit: f32, textures: &Textures) -> Option<f32> {
        let i = self.inverse;
        let (p, q) = (self.unit_eye, [r[0] * i[0], r[1] * i[1], r[2] * i[2]]);
        let (a, b, c) = (dot(q, q), dot(p, q), dot(p, p) - 1.0);
        let under = b * b - a * c;
        if under <= 0.0 || c < 0.0 || b > 0.0 {
            return None;
        }
        let distance = (-b - under.sqrt()) / a;
        if distance >= limit {
            return None;
        }
        let through = under < THIN * a && self.lets_through(r, distance, under / a, textures);
        (!through).then_some(distance)
    }

    /// Whether the view passes between the leaves of a crown, where the ray goes `depth` deep, 0 at the silhouette.
    fn lets_through(&self, r: [f32; 3], distance: f32, depth: f32, textures: &Textures) -> bool {
        if self.part.material != Material::Foliage {
            return false;
        }
        let (u, v) = self
            .part
            .foliage_texel(along(self.eye, r, distance), self.ellipsoid_normal(r, distance));
        let coarse = level(distance * 0.012);
        let clumps = textures.leaves.sample(0.2 * u, 0.2 * v, coarse, coarse);
        let left = depth * 1.7 - 0.3 - 0.5 * clumps;
        // Leaves decide only where clumps leave it open.
        if left.abs() > 0.36 {
            return left < 0.0;
        }
        let fine = level(distance * 0.06);
        0.35 * textures.leaves.sample(u, v, fine, fine) > left
    }

    /// Distances along a span of unit rays at which the part is met before the limits; infinite where it is not.
    #[inline]
    pub(super) fn distances(&self, rays: &[Lanes; 3], limits: &Lanes, textures: &Textures) -> Lanes {
        let part = self.part;
        let r = [
            lanes(|i| rays[0][i] * part.cos + rays[1][i] * part.sin),
            lanes(|i| rays[1][i] * part.cos - rays[0][i] * part.sin),
            rays[2],
        ];
        match part.shape {
            Shape::Frustum => self.frustum_span(&r, limits),
            Shape::Ellipsoid => self.ellipsoid_span(&r, limits, textures),
            Shape::Post | Shape::Wheel => lanes(|i| {
                self.cylinder([r[0][i], r[1][i], r[2][i]], limits[i])
                    .map_or(f32::INFINITY, |(distance, _)| distance)
            }),
        }
    }

    #[inline]
    fn frustum_span(&self, r: &[Lanes; 3], limits: &Lanes) -> Lanes {
        let (facing, rest) = self.planes.split_at(self.facing);
        let mut near = [0.0_f32; LANES];
        for (n, height) in facing {
            near = lanes(|i| {
                let speed = n[0] * r[0][i] + n[1] * r[1][i] + n[2] * r[2][i];
                let at = -height / speed;
                near[i].max(if speed > -1e-9 { f32::INFINITY } else { at })
            });
        }
        let mut outside = [f32::MIN; LANES];
        for (n, height) in rest {
            outside = lanes(|i| {
                let speed = n[0] * r[0][i] + n[1] * r[1][i] + n[2] * r[2][i];
                outside[i].max(height + near[i] * speed)
            });
        }
        lanes(|i| {
            let met = (near[i] > 1e-3) & (near[i] < limits[i]) & (outside[i] <= 0.0);
            if met { near[i] } else { f32::INFINITY }
        })
    }

    #[inline]
    fn ellipsoid_span(&self, r: &[Lanes; 3], limits: &Lanes, textures: &Textures) -> Lanes {
        let (p, inverse) = (self.unit_eye, self.inverse);
        let c = dot(p, p) - 1.0;
        if c < 0.0 {
            return [f32::INFINITY; LANES];
        }
        let q = [0, 1, 2].map(|k: usize| lanes(|i| r[k][i] * inverse[k]));
        let a = lanes(|i| q[0][i] * q[0][i] + q[1][i] * q[1][i] + q[2][i] * q[2][i]);
        let b = lanes(|i| p[0] * q[0][i] + p[1] * q[1][i] + p[2] * q[2][i]);
        let under = lanes(|i| b[i] * b[i] - a[i] * c);
        let mut distance = lanes(|i| {
            let at = (-b[i] - under[i].max(0.0).sqrt()) / a[i];
            let met = (under[i] > 0.0) & (b[i] <= 0.0) & (at < limits[i]);
            if met { at } else { f32::INFINITY }
        });
        if self.part.material == Material::Foliage {
            for i in 0..LANES {
                if distance[i] < f32::INFINITY && under[i] < THIN * a[i] {
                    let ray = [r[0][i], r[1][i], r[2][i]];
                    if self.lets_through(ray, distance[i], under[i] / a[i], textures) {
                        distance[i] = f32::INFINITY;
                    }
                }
            }
        }
        distance
    }

    /// A post about z or a wheel about y: distance and normal.
    #[inline]
    fn cylinder(&self, r: [f32; 3], limit: f32) -> Option<(f32, [f32; 3])> {
        let part = self.part;
        let radius = part.half[0];
        let upright = part.shape == Shape::Post;
        let [x, y, z] = self.eye;
        // First two: across the axis; third: along it, from the middle.
        let (o, r, half) = if upright {
            ([x, y, z - 0.5 * part.height], r, 0.5 * part.height)
        } else {
            ([x, z - radius, y], [r[0], r[2], r[1]], part.half[1])
        };
        let back = |n: [f32; 3]| if upright { n } else { [n[0], n[2], n[1]] };
        let a = r[0] * r[0] + r[1] * r[1];
        let b = o[0] * r[0] + o[1] * r[1];
        let c = o[0] * o[0] + o[1] * o[1] - radius * radius;
        let under = b * b - a * c;
        if under <= 0.0 || a < 1e-12 {
            return None;
        }
        let at = (-b - under.sqrt()) / a;
        if at > 1e-3 && at < limit && (o[2] + at * r[2]).abs() <= half {
            return Some((
                at,
                back([(o[0] + at * r[0]) / radius, (o[1] + at * r[1]) / radius, 0.0]),
            ));
        }
        if r[2].abs() < 1e-9 {
            return None;
        }
        let side = -r[2].signum();
        let at = (half * side - o[2]) / r[2];
        let (x, y) = (o[0] + at * r[0], o[1] + at * r[1]);
        (at > 1e-3 && at < limit && x * x + y * y <= radius * radius).then(|| (at, back([0.0, 0.0, side])))
    }
}

impl Part {
    /// Texel of a point on foliage, projected along the axis its surface faces most; leaves hide the seams.
    pub(super) fn foliage_texel(&self, point: [f32; 3], normal: [f32; 3]) -> (f32, f32) {
        let [x, y, z] = point;
        let [nx, ny, nz] = [normal[0].abs(), normal[1].abs(), normal[2].abs()];
        let (u, v) = if nz > nx && nz > ny {
            (x, y)
        } else if nx > ny {
            (y, z)
        } else {
            (x, z)
        };
        (110.0 * u + self.detail * 512.0, 110.0 * v + self.detail * 911.0)
    }

    /// Half extents of the upright box around the part, in its own axes.
    pub(super) fn half_extent(&self) -> [f32; 2] {
        match self.shape {
            Shape::Post => [self.half[0]; 2],
            _ => self.half,
        }
    }

    /// Height of the part's top over its base.
    pub(super) fn top(&self) -> f32 {
        if self.shape == Shape::Wheel {
            2.0 * self.half[0]
        } else {
            self.height
        }
    }
}
