//! Which part each pixel sees: bounds of parts in the image, and the depth buffer.
//!
//! In: parts and a camera pose. Out: per pixel the distance along its ray and the part's index plus one, 0 for none.
//! Parts are visited from near to far; a pixel is tested only where the part's bounding sphere could be nearer than what
//! it already holds. Cost: bounded by the parts within [`super::scene::NEAR_M`].
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use freespace::frame::Lens;
use freespace::space::Pose;
use nalgebra::Vector3;

use super::lanes::{LANES, Lanes, lanes};
use super::shape::{Part, Seen, Shape};
use super::texture::Textures;

const NEAR_PLANE_M: f32 = 0.15;

/// The camera while one frame is drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    pub(super) origin: [f32; 3],
    /// Rows: the camera's axes in world space.
    pub(super) axes: [[f32; 3]; 3],
}

impl View {
    pub(super) fn new(world_from_camera: &Pose) -> Self {
        let t = world_from_camera.translation.vector;
        let r = world_from_camera.rotation.to_rotation_matrix();
        let axis = |k: usize| [0, 1, 2].map(|i| r[(i, k)] as f32);
        Self {
            origin: [t.x as f32, t.y as f32, t.z as f32],
            axes: [axis(0), axis(1), axis(2)],
        }
    }

    fn in_camera(&self, p: [f32; 3]) -> [f32; 3] {
        let d = [0, 1, 2].map(|k| p[k] - self.origin[k]);
        self.axes.map(|a| a[0] * d[0] + a[1] * d[1] + a[2] * d[2])
    }

    #[inline]
    pub(super) fn to_world(self, rays: &[Lanes; 3]) -> [Lanes; 3] {
        let [a, b, c] = &self.axes;
        let along = |k: usize| lanes(|i| a[k] * rays[0][i] + b[k] * rays[1][i] + c[k] * rays[2][i]);
        [along(0), along(1), along(2)]
    }
}

/// The part of the image plane that the image covers, as tangents of the angles to the axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    pub(super) low: [f32; 2],
    pub(super) high: [f32; 2],
}

/// Half-open pixel ranges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) x: [usize; 2],
    pub(super) y: [usize; 2],
}

/// The image's size and lens, for bounding.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) lens: Lens,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) extent: Extent,
}

const EDGES: [[usize; 2]; 12] = [
    [0, 1],
    [0, 2],
    [0, 4],
    [1, 3],
    [1, 5],
    [2, 3],
    [2, 6],
    [3, 7],
    [4, 5],
    [4, 6],
    [5, 7],
    [6, 7],
];

impl Frame {
    /// Pixels that an upright box may cover; none where it is out of view.
    pub(super) fn bounds(
        &self,
        view: &View,
        base: [f32; 3],
        turn: [f32; 2],
        half: [f32; 2],
        top: f32,
    ) -> Option<Bounds> {
        let [sin, cos] = turn;
        let mut corners = [[0.0; 3]; 8];
        for (i, corner) in corners.iter_mut().enumerate() {
            let x = if i & 1 == 0 { -half[0] } else { half[0] };
            let y = if i & 2 == 0 { -half[1] } else { half[1] };
            let z = if i & 4 == 0 { 0.0 } else { top };
            *corner = view.in_camera([
                base[0] + x * cos - y * sin,
                base[1] + x * sin + y * cos,
                base[2] + z,
            ]);
        }
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        let mut take = |p: [f32; 3]| {
            for k in 0..2 {
                let tangent = p[k] / p[2];
                low[k] = low[k].min(tangent);
                high[k] = high[k].max(tangent);
            }
        };
        for [i, j] in EDGES {
            let (a, b) = (corners[i], corners[j]);
            let (inside_a, inside_b) = (a[2] >= NEAR_PLANE_M, b[2] >= NEAR_PLANE_M);
            if inside_a {
                take(a);
            }
            if inside_b {
                take(b);
            }
            if inside_a != inside_b {
                let f = (NEAR_PLANE_M - a[2]) / (b[2] - a[2]);
                take([a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), NEAR_PLANE_M]);
            }
        }
        let seen = (0..2).all(|k| low[k] < self.extent.high[k] && high[k] > self.extent.low[k]);
        seen.then(|| self.pixels(low, high))
    }

    /// Pixels inside a rectangle of tangents, with a margin for the lens.
    fn pixels(&self, low: [f32; 2], high: [f32; 2]) -> Bounds {
        let within = |k: usize, t: f32| t.clamp(self.extent.low[k], self.extent.high[k]);
        let us = [
            within(0, low[0]),
            within(0, 0.0_f32.clamp(low[0], high[0])),
            within(0, high[0]),
        ];
        let vs = [
            within(1, low[1]),
            within(1, 0.0_f32.clamp(low[1], high[1])),
            within(1, high[1]),
        ];
        let (mut x, mut y) = ([f64::MAX, f64::MIN], [f64::MAX, f64::MIN]);
        for u in us {
            for v in vs {
                let direction = Vector3::new(f64::from(u), f64::from(v), 1.0);
                if let Some(p) = self.lens.project(&direction) {
                    x = [x[0].min(p.x), x[1].max(p.x)];
                    y = [y[0].min(p.y), y[1].max(p.y)];
                }
            }
        }
        let range = |[low, high]: [f64; 2], size: usize| {
            let margin = 2.0 + 0.01 * (high - low).abs();
            [
                (low - margin).clamp(0.0, size as f64) as usize,
                (high + margin + 1.0).clamp(0.0, size as f64) as usize,
            ]
        };
        Bounds {
            x: range(x, self.width),
            y: range(y, self.height),
        }
    }
}

/// The nearest part of every pixel.
#[derive(Clone, Debug)]
pub(super) struct DepthBuffer {
    /// Metres along the unit ray.
    pub(super) distance: Box<[f32]>,
    /// Index of the part plus one.
    pub(super) part: Box<[u32]>,
}

impl DepthBuffer {
    pub(super) fn new(pixels: usize) -> Self {
        Self {
            distance: vec![f32::MAX; pixels].into_boxed_slice(),
            part: vec![0; pixels].into_boxed_slice(),
        }
    }

    pub(super) fn clear(&mut self) {
        self.distance.fill(f32::MAX);
        self.part.fill(0);
    }

    /// Draws one part; `id` is not 0.
    pub(super) fn draw(
        &mut self,
        part: &Part,
        id: u32,
        frame: &Frame,
        view: &View,
        rays: &[[Lanes; 3]],
        textures: &Textures,
    ) {
        let half = part.half_extent();
        let Some(bounds) = frame.bounds(view, part.base, [part.sin, part.cos], half, part.top()) else {
            return;
        };
        let nearest = nearest_m(part, view.origin);
        let seen = Seen::new(part, view.origin);
        let (distances, _) = self.distance.as_chunks_mut::<LANES>();
        let (parts, _) = self.part.as_chunks_mut::<LANES>();
        for y in bounds.y[0]..bounds.y[1] {
            let row = y * frame.width;
            // Whole spans: the pixels around are met or not as well as those in the bounds.
            let spans = (row + bounds.x[0]) / LANES..(row + bounds.x[1]).div_ceil(LANES);
            for ((limits, ids), rays) in distances[spans.clone()]
                .iter_mut()
                .zip(&mut parts[spans.clone()])
                .zip(&rays[spans])
            {
                if limits.iter().all(|&limit| limit <= nearest) {
                    continue;
                }
                let met = seen.distances(&view.to_world(rays), limits, textures);
                for i in 0..LANES {
                    let nearer = met[i] < limits[i];
                    limits[i] = if nearer { met[i] } else { limits[i] };
                    ids[i] = if nearer { id } else { ids[i] };
                }
            }
        }
    }
}

/// No point of the part is nearer than this.
pub(super) fn nearest_m(part: &Part, origin: [f32; 3]) -> f32 {
    let (dx, dy) = (origin[0] - part.base[0], origin[1] - part.base[1]);
    let x = (dx * part.cos + dy * part.sin).abs() - part.half[0];
    let y = (dy * part.cos - dx * part.sin).abs()
        - if part.shape == Shape::Post {
            part.half[0]
        } else {
            part.half[1]
        };
    x.max(0.0).hypot(y.max(0.0))
}
