//! What a calibration is worth, in words: what its pictures lack, and what to do about it.
//!
//! In: pictures, views, the calibration. Out: a [`Report`]. The bounds are those that practice has shown to matter; each stands
//! beside its constant.

use freespace::frame::Lens;
use nalgebra::Vector2;
use serde::Serialize;

use super::{Board, Calibration, Outcome, Picture, View};
use crate::config::{ImageSize, LensModel};

/// Fewer views than this leave the distortion to chance; 15 to 20 are the usual advice.
const FEW_VIEWS: usize = 10;
/// Views turned by more than this fix the focal length; frontal ones trade it against the distance.
const TILTED_DEG: f64 = 15.0;
/// So many of them are wanted about each axis of the image.
const WANTED_TILTED: usize = 2;
/// A corner, and an edge, of the image is covered by board corners in its outer quarter.
const OUTER: f64 = 0.25;
/// Side of the raster on which coverage is counted.
const RASTER: usize = 8;
/// Less of the image than this was never looked at by the lens.
const WANTED_COVERAGE: f64 = 0.6;
/// A good calibration of a sharp picture is below 0.5 px, and none is good above 1 px.
const FAIR_RMS_PX: f64 = 0.5;
const POOR_RMS_PX: f64 = 1.0;
/// The focal length's relative standard deviation that is still a good one.
const FAIR_FOCAL_SIGMA: f64 = 0.003;
/// A picture this many times worse than the median one has something wrong.
const ODD_PICTURE: f64 = 3.0;
/// From this field of view on a Brown-Conrady polynomial bends too little.
const WIDE_DEG: f64 = 110.0;

/// Something to know, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What is the matter.
    pub what: String,
    /// What to do about it.
    pub fix: String,
}

/// One picture of the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PictureReport {
    /// File name.
    pub name: String,
    /// `complete`, `partial`, `other_board` or `nothing`.
    pub outcome: &'static str,
    /// Corners found.
    pub corners: usize,
    /// Root mean square distance of corners seen and projected, pixels.
    pub rms_px: Option<f64>,
    /// Corners left out because they fit nothing.
    pub left_out: usize,
    /// Angle between the board and the image plane, degrees.
    pub tilt_deg: Option<f64>,
}

/// The calibration in numbers and words.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Root mean square distance of corners seen and projected, pixels.
    pub rms_px: f64,
    /// Views used.
    pub views: usize,
    /// Share of the image that board corners were seen in.
    pub coverage: f64,
    /// Horizontal field of view, degrees; none where the model does not reach the image's edge.
    pub hfov_deg: Option<f64>,
    /// Each picture.
    pub pictures: Vec<PictureReport>,
    /// What the calibration lacks; empty where it is good.
    pub findings: Vec<Finding>,
}

/// Judges a calibration of `views`, which are those of `pictures` in their order.
#[must_use]
pub fn judge(
    pictures: &[Picture],
    views: &[View],
    calibration: &Calibration,
    size: ImageSize,
    model: LensModel,
    board: &Board,
) -> Report {
    let pictures = picture_reports(pictures, calibration);
    let coverage = coverage(views, size);
    let hfov_deg = hfov_deg(&calibration.lens, size);
    let mut findings = Vec::new();
    let mut tell = |what: String, fix: &str| {
        findings.push(Finding {
            what,
            fix: fix.to_owned(),
        });
    };
    if views.len() < FEW_VIEWS {
        tell(
            format!("too few views: {}", views.len()),
            "take 15 to 20 pictures, each with the board in another place and at another angle",
        );
    }
    if let Some(what) = lacking_tilt(calibration) {
        tell(
            what,
            "turn the board 20 to 45 degrees away from the camera: some pictures to the left or right, some up or down",
        );
    }
    let uncovered = uncovered(views, size);
    if !uncovered.is_empty() {
        tell(
            format!("no board corner was seen {}", uncovered.join(", ")),
            "hold the board there too, partly outside the picture if need be: the distortion is largest there",
        );
    } else if coverage < WANTED_COVERAGE {
        tell(
            format!("board corners cover {:.0} % of the image", 100.0 * coverage),
            "hold the board in every part of the image, and nearer",
        );
    }
    if calibration.rms_px > FAIR_RMS_PX {
        let is_wide = model == LensModel::BrownConrady && hfov_deg.is_none_or(|angle| angle > WIDE_DEG);
        let what = format!("the corners are {:.2} px off in the mean", calibration.rms_px);
        let fix = if is_wide {
            "try --model kannala_brandt: the lens is wide; else see that the board is flat and the pictures are sharp"
        } else {
            "see that the board is flat, that it and the camera stand still in each picture, and that pictures are sharp"
        };
        tell(what, fix);
    }
    judge_focal(calibration, &mut tell);
    if hfov_deg.is_none() || !reaches_corners(&calibration.lens, size) {
        tell(
            "the model does not reach the corners of the image: the road there would be blind".to_owned(),
            "show the board in the image's corners, or use --model kannala_brandt for a wide lens",
        );
    }
    for odd in odd_pictures(&pictures, board) {
        tell(
            odd,
            "look at the picture (--out draws the corners); take it out of the folder if it is blurred or moved",
        );
    }
    Report {
        rms_px: calibration.rms_px,
        views: views.len(),
        coverage,
        hfov_deg,
        pictures,
        findings,
    }
}

impl Report {
    /// The verdict in a word or a few.
    #[must_use]
    pub fn verdict(&self) -> &'static str {
        if self.rms_px > POOR_RMS_PX {
            "poor: do not use it"
        } else if self.findings.is_empty() {
            "good"
        } else {
            "usable, with reservations"
        }
    }
}

fn picture_reports(pictures: &[Picture], calibration: &Calibration) -> Vec<PictureReport> {
    let mut used = calibration.residuals.iter().zip(&calibration.poses);
    pictures
        .iter()
        .map(|picture| {
            let outcome = match picture.outcome {
                Outcome::Complete(_) => "complete",
                Outcome::Partial(_) => "partial",
                Outcome::OtherBoard(..) => "other_board",
                Outcome::Nothing => "nothing",
            };
            let fit = picture.view().and_then(|_| used.next());
            PictureReport {
                name: picture.name.clone(),
                outcome,
                corners: picture.view().map_or(0, |view| view.sightings.len()),
                rms_px: fit.and_then(|(residuals, _)| rms(residuals)),
                left_out: fit.map_or(0, |(residuals, _)| {
                    residuals.iter().filter(|r| r.is_none()).count()
                }),
                tilt_deg: fit.map(|(_, pose)| {
                    (pose.rotation * nalgebra::Vector3::z())
                        .z
                        .abs()
                        .min(1.0)
                        .acos()
                        .to_degrees()
                }),
            }
        })
        .collect()
}

fn rms(residuals: &[Option<Vector2<f64>>]) -> Option<f64> {
    let squares: Vec<f64> = residuals.iter().flatten().map(Vector2::norm_squared).collect();
    #[expect(clippy::cast_precision_loss, reason = "corners")]
    let count = squares.len() as f64;
    (count > 0.0).then(|| (squares.iter().sum::<f64>() / count).sqrt())
}

/// Whether boards are turned enough about both axes of the image.
fn lacking_tilt(calibration: &Calibration) -> Option<String> {
    let bound = TILTED_DEG.to_radians().sin();
    let count = |axis: usize| {
        (calibration.poses.iter())
            .filter(|pose| (pose.rotation * nalgebra::Vector3::z())[axis].abs() > bound)
            .count()
    };
    let (sideways, upwards) = (count(0), count(1));
    let lacking = match (sideways < WANTED_TILTED, upwards < WANTED_TILTED) {
        (true, true) => "to the side or up and down",
        (true, false) => "to the side",
        (false, true) => "up or down",
        (false, false) => return None,
    };
    Some(format!(
        "the board is not turned enough {lacking}: the focal length rests on little"
    ))
}

fn judge_focal(calibration: &Calibration, tell: &mut impl FnMut(String, &str)) {
    let worst = (calibration.parameters.iter().take(2))
        .map(|parameter| parameter.sigma / parameter.value.abs())
        .fold(0.0, f64::max);
    if worst > FAIR_FOCAL_SIGMA {
        tell(
            format!("the focal length is known to {:.1} % only", 100.0 * worst),
            "take more pictures, with the board turned more and filling the image",
        );
    }
}

/// Corners and edges of the image where no board corner was seen.
#[expect(clippy::cast_precision_loss, reason = "image sizes")]
fn uncovered(views: &[View], size: ImageSize) -> Vec<&'static str> {
    let (width, height) = (size.width as f64, size.height as f64);
    let places = [
        ("at the top left", (0.0, 0.0)),
        ("at the top right", (1.0 - OUTER, 0.0)),
        ("at the bottom left", (0.0, 1.0 - OUTER)),
        ("at the bottom right", (1.0 - OUTER, 1.0 - OUTER)),
    ];
    let pixels = || views.iter().flat_map(|view| &view.sightings).map(|s| s.pixel);
    (places.into_iter())
        .filter(|(_, (left, top))| {
            let inside = |value: f64, from: f64| (from..=from + OUTER).contains(&value);
            !pixels().any(|pixel| inside(pixel.x / width, *left) && inside(pixel.y / height, *top))
        })
        .map(|(name, _)| name)
        .collect()
}

/// Share of a raster over the image in which board corners were seen.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "cells of a raster, clamped"
)]
fn coverage(views: &[View], size: ImageSize) -> f64 {
    let mut seen = [false; RASTER * RASTER];
    let cell = |value: f64, end: usize| {
        ((value / end as f64 * RASTER as f64).clamp(0.0, RASTER as f64 - 1.0)) as usize
    };
    for sighting in views.iter().flat_map(|view| &view.sightings) {
        seen[cell(sighting.pixel.y, size.height) * RASTER + cell(sighting.pixel.x, size.width)] = true;
    }
    seen.iter().filter(|seen| **seen).count() as f64 / (RASTER * RASTER) as f64
}

/// Angle between the rays of the left and the right edge, through the principal point's row.
#[expect(clippy::cast_precision_loss, reason = "image sizes")]
fn hfov_deg(lens: &Lens, size: ImageSize) -> Option<f64> {
    let row = 0.5 * (size.height as f64 - 1.0);
    let angle = |column: f64| {
        let ray = lens.unproject(&Vector2::new(column, row))?;
        Some(ray.x.atan2(ray.z))
    };
    Some((angle(size.width as f64 - 0.5)? - angle(-0.5)?).to_degrees())
}

#[expect(clippy::cast_precision_loss, reason = "image sizes")]
fn reaches_corners(lens: &Lens, size: ImageSize) -> bool {
    let (right, bottom) = (size.width as f64 - 1.0, size.height as f64 - 1.0);
    [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)]
        .into_iter()
        .all(|(x, y)| lens.unproject(&Vector2::new(x, y)).is_some())
}

fn odd_pictures(pictures: &[PictureReport], board: &Board) -> Vec<String> {
    let mut errors: Vec<f64> = pictures.iter().filter_map(|picture| picture.rms_px).collect();
    errors.sort_by(f64::total_cmp);
    let median = errors.get(errors.len() / 2).copied().unwrap_or_default();
    (pictures.iter())
        .filter_map(|picture| {
            let name = &picture.name;
            if picture.outcome == "other_board" {
                return Some(format!("{name}: its lattice is larger than {board}"));
            }
            let error = picture.rms_px?;
            (error > ODD_PICTURE * median.max(0.05) || 4 * picture.left_out > picture.corners)
                .then(|| format!("{name}: {error:.2} px off, {} corners left out", picture.left_out))
        })
        .collect()
}
