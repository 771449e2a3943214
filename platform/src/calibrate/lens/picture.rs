//! Pictures for a person: the corners found in each picture, how far each is off, and all of them over the image.

use std::path::{Path, PathBuf};

use freespace::frame::GrayImage;
use image::{Rgb, RgbImage};
use nalgebra::Vector2;

use super::folder::read_gray;
use super::{Calibration, View};
use crate::bad_input::BadInput;
use crate::config::ImageSize;

/// Residuals are drawn this much longer than they are.
pub const MAGNIFIED: f64 = 40.0;
const FOUND: Rgb<u8> = Rgb([60, 220, 120]);
const LEFT_OUT: Rgb<u8> = Rgb([255, 80, 60]);
const RESIDUAL: Rgb<u8> = Rgb([255, 210, 60]);

/// Why a picture was not written.
#[derive(Debug, thiserror::Error)]
pub enum DrawError {
    /// The source could not be read again.
    #[error(transparent)]
    Source(#[from] BadInput),
    /// The disk or the folder refuses.
    #[error("{file}: cannot be written: {reason}; give another folder with --out", file = .file.display())]
    Write {
        /// The picture.
        file: PathBuf,
        /// The system's words.
        reason: String,
    },
}

/// Writes `out/NAME.corners.png` for each view of `folder`, and `out/residuals.png` with all of them.
///
/// # Errors
/// [`DrawError`].
pub fn draw_all(
    folder: &Path,
    out: &Path,
    views: &[View],
    calibration: &Calibration,
    size: ImageSize,
) -> Result<(), DrawError> {
    std::fs::create_dir_all(out).map_err(|error| write_error(out, &error))?;
    let blank = |value| {
        GrayImage::new(size.width, size.height)
            .pixels()
            .iter()
            .flat_map(|_| [value; 3])
            .collect()
    };
    let mut all = canvas(size, blank(30))?;
    for (view, residuals) in views.iter().zip(&calibration.residuals) {
        let gray = read_gray(&folder.join(&view.name))?;
        let mut picture = canvas(size, gray.pixels().iter().flat_map(|value| [*value; 3]).collect())?;
        mark(&mut picture, view, residuals);
        mark(&mut all, view, residuals);
        save(&picture, &out.join(format!("{}.corners.png", view.name)))?;
    }
    save(&all, &out.join("residuals.png"))
}

fn write_error(file: &Path, reason: &dyn std::fmt::Display) -> DrawError {
    DrawError::Write {
        file: file.to_owned(),
        reason: reason.to_string(),
    }
}

fn canvas(size: ImageSize, bytes: Vec<u8>) -> Result<RgbImage, DrawError> {
    let side = |value: usize| u32::try_from(value).unwrap_or(0);
    RgbImage::from_raw(side(size.width), side(size.height), bytes)
        .ok_or_else(|| write_error(Path::new("picture"), &"its size changed"))
}

fn save(picture: &RgbImage, file: &Path) -> Result<(), DrawError> {
    picture.save(file).map_err(|error| write_error(file, &error))
}

fn mark(picture: &mut RgbImage, view: &View, residuals: &[Option<Vector2<f64>>]) {
    for (sighting, residual) in view.sightings.iter().zip(residuals) {
        let at = sighting.pixel;
        let colour = if residual.is_some() { FOUND } else { LEFT_OUT };
        let arm = 4.0;
        line(
            picture,
            at - Vector2::new(arm, 0.0),
            at + Vector2::new(arm, 0.0),
            colour,
        );
        line(
            picture,
            at - Vector2::new(0.0, arm),
            at + Vector2::new(0.0, arm),
            colour,
        );
        if let Some(residual) = residual {
            line(picture, at, at + residual * MAGNIFIED, RESIDUAL);
        }
    }
}

/// A line; what lies outside is left out.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "pixels, checked to lie inside"
)]
fn line(picture: &mut RgbImage, from: Vector2<f64>, to: Vector2<f64>, colour: Rgb<u8>) {
    let longest = f64::from(picture.width() + picture.height());
    let steps = (to - from).amax().clamp(1.0, longest).ceil() as u32;
    for step in 0..=steps {
        let at = from + (to - from) * (f64::from(step) / f64::from(steps));
        let (x, y) = (at.x.round(), at.y.round());
        if x >= 0.0 && y >= 0.0 && x < f64::from(picture.width()) && y < f64::from(picture.height()) {
            picture.put_pixel(x as u32, y as u32, colour);
        }
    }
}
