//! The solids everything on the road is put together from, and their meeting with a ray.
//!
//! A [`Part`] stands upright and is turned about the vertical only. In: a ray in world space. Out: the distance to the
//! part and the place where it is met, in the part's own axes (x ahead, y left, z up from its base). Cost: six divisions.

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

impl Part {
    /// Whether the ray from `origin` along unit `ray` meets the part before `limit`, and where.
    #[inline]
    pub(super) fn meet(&self, origin: [f32; 3], ray: [f32; 3], limit: f32, textures: &Textures) -> Option<Hit> {
        let (dx, dy) = (origin[0] - self.base[0], origin[1] - self.base[1]);
        let o = [
            dx * self.cos + dy * self.sin,
            dy * self.cos - dx * self.sin,
            origin[2] - self.base[2],
        ];
        let r = [
            ray[0] * self.cos + ray[1] * self.sin,
            ray[1] * self.cos - ray[0] * self.sin,
            ray[2],
        ];
        match self.shape {
            Shape::Frustum => self.meet_frustum(o, r, limit),
            Shape::Ellipsoid => self.meet_ellipsoid(o, r, limit, textures),
            Shape::Post => self.meet_cylinder(o, r, limit, [0, 1, 2], 0.5 * self.height, 0.5 * self.height),
            Shape::Wheel => {
                self.meet_cylinder([o[0], o[2] - self.half[0], o[1]], [r[0], r[2], r[1]], limit, [0, 2, 1], 0.0, self.half[1])
            }
        }
    }

    #[inline]
    fn meet_frustum(&self, o: [f32; 3], r: [f32; 3], limit: f32) -> Option<Hit> {
        let [front, back, flank] = self.lean;
        let planes = [
            ([1.0, 0.0, front], self.half[0]),
            ([-1.0, 0.0, back], self.half[0]),
            ([0.0, 1.0, flank], self.half[1]),
            ([0.0, -1.0, flank], self.half[1]),
            ([0.0, 0.0, 1.0], self.height),
            ([0.0, 0.0, -1.0], 0.0),
        ];
        let (mut near, mut far, mut face) = (1e-3, limit, 6);
        for (i, (n, offset)) in planes.iter().enumerate() {
            let outside = n[0] * o[0] + n[1] * o[1] + n[2] * o[2] - offset;
            let speed = n[0] * r[0] + n[1] * r[1] + n[2] * r[2];
            let at = -outside / speed;
            if speed < -1e-9 {
                if at > near {
                    near = at;
                    face = i;
                }
            } else if speed > 1e-9 {
                far = if at < far { at } else { far };
            } else if outside > 0.0 {
                return None;
            }
            if near >= far {
                return None;
            }
        }
        if face == 6 {
            return None;
        }
        let n = planes[face].0;
        let scale = 1.0 / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        Some(Hit {
            distance: near,
            point: [0, 1, 2].map(|k| o[k] + near * r[k]),
            normal: n.map(|c| c * scale),
        })
    }

    #[inline]
    fn meet_ellipsoid(&self, o: [f32; 3], r: [f32; 3], limit: f32, textures: &Textures) -> Option<Hit> {
        let radii = [self.half[0], self.half[1], 0.5 * self.height];
        let centred = [o[0], o[1], o[2] - radii[2]];
        let p = [0, 1, 2].map(|k| centred[k] / radii[k]);
        let q = [0, 1, 2].map(|k| r[k] / radii[k]);
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let (a, b, c) = (dot(q, q), dot(p, q), dot(p, p) - 1.0);
        let under = b * b - a * c;
        if under <= 0.0 || c < 0.0 || b > 0.0 {
            return None;
        }
        let root = under.sqrt();
        let distance = (-b - root) / a;
        if distance >= limit {
            return None;
        }
        let point = [0, 1, 2].map(|k| o[k] + distance * r[k]);
        let n = [0, 1, 2].map(|k| (p[k] + distance * q[k]) / radii[k]);
        let scale = 1.0 / dot(n, n).sqrt().max(1e-9);
        let normal = n.map(|c| c * scale);
        if self.material == Material::Foliage {
            // Depth of the ray in the crown, 0 at the silhouette: thin foliage lets the view through between leaves.
            let depth = under / a;
            if depth < 0.7 {
                let (fine, coarse) = (level(distance * 0.06), level(distance * 0.012));
                let (u, v) = self.foliage_texel(point, normal);
                let leaves = textures.leaves.sample(u, v, fine, fine);
                let clumps = textures.leaves.sample(0.2 * u, 0.2 * v, coarse, coarse);
                if 0.35 * leaves + 0.5 * clumps + 0.3 > depth * 1.7 {
                    return None;
                }
            }
        }
        Some(Hit { distance, point, normal })
    }

    /// Texel of a point on foliage, projected along the axis its surface faces most; leaves hide the seams.
    pub(super) fn foliage_texel(&self, point: [f32; 3], normal: [f32; 3]) -> (f32, f32) {
        let [x, y, z] = point;
        let [nx, ny, nz] = normal.map(f32::abs);
        let (u, v) = if nz > nx && nz > ny {
            (x, y)
        } else if nx > ny {
            (y, z)
        } else {
            (x, z)
        };
        (110.0 * u + self.detail * 512.0, 110.0 * v + self.detail * 911.0)
    }

    /// A cylinder about the third of `o`'s axes, within `centre +- half` of it; `order` puts the axes back in place.
    #[inline]
    fn meet_cylinder(&self, o: [f32; 3], r: [f32; 3], limit: f32, order: [usize; 3], centre: f32, half: f32) -> Option<Hit> {
        let radius = self.half[0];
        let lift = if order[1] == 2 { radius } else { 0.0 };
        let place = |at: f32, normal: [f32; 3]| {
            let (mut point, mut turned) = ([0.0; 3], [0.0; 3]);
            for k in 0..3 {
                point[order[k]] = o[k] + at * r[k];
                turned[order[k]] = normal[k];
            }
            point[2] += lift;
            Hit { distance: at, point, normal: turned }
        };
        let a = r[0] * r[0] + r[1] * r[1];
        let b = o[0] * r[0] + o[1] * r[1];
        let c = o[0] * o[0] + o[1] * o[1] - radius * radius;
        let under = b * b - a * c;
        if under <= 0.0 || a < 1e-12 {
            return None;
        }
        let at = (-b - under.sqrt()) / a;
        let along = o[2] + at * r[2];
        if at > 1e-3 && at < limit && (along - centre).abs() <= half {
            return Some(place(at, [(o[0] + at * r[0]) / radius, (o[1] + at * r[1]) / radius, 0.0]));
        }
        if r[2].abs() < 1e-9 {
            return None;
        }
        let cap = centre - half * r[2].signum();
        let at = (cap - o[2]) / r[2];
        let (x, y) = (o[0] + at * r[0], o[1] + at * r[1]);
        (at > 1e-3 && at < limit && x * x + y * y <= radius * radius).then(|| place(at, [0.0, 0.0, -r[2].signum()]))
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
        if self.shape == Shape::Wheel { 2.0 * self.half[0] } else { self.height }
    }
}
