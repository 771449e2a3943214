//! The stage: one key frame's labels to the fused grid and its boundary.
//!
//! In, out, invariant and cost: see [`super`]. The vehicle's frame has the plane's normal as z and the camera's forward
//! axis, corrected by the mount's yaw and laid onto the plane, as x; its origin is the mount's.

#![allow(clippy::cast_possible_truncation, reason = "metres and radians fit f32")]

use nalgebra::{Vector2, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::boundary::Boundary;
use super::fusion::{Fusion, Motion};
use super::view::{CellView, Sight};
use super::{Grid, GridConfig};
use crate::frame::Camera;
use crate::space::{Micros, Plane, Pose};

/// Stage 7.
#[derive(Clone, Debug)]
pub struct GridStage {
    view: CellView,
    fusion: Fusion,
    grid: Grid,
    boundary: Boundary,
    pixels: usize,
    mount_ahead_m: f32,
    last: Option<(Pose, Micros)>,
}

/// A pose that jumps farther than this between key frames (120 m/s for half a second) is a new world: memory is dropped.
const LARGEST_MOTION_M: f32 = 60.0;

impl GridStage {
    /// The stage for a camera whose CRF image is `crf_width x crf_height`.
    #[must_use]
    pub fn new(camera: &Camera, config: GridConfig, crf_width: usize, crf_height: usize) -> Self {
        let (rows, columns, cell_m) = config.size();
        let grid = Grid::new(rows, columns, cell_m);
        let (right_rad, left_rad) = field_of_view(camera);
        Self {
            view: CellView::new(camera, config, crf_width, crf_height, &grid),
            fusion: Fusion::new(config, rows * columns),
            boundary: Boundary::new(right_rad, left_rad),
            grid,
            pixels: crf_width * crf_height,
            mount_ahead_m: camera.mount.ahead_m as f32,
            last: None,
        }
    }

    /// Fuses one key frame. `labels` (1 = road), `confidence` (`P(road)`), `vehicle` (probability) and `surface` (of the ray cast) are `[H, W]` at
    /// the CRF resolution; where their size is wrong the grid is moved and aged only.
    pub fn step(
        &mut self,
        labels: &[u8],
        confidence: &[f32],
        vehicle: &[f32],
        surface: &[u8],
        plane_in_camera: &Plane,
        world_from_vehicle: &Pose,
        stamp: Micros,
    ) -> &Grid {
        let seconds = self.shift(world_from_vehicle, stamp);
        let whole = [labels.len(), confidence.len(), vehicle.len(), surface.len()] == [self.pixels; 4];
        let plane_known =
            plane_in_camera.offset_m > 0.0 && plane_in_camera.normal.iter().all(|v| v.is_finite());
        if whole && plane_known {
            self.view
                .look(labels, confidence, vehicle, surface, plane_in_camera, &self.grid);
            self.fusion.fuse(
                seconds,
                Some((&self.view.evidence, &self.view.sight)),
                &mut self.grid,
            );
        } else {
            self.fusion.fuse(seconds, None, &mut self.grid);
        }
        self.boundary.read(&self.grid, self.blind_m());
        &self.grid
    }

    /// Takes a published grid as the last one, for [`Self::carry`] to start from.
    pub fn adopt(&mut self, grid: &Grid, world_from_vehicle: &Pose, stamp: Micros) {
        self.fusion.adopt(grid);
        self.last = Some((*world_from_vehicle, stamp));
    }

    /// Moves and ages the last grid to a pose and time, without a new look (the ladder's "last grid moved").
    pub fn carry(&mut self, world_from_vehicle: &Pose, stamp: Micros) -> &Grid {
        let seconds = self.shift(world_from_vehicle, stamp);
        self.fusion.fuse(seconds, None, &mut self.grid);
        self.boundary.read(&self.grid, self.blind_m());
        &self.grid
    }

    /// The latest grid.
    #[must_use]
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The free distance by bearing, from the vehicle's origin.
    #[must_use]
    pub const fn boundary(&self) -> &Boundary {
        &self.boundary
    }

    fn shift(&mut self, world_from_vehicle: &Pose, stamp: Micros) -> f32 {
        let Some((last, last_stamp)) = self.last.replace((*world_from_vehicle, stamp)) else {
            return 0.0;
        };
        let last_from_now = last.inverse() * world_from_vehicle;
        let ahead = last_from_now.rotation * Vector3::x();
        let seconds = stamp.seconds_since(last_stamp).clamp(0.0, 3600.0) as f32;
        let motion = Motion {
            ahead_m: last_from_now.translation.x as f32,
            left_m: last_from_now.translation.y as f32,
            yaw_rad: ahead.y.atan2(ahead.x) as f32,
            seconds,
        };
        if motion.ahead_m.hypot(motion.left_m) < LARGEST_MOTION_M && motion.yaw_rad.is_finite() {
            self.fusion.shift(&motion, &self.grid);
        } else {
            self.fusion.clear();
        }
        motion.seconds
    }

    /// Distance from the origin to the nearest ground in view straight ahead, with a little margin for pitching.
    fn blind_m(&self) -> f32 {
        let middle = self.grid.columns / 2;
        let covered = |row: usize| self.view.sight[row * self.grid.columns + middle] != Sight::Covered;
        let first = (0..self.grid.rows)
            .find(|&row| self.grid.centre(row, middle).0 > self.mount_ahead_m && covered(row))
            .unwrap_or(0);
        self.grid.centre(first, middle).0 + 1.0
    }
}

/// Bearings of the right and left image edges at the principal row, in the vehicle's frame.
fn field_of_view(camera: &Camera) -> (f32, f32) {
    let vehicle_from_camera = camera.mount.vehicle_from_camera();
    let bearing = |x: f64, fallback: f64| {
        let ray = camera
            .lens
            .unproject(&Vector2::new(x, 0.5 * camera.height as f64));
        ray.map_or(fallback, |ray| {
            let v = vehicle_from_camera.rotation * ray;
            v.y.atan2(v.x)
        }) as f32
    };
    let wide = core::f64::consts::FRAC_PI_3;
    (bearing(camera.width as f64 - 1.0, -wide), bearing(0.0, wide))
}
