//! `I(p)`: does a pixel's ray meet the road plane before any box.
//!
//! In: a plane and boxes in camera space. Out: `[H, W] u8` each: the indicator (1 = road plane first) and the [`Surface`].
//! Invariant: equal to testing every ray against the plane and every box. Cost: the plane once a pixel, each box once a
//! pixel of the tiles that its bounding sphere may touch. A box around the camera itself is ignored: the car is not in it.
//! Source: the paper's indicator function for `D1`.

#![allow(clippy::cast_possible_truncation, reason = "rays and metres fit f32")]

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::Vector3;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::ObstacleBox;
use crate::frame::RayTable;
use crate::space::Plane;

/// What a ray meets first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Surface {
    /// Neither the plane within range nor a box.
    Nothing = 0,
    /// The road plane.
    Plane = 1,
    /// A box.
    Box = 2,
}

const TILE_WIDTH: usize = 32;
const TILE_HEIGHT: usize = 8;
/// Distance of a ray that does not meet the plane.
const FAR: f32 = f32::INFINITY;

/// A tile of pixels with the cone that holds their rays.
#[derive(Clone, Copy, Debug)]
struct Tile {
    x: usize,
    y: usize,
    axis: Vector3<f32>,
    half_angle_rad: f32,
}

/// Casts the rays of one image.
#[derive(Clone, Debug)]
pub struct RayCaster {
    width: usize,
    height: usize,
    /// Ray components, each `[H, W]`, for the vector unit.
    x: Box<[f32]>,
    y: Box<[f32]>,
    z: Box<[f32]>,
    distance_m: Box<[f32]>,
    tiles: Box<[Tile]>,
    max_range_m: f32,
}

/// A box in the form of the slab test.
struct Slabs {
    axes: [[f32; 3]; 3],
    low: [f32; 3],
    high: [f32; 3],
}

impl RayCaster {
    /// Casts `rays` as far as `max_range_m`.
    #[must_use]
    pub fn new(rays: &RayTable, max_range_m: f32) -> Self {
        let component = |i: usize| rays.rays().iter().map(|r| r[i]).collect::<Box<[f32]>>();
        let (width, height) = (rays.width(), rays.height());
        let mut tiles = vec![];
        for y in (0..height).step_by(TILE_HEIGHT) {
            for x in (0..width).step_by(TILE_WIDTH) {
                tiles.push(tile(rays, x, y));
            }
        }
        Self {
            width,
            height,
            x: component(0),
            y: component(1),
            z: component(2),
            distance_m: vec![FAR; width * height].into_boxed_slice(),
            tiles: tiles.into_boxed_slice(),
            max_range_m,
        }
    }

    /// Distance along each ray to the plane in the last cast, infinite where it was not met within range, `[H, W]`.
    #[must_use]
    pub fn plane_distance_m(&self) -> &[f32] {
        &self.distance_m
    }

    /// Ray components of pixel `index`.
    #[must_use]
    pub fn ray(&self, index: usize) -> Vector3<f32> {
        Vector3::new(self.x[index], self.y[index], self.z[index])
    }

    /// Writes what each pixel's ray meets first; without a plane, boxes alone.
    pub fn cast(
        &mut self,
        plane_in_camera: Option<&Plane>,
        boxes_in_camera: &[ObstacleBox],
        indicator: &mut [u8],
        surface: &mut [u8],
    ) {
        self.meet_plane(plane_in_camera);
        for (surface, &distance_m) in surface.iter_mut().zip(&self.distance_m) {
            *surface = if distance_m < FAR {
                Surface::Plane as u8
            } else {
                Surface::Nothing as u8
            };
        }
        for obstacle in boxes_in_camera {
            let to_camera = -(obstacle.axes.transpose() * obstacle.centre.coords);
            let outside = (0..3).any(|i| to_camera[i].abs() > obstacle.half_m[i]);
            let finite = to_camera.iter().chain(&obstacle.half_m).all(|v| v.is_finite());
            if outside && finite {
                self.meet_box(obstacle, &to_camera, surface);
            }
        }
        for (indicator, &surface) in indicator.iter_mut().zip(surface.iter()) {
            *indicator = u8::from(surface == Surface::Plane as u8);
        }
    }

    fn meet_plane(&mut self, plane: Option<&Plane>) {
        let Some(plane) = plane.filter(|p| p.offset_m > 0.0) else {
            self.distance_m.fill(FAR);
            return;
        };
        let normal: Vector3<f32> = plane.normal.cast();
        let offset_m = plane.offset_m as f32;
        let max_range_m = self.max_range_m;
        let rays = self.x.iter().zip(&self.y).zip(&self.z);
        for (distance_m, ((x, y), z)) in self.distance_m.iter_mut().zip(rays) {
            let descent = -(normal.x * x + normal.y * y + normal.z * z);
            let met_m = offset_m / descent;
            // A ray that rises gives a negative distance, a level one an infinite or undefined one.
            *distance_m = if met_m > 0.0 && met_m <= max_range_m {
                met_m
            } else {
                FAR
            };
        }
    }

    fn meet_box(&self, obstacle: &ObstacleBox, to_camera: &Vector3<f64>, surface: &mut [u8]) {
        let distance_m = obstacle.centre.coords.norm();
        let radius_m = obstacle.half_m.norm();
        let towards: Vector3<f32> = (obstacle.centre.coords / distance_m.max(1e-9)).cast();
        let sphere_rad = if distance_m > radius_m {
            (radius_m / distance_m).asin() as f32
        } else {
            core::f32::consts::PI
        };
        let axis = |i: usize| {
            let a = obstacle.axes.column(i);
            [a[0] as f32, a[1] as f32, a[2] as f32]
        };
        let bound = |side: f64| core::array::from_fn(|i| (side * obstacle.half_m[i] - to_camera[i]) as f32);
        let slabs = Slabs {
            axes: [axis(0), axis(1), axis(2)],
            low: bound(-1.0),
            high: bound(1.0),
        };
        for tile in &self.tiles {
            // A hair of slack for the rounding of the cones.
            let reach_rad = (tile.half_angle_rad + sphere_rad + 1e-3).min(core::f32::consts::PI);
            if tile.axis.dot(&towards) < reach_rad.cos() {
                continue;
            }
            for y in tile.y..(tile.y + TILE_HEIGHT).min(self.height) {
                let first = y * self.width + tile.x;
                let last = y * self.width + (tile.x + TILE_WIDTH).min(self.width);
                slabs.meet(
                    &self.x[first..last],
                    &self.y[first..last],
                    &self.z[first..last],
                    &self.distance_m[first..last],
                    &mut surface[first..last],
                );
            }
        }
    }
}

impl Slabs {
    /// Marks the rays that enter the box before they meet the plane. Written for the compiler to vectorise: `if` picks
    /// a lane, as `f32::min` would have to care for NaN.
    fn meet(&self, x: &[f32], y: &[f32], z: &[f32], plane_m: &[f32], surface: &mut [u8]) {
        let n = surface.len();
        let (x, y, z, plane_m) = (&x[..n], &y[..n], &z[..n], &plane_m[..n]);
        for i in 0..n {
            let (mut enter, mut leave) = (f32::NEG_INFINITY, FAR);
            for k in 0..3 {
                let [a, b, c] = self.axes[k];
                let along = 1.0 / (a * x[i] + b * y[i] + c * z[i]);
                let (s, t) = (self.low[k] * along, self.high[k] * along);
                let (near, far) = if s < t { (s, t) } else { (t, s) };
                enter = if near > enter { near } else { enter };
                leave = if far < leave { far } else { leave };
            }
            let blocks = (enter > 0.0) & (enter <= leave) & (enter < plane_m[i]);
            surface[i] = if blocks { Surface::Box as u8 } else { surface[i] };
        }
    }
}

/// The cone of a tile's rays; pixels without a ray do not count.
fn tile(rays: &RayTable, x: usize, y: usize) -> Tile {
    let columns = x..(x + TILE_WIDTH).min(rays.width());
    let members = || {
        let rows = y..(y + TILE_HEIGHT).min(rays.height());
        rows.flat_map({
            let columns = columns.clone();
            move |row| {
                columns
                    .clone()
                    .map(move |column| rays.rays()[row * rays.width() + column])
            }
        })
        .filter(|ray| ray.norm_squared() > 0.5)
    };
    let axis = members()
        .sum::<Vector3<f32>>()
        .try_normalize(1e-6)
        .unwrap_or_else(Vector3::z);
    // Angle by chord: the arc cosine loses small angles to rounding.
    let half_angle_rad = members()
        .map(|ray| 2.0 * (0.5 * (ray - axis).norm()).min(1.0).asin())
        .fold(0.0, f32::max);
    Tile {
        x,
        y,
        axis,
        half_angle_rad,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{BrownConrady, KannalaBrandt, Lens};
    use crate::priors::plane::tests::{Noise, mount};
    use crate::priors::{Ground, vehicle_forward};
    use alloc::vec::Vec;
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    fn lens(kind: u8) -> Lens {
        match kind % 3 {
            0 => Lens::pinhole(70.0, 70.0, 45.0, 30.0),
            1 => Lens::BrownConrady(BrownConrady {
                fx: 60.0,
                fy: 60.0,
                cx: 45.0,
                cy: 30.0,
                k: [-0.2, 0.04, 0.0],
                p: [0.001, 0.0],
            }),
            _ => Lens::KannalaBrandt(KannalaBrandt {
                fx: 40.0,
                fy: 40.0,
                cx: 45.0,
                cy: 30.0,
                k: [-0.01, 0.002, 0.0, 0.0],
            }),
        }
    }

    fn random_boxes(seed: u64, ground: &Ground) -> Vec<ObstacleBox> {
        let mut noise = Noise(seed);
        (0..8)
            .map(|_| {
                let (sin, cos) = noise.between(0.0, 3.0).sin_cos();
                let half_m = Vector3::new(
                    noise.between(0.1, 3.0),
                    noise.between(0.1, 3.0),
                    noise.between(0.2, 1.8),
                );
                let on = ground.point(noise.between(-2.0, 35.0), noise.between(-12.0, 12.0));
                ObstacleBox {
                    centre: on + ground.up * half_m.z,
                    axes: Matrix3::from_columns(&[
                        ground.ahead * cos + ground.left * sin,
                        ground.left * cos - ground.ahead * sin,
                        ground.up,
                    ]),
                    half_m,
                }
            })
            .collect()
    }

    /// Distance at which a ray enters a box, by its six faces; none where it misses or starts inside.
    fn enters(obstacle: &ObstacleBox, ray: &Vector3<f64>) -> Option<f64> {
        let inside = |p: &Vector3<f64>, slack: f64| {
            let local = obstacle.axes.transpose() * (p - obstacle.centre.coords);
            (0..3).all(|i| local[i].abs() <= obstacle.half_m[i] + slack)
        };
        if inside(&Vector3::zeros(), 0.0) {
            return None;
        }
        let mut nearest = f64::INFINITY;
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let normal = obstacle.axes.column(axis).into_owned();
                let at = normal.dot(&obstacle.centre.coords) + side * obstacle.half_m[axis];
                let distance = at / normal.dot(ray);
                if distance > 0.0 && inside(&(ray * distance), 1e-9) {
                    nearest = nearest.min(distance);
                }
            }
        }
        (nearest < f64::INFINITY).then_some(nearest)
    }

    fn first_surface(plane: &Plane, boxes: &[ObstacleBox], ray: &Vector3<f64>) -> Surface {
        let plane_m = plane.ray_distance(ray).filter(|&d| d <= 60.0);
        let box_m = boxes
            .iter()
            .filter_map(|b| enters(b, ray))
            .fold(f64::INFINITY, f64::min);
        match plane_m {
            Some(d) if d <= box_m => Surface::Plane,
            _ if box_m < f64::INFINITY => Surface::Box,
            _ => Surface::Nothing,
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn equals_every_ray_against_everything(seed: u64, kind: u8) {
            let rays = RayTable::new(&lens(kind), 91, 61);
            let plane = mount().plane_in_camera();
            let boxes = random_boxes(seed, &Ground::new(&plane, &vehicle_forward(&mount())));
            let (mut indicator, mut surface) = (vec![9; 91 * 61], vec![9; 91 * 61]);
            RayCaster::new(&rays, 60.0).cast(Some(&plane), &boxes, &mut indicator, &mut surface);
            for (index, ray) in rays.rays().iter().enumerate() {
                let ray: Vector3<f64> = ray.cast();
                let truth = first_surface(&plane, &boxes, &ray);
                if surface[index] != truth as u8 {
                    // Rounding may move an edge by a hair: some ray next to this one must see it the other way.
                    let seen = (0..16).any(|turn| {
                        let (sin, cos) = (f64::from(turn) * core::f64::consts::FRAC_PI_8).sin_cos();
                        let near = (ray + Vector3::new(cos, sin, 0.3 * cos - 0.2 * sin) * 2e-5).normalize();
                        first_surface(&plane, &boxes, &near) as u8 == surface[index]
                    });
                    prop_assert!(seen, "pixel {} is {} not {:?}", index, surface[index], truth);
                }
                prop_assert_eq!(indicator[index], u8::from(surface[index] == 1));
            }
        }
    }

    #[test]
    fn without_a_plane_nothing_is_road() {
        let rays = RayTable::new(&lens(0), 91, 61);
        let (mut indicator, mut surface) = (vec![9; 91 * 61], vec![9; 91 * 61]);
        RayCaster::new(&rays, 60.0).cast(None, &[], &mut indicator, &mut surface);
        assert!(indicator.iter().chain(&surface).all(|&v| v == 0));
    }
}
