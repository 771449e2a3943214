//! What is true of a world: labels, and which cells of a grid are free, taken or out of sight.
//!
//! In: a world, a camera, a time. Out: labels as written by [`super::SimCamera`], and grids in vehicle space. A cell is
//! judged at its centre. Cost: one ray for every cell and part near that ray.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "cell counts are small and coordinates are metres"
)]

use freespace::frame::Camera;
use nalgebra::Point3;

use super::World;
use super::scene::Object;
use super::scene::{NEAR_M, Scene};
use super::shape::{Part, Seen, Shape};

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Label {
    /// Carriageway, parking bays, gutters, side streets, with everything painted on or let into them.
    Road = 0,
    /// Pavement, kerb, verge, lawn, yard.
    NonDrivable = 1,
    /// People.
    Living = 2,
    /// Cars and vans.
    Vehicle = 3,
    /// Posts, trunks, fences, low walls, guard rails.
    Roadside = 4,
    /// Houses, crowns, hedges, the far tree line.
    Far = 5,
    /// Sky.
    Sky = 6,
}

/// A grid ahead of the car: rows from the vehicle's origin ahead, columns from the right edge to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridSpec {
    /// Side of a cell.
    pub cell_m: f64,
    /// Reach ahead of the vehicle's origin.
    pub ahead_m: f64,
    /// Reach to either side.
    pub side_m: f64,
}

impl Default for GridSpec {
    fn default() -> Self {
        Self {
            cell_m: 0.2,
            ahead_m: 40.0,
            side_m: 12.0,
        }
    }
}

impl GridSpec {
    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        (self.ahead_m / self.cell_m).round() as usize
    }

    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        (2.0 * self.side_m / self.cell_m).round() as usize
    }

    /// Centre of a cell in vehicle space, metres ahead and to the left.
    #[must_use]
    pub fn centre(&self, row: usize, column: usize) -> (f64, f64) {
        (
            (row as f64 + 0.5) * self.cell_m,
            (column as f64 + 0.5) * self.cell_m - self.side_m,
        )
    }
}

/// Parts whose base lies higher than this do not take the ground below them.
const CLEARANCE_M: f32 = 1.9;

impl World {
    /// Free space at a time, `[rows, columns] i8`: 0 free road, 100 taken, -1 out of the camera's sight.
    ///
    /// A cell under an object is taken; it is in sight where nothing but that object hides it.
    #[must_use]
    pub fn free_space_truth(&self, camera: &Camera, seconds: f64, spec: &GridSpec) -> Vec<i8> {
        let ego = self.ego(seconds);
        let world_from_camera = self.world_from_camera(seconds, &camera.mount);
        let camera_from_world = world_from_camera.inverse();
        let eye = world_from_camera.translation.vector;
        let origin = [eye.x as f32, eye.y as f32, eye.z as f32];
        let mut movers = Scene::default();
        self.traffic
            .fill(&mut movers, &self.road, &self.style, ego.road_m, seconds);
        let s = ego.road_m as f32;
        let still = self
            .scene
            .between(s - NEAR_M, s + NEAR_M)
            .iter()
            .map(|o| (o, &self.scene.parts));
        let reach = (spec.ahead_m.hypot(spec.side_m) + 5.0) as f32;
        let near: Vec<(&Object, Vec<Seen<'_>>)> = still
            .chain(movers.objects.iter().map(|o| (o, &movers.parts)))
            .filter(|(o, _)| (o.centre[0] - origin[0]).hypot(o.centre[1] - origin[1]) - o.radius < reach)
            .map(|(o, parts)| {
                let own = &parts[o.first..o.first + o.count];
                (o, own.iter().map(|part| Seen::new(part, origin)).collect())
            })
            .collect();
        let mut grid = vec![-1; spec.rows() * spec.columns()];
        for row in 0..spec.rows() {
            for column in 0..spec.columns() {
                let (ahead, left) = spec.centre(row, column);
                let ground = ego.world_from_vehicle * Point3::new(ahead, left, 0.0);
                let (s, d) = self.road.locate(ground.x, ground.y);
                let on_road = self.road.edge(s as f32, d as f32) <= 0.0;
                let height = if on_road {
                    0.0
                } else {
                    f64::from(self.style.kerb_m)
                };
                let place = Point3::new(ground.x, ground.y, height);
                if !sees(camera, &(camera_from_world * place)) {
                    continue;
                }
                let target = [place.x as f32, place.y as f32, place.z as f32];
                let toward = [0, 1, 2].map(|k| target[k] - origin[k]);
                let far = (toward[0] * toward[0] + toward[1] * toward[1] + toward[2] * toward[2]).sqrt();
                let ray = toward.map(|c| c / far);
                let mut taken = !on_road;
                let mut seen = !on_road || !self.kerb_hides(origin, ray);
                for (object, parts) in &near {
                    if !beside(object, origin, target) {
                        continue;
                    }
                    if parts.iter().any(|seen| stands_on(seen.part, target)) {
                        taken = true;
                    } else if parts
                        .iter()
                        .any(|seen| seen.distance(ray, far - 0.01, &self.textures).is_some())
                    {
                        seen = false;
                        break;
                    }
                }
                if seen {
                    grid[row * spec.columns() + column] = if taken { 100 } else { 0 };
                }
            }
        }
        grid
    }

    /// Whether a raised pavement lies between the eye and a point on the road.
    fn kerb_hides(&self, origin: [f32; 3], ray: [f32; 3]) -> bool {
        if ray[2] >= 0.0 {
            return false;
        }
        let distance = (origin[2] - self.style.kerb_m) / -ray[2];
        let [x, y] = [0, 1].map(|k| f64::from(origin[k] + distance * ray[k]));
        let (s, d) = self.road.locate(x, y);
        self.road.edge(s as f32, d as f32) > 0.0
    }
}

/// Whether a point in camera space falls into the image.
fn sees(camera: &Camera, point: &Point3<f64>) -> bool {
    let (width, height) = (camera.width as f64, camera.height as f64);
    point.z > 0.1
        && camera
            .lens
            .project(&point.coords)
            .is_some_and(|p| (-0.5..width - 0.5).contains(&p.x) && (-0.5..height - 0.5).contains(&p.y))
}

/// Whether the line from the eye to a place comes near an object, seen from above.
fn beside(object: &Object, eye: [f32; 3], place: [f32; 3]) -> bool {
    let run = [place[0] - eye[0], place[1] - eye[1]];
    let to = [object.centre[0] - eye[0], object.centre[1] - eye[1]];
    let share = (to[0] * run[0] + to[1] * run[1]) / (run[0] * run[0] + run[1] * run[1]).max(1e-6);
    let share = share.clamp(0.0, 1.0);
    let off = [to[0] - share * run[0], to[1] - share * run[1]];
    let reach = object.radius + 0.1;
    off[0] * off[0] + off[1] * off[1] < reach * reach
}

/// Whether a part stands over a point of the ground.
fn stands_on(part: &Part, at: [f32; 3]) -> bool {
    if part.base[2] > CLEARANCE_M {
        return false;
    }
    let (dx, dy) = (at[0] - part.base[0], at[1] - part.base[1]);
    let x = (dx * part.cos + dy * part.sin) / part.half[0];
    let y = (dy * part.cos - dx * part.sin) / part.half_extent()[1];
    match part.shape {
        Shape::Frustum | Shape::Wheel => x.abs() <= 1.0 && y.abs() <= 1.0,
        Shape::Ellipsoid | Shape::Post => x * x + y * y <= 1.0,
    }
}
