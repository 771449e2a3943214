//! A lens and poses near enough to the truth for the refinement to find it.
//!
//! In: views, the model. Out: the best of a few lenses without distortion: Zhang's closed form, and for lenses whose
//! distortion defeats it a row of focal lengths about the picture's centre; best by the median reprojection error.

use freespace::frame::{KannalaBrandt, Lens};
use freespace::space::Pose;
use nalgebra::{Matrix3, Point3, Vector2};

use super::zhang::{Pinhole, closed_form, homography, pose};
use super::{Board, View};
use crate::config::{ImageSize, LensModel};

/// Focal lengths tried, from a fifth of the picture's width up, each larger by this factor.
const FOCAL_STEP: f64 = 1.12;
const FOCALS: i32 = 24;
/// Rays farther from the axis than this are no points of a plane before the camera.
const WIDEST_SLOPE: f64 = 8.0;

/// A lens and the pose of each view's board, `camera_from_board`; none where no lens explains the views at all.
pub(super) fn start(
    views: &[View],
    square_m: f64,
    size: ImageSize,
    model: LensModel,
) -> Option<(Lens, Vec<Pose>)> {
    candidates(views, square_m, size, model)
        .into_iter()
        .filter_map(|lens| {
            let poses = views
                .iter()
                .map(|view| view_pose(view, square_m, &lens))
                .collect::<Option<Vec<_>>>()?;
            Some((median_error(views, square_m, &lens, &poses)?, lens, poses))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, lens, poses)| (lens, poses))
}

#[expect(clippy::cast_precision_loss, reason = "image sizes")]
fn candidates(views: &[View], square_m: f64, size: ImageSize, model: LensModel) -> Vec<Lens> {
    let (width, height) = (size.width as f64, size.height as f64);
    let (cx, cy) = (0.5 * (width - 1.0), 0.5 * (height - 1.0));
    let focals = (0..FOCALS).map(|i| 0.2 * width * FOCAL_STEP.powi(i));
    let mut pinholes: Vec<Pinhole> = focals.map(|f| Pinhole { fx: f, fy: f, cx, cy }).collect();
    if model == LensModel::BrownConrady {
        let homographies: Vec<Matrix3<f64>> = views
            .iter()
            .filter_map(|view| {
                let (points, pixels) = pairs(view, square_m, |sighting| Some(*sighting));
                homography(&points, &pixels)
            })
            .collect();
        pinholes.extend(closed_form(&homographies, width, height));
    }
    (pinholes.into_iter())
        .map(|Pinhole { fx, fy, cx, cy }| match model {
            LensModel::BrownConrady => Lens::pinhole(fx, fy, cx, cy),
            LensModel::KannalaBrandt => Lens::KannalaBrandt(KannalaBrandt {
                fx,
                fy,
                cx,
                cy,
                k: [0.0; 4],
            }),
        })
        .collect()
}

/// Points on the board, and what `seen` makes of their pixels.
fn pairs(
    view: &View,
    square_m: f64,
    seen: impl Fn(&Vector2<f64>) -> Option<Vector2<f64>>,
) -> (Vec<Vector2<f64>>, Vec<Vector2<f64>>) {
    (view.sightings.iter())
        .filter_map(|sighting| Some((sighting.point_m(square_m).xy(), seen(&sighting.pixel)?)))
        .unzip()
}

/// The pose of a view's board under a lens.
fn view_pose(view: &View, square_m: f64, lens: &Lens) -> Option<Pose> {
    let (points, rays) = pairs(view, square_m, |pixel| {
        let ray = lens.unproject(pixel)?;
        let slope = ray.xy() / ray.z;
        (ray.z > 0.0 && slope.norm() < WIDEST_SLOPE).then_some(slope)
    });
    pose(&homography(&points, &rays)?)
}

fn median_error(views: &[View], square_m: f64, lens: &Lens, poses: &[Pose]) -> Option<f64> {
    let mut errors = Vec::new();
    for (view, pose) in views.iter().zip(poses) {
        for sighting in &view.sightings {
            let point = pose * Point3::from(sighting.point_m(square_m));
            let off = lens
                .project(&point.coords)
                .map(|pixel| (pixel - sighting.pixel).norm());
            errors.push(off.unwrap_or(f64::INFINITY));
        }
    }
    errors.sort_by(f64::total_cmp);
    errors.get(errors.len() / 2).copied()
}

/// Whether views hold enough corners for a calibration at all.
pub(super) fn usable(view: &View, board: &Board) -> bool {
    view.sightings.len() >= (board.corners() / 3).max(9)
}
