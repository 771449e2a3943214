//! A brightness image in single precision: blur, half size, samples between pixels.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use freespace::frame::GrayImage;

/// `[height, width] f32`, row-major.
#[derive(Clone, Debug)]
pub(super) struct Plane {
    width: usize,
    height: usize,
    values: Box<[f32]>,
}

impl Plane {
    pub(super) fn from_gray(image: &GrayImage) -> Self {
        Self {
            width: image.width(),
            height: image.height(),
            values: image.pixels().iter().map(|&value| f32::from(value)).collect(),
        }
    }

    pub(super) const fn width(&self) -> usize {
        self.width
    }

    pub(super) const fn height(&self) -> usize {
        self.height
    }

    pub(super) fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.width + x]
    }

    /// Between the pixels; none outside.
    pub(super) fn sample(&self, x: f64, y: f64) -> Option<f32> {
        let inside = x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f64 && y < (self.height - 1) as f64;
        if !inside {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (right, down) = ((x - column as f64) as f32, (y - row as f64) as f32);
        let along = |row: usize| self.at(column, row) * (1.0 - right) + self.at(column + 1, row) * right;
        Some(along(row) * (1.0 - down) + along(row + 1) * down)
    }

    /// Gaussian blur; the edge pixels go on outside.
    pub(super) fn blurred(&self, sigma_px: f32) -> Self {
        let half = (3.0 * sigma_px).ceil() as isize;
        let mut kernel: Vec<f32> = (-half..=half)
            .map(|i| (-0.5 * (i as f32 / sigma_px).powi(2)).exp())
            .collect();
        let sum: f32 = kernel.iter().sum();
        kernel.iter_mut().for_each(|weight| *weight /= sum);
        self.convolved(&kernel, half, (1, 0))
            .convolved(&kernel, half, (0, 1))
    }

    fn convolved(&self, kernel: &[f32], half: isize, (dx, dy): (isize, isize)) -> Self {
        let (width, height) = (self.width as isize, self.height as isize);
        let mut values = vec![0.0; self.values.len()].into_boxed_slice();
        for y in 0..height {
            for x in 0..width {
                let is_inside = dx * (x - half) >= 0
                    && dx * (x + half) < width
                    && dy * (y - half) >= 0
                    && dy * (y + half) < height;
                let at = y * width + x;
                let step = dx + dy * width;
                values[at as usize] = if is_inside {
                    let first = at - half * step;
                    (0..)
                        .zip(kernel)
                        .map(|(i, k)| k * self.values[(first + i * step) as usize])
                        .sum()
                } else {
                    let clamped = |i: isize| {
                        let column = (x + dx * i).clamp(0, width - 1);
                        let row = (y + dy * i).clamp(0, height - 1);
                        self.values[(row * width + column) as usize]
                    };
                    (-half..).zip(kernel).map(|(i, k)| k * clamped(i)).sum()
                };
            }
        }
        Self { values, ..*self }
    }

    /// Half the size: each pixel the mean of four.
    pub(super) fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let sum = self.at(2 * x, 2 * y)
                    + self.at(2 * x + 1, 2 * y)
                    + self.at(2 * x, 2 * y + 1)
                    + self.at(2 * x + 1, 2 * y + 1);
                values.push(0.25 * sum);
            }
        }
        Self {
            width,
            height,
            values: values.into_boxed_slice(),
        }
    }
}
