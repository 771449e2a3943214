//! Renders a chessboard through a lens, for tests: every pixel's ray meets the board's plane, with several rays a pixel.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "tests"
)]

use freespace::frame::{GrayImage, Lens};
use freespace::space::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector2, Vector3};

use super::Board;
use crate::config::ImageSize;

pub(super) struct Scene {
    pub(super) lens: Lens,
    pub(super) size: ImageSize,
    pub(super) board: Board,
    pub(super) square_m: f64,
    /// Gaussian blur of the optics, pixels.
    pub(super) blur_px: f64,
    /// Noise of the sensor, gray levels.
    pub(super) noise: f64,
}

/// A small generator; the same seed gives the same pictures.
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn unit(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.unit()).sum::<f64>() - 6.0
    }
}

/// A board whose centre lies at `at_m` in camera space, turned by `tilt` about x, y and z.
pub(super) fn pose(scene: &Scene, at_m: Vector3<f64>, tilt: Vector3<f64>) -> Pose {
    let turn = UnitQuaternion::from_euler_angles(tilt.x, tilt.y, tilt.z);
    let centre = Vector3::new(
        0.5 * (scene.board.columns as f64 - 1.0) * scene.square_m,
        0.5 * (scene.board.rows as f64 - 1.0) * scene.square_m,
        0.0,
    );
    Pose::from_parts(Translation3::from(at_m - turn * centre), turn)
}

/// Brightness of the board's plane: squares, a white margin, and a gray wall beyond with coarse texture.
fn brightness(scene: &Scene, x: f64, y: f64) -> f64 {
    let (column, row) = (
        (x / scene.square_m + 1.0).floor(),
        (y / scene.square_m + 1.0).floor(),
    );
    let (columns, rows) = (scene.board.columns as f64 + 1.0, scene.board.rows as f64 + 1.0);
    let inside =
        |margin: f64| column >= -margin && row >= -margin && column < columns + margin && row < rows + margin;
    if inside(0.0) {
        if (column + row).rem_euclid(2.0) < 0.5 {
            40.0
        } else {
            210.0
        }
    } else if inside(1.0) {
        215.0
    } else {
        110.0 + 25.0 * (x * 9.0).sin() * (y * 7.0).cos()
    }
}

/// The picture of a board.
pub(super) fn render(scene: &Scene, camera_from_board: Option<&Pose>, random: &mut Random) -> GrayImage {
    let (width, height) = (scene.size.width, scene.size.height);
    let mut values = vec![110.0; width * height];
    let rays = 3;
    if let Some(pose) = camera_from_board {
        let board_from_camera = pose.inverse();
        for (i, value) in values.iter_mut().enumerate() {
            let mut sum = 0.0;
            for sub in 0..rays * rays {
                let offset = |k: usize| (k as f64 + 0.5) / rays as f64 - 0.5;
                let pixel = Vector2::new(
                    (i % width) as f64 + offset(sub % rays),
                    (i / width) as f64 + offset(sub / rays),
                );
                sum += scene.lens.unproject(&pixel).map_or(60.0, |ray| {
                    let direction = board_from_camera.rotation * ray;
                    let origin = board_from_camera.translation.vector;
                    let distance = -origin.z / direction.z;
                    let hit = origin + direction * distance;
                    if distance > 0.0 {
                        brightness(scene, hit.x, hit.y)
                    } else {
                        60.0
                    }
                });
            }
            *value = sum / (rays * rays) as f64;
        }
    }
    let blurred = blur(&values, width, height, scene.blur_px);
    let mut image = GrayImage::new(width, height);
    for (to, from) in image.pixels_mut().iter_mut().zip(blurred) {
        *to = (from + scene.noise * random.normal()).round().clamp(0.0, 255.0) as u8;
    }
    image
}

fn blur(values: &[f64], width: usize, height: usize, sigma: f64) -> Vec<f64> {
    if sigma <= 0.0 {
        return values.to_vec();
    }
    let half = (3.0 * sigma).ceil() as i64;
    let kernel: Vec<f64> = (-half..=half)
        .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp())
        .collect();
    let sum: f64 = kernel.iter().sum();
    let pass = |from: &[f64], dx: i64, dy: i64| -> Vec<f64> {
        (0..(width * height) as i64)
            .map(|at| {
                let (x, y) = (at % width as i64, at / width as i64);
                kernel
                    .iter()
                    .zip(-half..)
                    .map(|(k, i)| {
                        let column = (x + dx * i).clamp(0, width as i64 - 1);
                        let row = (y + dy * i).clamp(0, height as i64 - 1);
                        k * from[(row * width as i64 + column) as usize]
                    })
                    .sum::<f64>()
                    / sum
            })
            .collect()
    };
    let along = pass(values, 1, 0);
    pass(&along, 0, 1)
}

/// Poses that a careful person would take: all over the image, `reach` of its size to each side, turned to all sides.
pub(super) fn careful_poses(scene: &Scene, count: usize, reach: f64, random: &mut Random) -> Vec<Pose> {
    let focal = scene.lens.focal_px();
    (0..count)
        .map(|i| {
            let board_m = scene.board.columns as f64 * scene.square_m;
            let wanted_px = random.between(0.35, 0.6) * scene.size.width as f64;
            let distance = focal * board_m / wanted_px;
            let column = (0.5 + reach * [-1.0, 0.0, 1.0][i % 3]) * scene.size.width as f64;
            let row = (0.5 + reach * [-0.8, 0.0, 0.8][i / 3 % 3]) * scene.size.height as f64;
            let ray = scene.lens.unproject(&Vector2::new(column, row)).unwrap();
            let tilt = Vector3::new(
                random.between(-0.6, 0.6),
                random.between(-0.6, 0.6),
                random.between(-0.4, 0.4),
            );
            pose(scene, ray * distance, tilt)
        })
        .collect()
}
