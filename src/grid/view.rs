//! What one key frame says about each cell.
//!
//! In: labels, probabilities and surfaces, the plane. Out: evidence in log-odds and a [`Sight`] a cell.
//! Invariant: a cell gets free evidence only where its own pixel is labelled road. Cost: one projection a cell.
//! The order in which a bearing's cells are walked is fixed by the mount, and sorted once.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "cell numbers are below MAX_CELLS, pixels inside the image"
)]

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use nalgebra::Vector3;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::{Grid, GridConfig, Reason};
use crate::frame::{Camera, Lens};
use crate::priors::{Ground, Surface, vehicle_forward};
use crate::space::Plane;

/// How a cell stands to the camera now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Sight {
    /// Outside the image.
    #[default]
    Outside,
    /// Under the lower image edge: the bonnet, or the ground before it.
    Covered,
    /// Behind what blocks the ray.
    Hidden,
    /// Its pixel speaks about it.
    Seen(Reason),
}

/// Bearing bins of a full turn around the camera: one degree.
const BEARINGS: usize = 360;

/// Evidence of one key frame.
#[derive(Clone, Debug)]
pub(super) struct CellView {
    lens: Lens,
    forward: Vector3<f64>,
    mount_ahead_m: f64,
    mount_left_m: f64,
    width: usize,
    height: usize,
    config: GridConfig,
    /// Cells by bearing from the camera, then by range.
    order: Box<[u32]>,
    /// First place in `order` of each bearing; one more at the end.
    first: Box<[u32]>,
    pixel: Box<[u32]>,
    /// Pixel of the point that a vehicle's lower edge would have over each cell.
    bumper: Box<[u32]>,
    pub(super) evidence: Box<[f32]>,
    pub(super) sight: Box<[Sight]>,
}

const NO_PIXEL: u32 = u32::MAX;
const COVERED_PIXEL: u32 = u32::MAX - 1;
/// Half the width of a wide car.
const COVERED_HALF_M: f32 = 1.2;

impl CellView {
    pub(super) fn new(camera: &Camera, config: GridConfig, width: usize, height: usize, grid: &Grid) -> Self {
        let scale = |crf: usize, full: usize| crf as f64 / full.max(1) as f64;
        let cells = grid.rows * grid.columns;
        let mut keyed: Vec<(u32, f32, u32)> = (0..cells)
            .map(|cell| {
                let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
                let (x, y) = (x - camera.mount.ahead_m as f32, y - camera.mount.left_m as f32);
                let turn = y.atan2(x) / core::f32::consts::TAU + 0.5;
                let bin = ((turn * BEARINGS as f32) as u32).min(BEARINGS as u32 - 1);
                (bin, x.hypot(y), cell as u32)
            })
            .collect();
        keyed.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        let first = (0..=BEARINGS)
            .map(|bin| keyed.partition_point(|k| (k.0 as usize) < bin) as u32)
            .collect();
        Self {
            lens: camera
                .lens
                .scaled(scale(width, camera.width), scale(height, camera.height)),
            forward: vehicle_forward(&camera.mount),
            mount_ahead_m: camera.mount.ahead_m,
            mount_left_m: camera.mount.left_m,
            width,
            height,
            config,
            order: keyed.iter().map(|k| k.2).collect(),
            first,
            pixel: vec![NO_PIXEL; cells].into_boxed_slice(),
            bumper: vec![NO_PIXEL; cells].into_boxed_slice(),
            evidence: vec![0.0; cells].into_boxed_slice(),
            sight: vec![Sight::Outside; cells].into_boxed_slice(),
        }
    }

    /// Reads one key frame. `confidence` is `P(road)`.
    pub(super) fn look(
        &mut self,
        labels: &[u8],
        confidence: &[f32],
        vehicle: &[f32],
        surface: &[u8],
        plane_in_camera: &Plane,
        grid: &Grid,
    ) {
        self.project(plane_in_camera, grid);
        for bearing in 0..BEARINGS {
            self.walk(
                bearing,
                labels,
                confidence,
                vehicle,
                surface,
                plane_in_camera,
                grid,
            );
        }
    }

    fn project(&mut self, plane_in_camera: &Plane, grid: &Grid) {
        let ground = Ground::new(plane_in_camera, &self.forward);
        for row in 0..grid.rows {
            for column in 0..grid.columns {
                let (x, y) = grid.centre(row, column);
                let point = ground.point(
                    f64::from(x) - self.mount_ahead_m,
                    f64::from(y) - self.mount_left_m,
                );
                let pixel = self.pixel_of(&point.coords);
                // Beside the car others move: only what it drives over itself counts as covered.
                let beside = pixel == COVERED_PIXEL && y.abs() > COVERED_HALF_M;
                self.pixel[row * grid.columns + column] = if beside { NO_PIXEL } else { pixel };
                let over = point.coords + ground.up * f64::from(self.config.clearance_m);
                self.bumper[row * grid.columns + column] = self.pixel_of(&over);
            }
        }
    }

    fn pixel_of(&self, point: &Vector3<f64>) -> u32 {
        let Some(pixel) = self.lens.project(point) else {
            // Below or behind the camera: where the car stands.
            return COVERED_PIXEL;
        };
        let (x, y) = (pixel.x.round(), pixel.y.round());
        // A NaN is in no range and no pixel.
        let across = (0.0..self.width as f64).contains(&x);
        if y >= self.height as f64 {
            COVERED_PIXEL
        } else if across && y >= 0.0 {
            (y as usize * self.width + x as usize) as u32
        } else {
            NO_PIXEL
        }
    }

    /// From the camera outwards: road is free, the first not-road after it is what blocks, and what lies behind that
    /// is hidden unless the plane is seen there.
    fn walk(
        &mut self,
        bearing: usize,
        labels: &[u8],
        confidence: &[f32],
        vehicle: &[f32],
        surface: &[u8],
        plane: &Plane,
        grid: &Grid,
    ) {
        let focal_px = self.lens.focal_px() as f32;
        let height_m = plane.offset_m.max(0.1) as f32;
        // Range of the nearest edge of what is not road now; none while on road.
        let mut edge_m: Option<f32> = None;
        let mut box_foot_m: Option<f32> = None;
        for place in self.first[bearing] as usize..self.first[bearing + 1] as usize {
            let cell = self.order[place] as usize;
            let pixel = self.pixel[cell];
            if pixel >= COVERED_PIXEL {
                self.sight[cell] = if pixel == COVERED_PIXEL {
                    Sight::Covered
                } else {
                    Sight::Outside
                };
                continue;
            }
            let pixel = pixel as usize;
            let (x, y) = grid.centre(cell / grid.columns, cell % grid.columns);
            let range_m = (x - self.mount_ahead_m as f32).hypot(y - self.mount_left_m as f32);
            let p = confidence[pixel];
            let p = if p.is_finite() { p.clamp(0.0, 1.0) } else { 0.5 };
            // Metres of road in one image row: far cells share their row with many others.
            let row_span_m = range_m * range_m / (focal_px * height_m);
            let near = 1.0 / (1.0 + (row_span_m / self.config.row_span_m).powi(2));
            // The label is the energy's verdict; a network that doubts it weakens it to a half at most.
            let certainty = |p: f32| (2.0 * p - 1.0).max(0.5) * near;
            // The label weighed the box already: a box is wider than what stands in it.
            if labels[pixel] == 1 {
                (edge_m, box_foot_m) = (None, None);
                let bumper = self.bumper[cell];
                if bumper < COVERED_PIXEL && vehicle[bumper as usize] > 0.5 {
                    // One sees under a bumper onto the road that the car stands on.
                    self.sight[cell] = Sight::Hidden;
                    continue;
                }
                self.sight[cell] = Sight::Seen(Reason::Plane);
                self.evidence[cell] = -self.config.free_evidence * certainty(p);
                continue;
            }
            if surface[pixel] == Surface::Box as u8 {
                // The ray ends at the box: the first such cell is its foot, give or take a cell's diagonal.
                let foot_m = *box_foot_m.get_or_insert(range_m);
                if range_m - foot_m <= 1.5 * grid.cell_m {
                    self.sight[cell] = Sight::Seen(Reason::Box);
                    self.evidence[cell] = self.config.occupied_evidence * near;
                } else {
                    self.sight[cell] = Sight::Hidden;
                }
                continue;
            }
            box_foot_m = None;
            if surface[pixel] != Surface::Plane as u8 {
                self.sight[cell] = Sight::Hidden;
                continue;
            }
            let edge = *edge_m.get_or_insert(range_m);
            if range_m - edge <= self.config.flat_m {
                self.sight[cell] = Sight::Seen(Reason::Network);
                self.evidence[cell] = self.config.occupied_evidence * certainty(1.0 - p);
            } else {
                self.sight[cell] = Sight::Hidden;
            }
        }
    }
}
