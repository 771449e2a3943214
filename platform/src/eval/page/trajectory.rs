//! A trajectory against the true one.

use freespace::space::Pose;
use nalgebra::Vector3;

use super::percent;
use crate::eval::trajectory::TrajectoryScore;
use crate::page::{Page, paths};

/// The page of two trajectories that were paired pose by pose; `names` are those of their files.
#[must_use]
pub fn render(score: &TrajectoryScore, poses: &[Pose], true_poses: &[Pose], names: (&str, &str)) -> String {
    let mut page = Page::new(&format!("trajectory: {} against {}", names.0, names.1));
    page.card(
        "position error after SE(3)",
        &format!("{:.3} m", score.ate_se3_m),
        "",
    );
    if let (Some(ate), Some(scale)) = (score.ate_sim3_m, score.scale) {
        page.card("position error after Sim(3)", &format!("{ate:.3} m"), "");
        page.card("scale error", &percent((scale - 1.0).abs()), "");
    }
    page.card("true path", &format!("{:.2} m", score.distance_m), "");
    page.card(
        "estimated path",
        &format!("{:.2} m", score.estimated_distance_m),
        "",
    );
    page.card("poses compared", &score.poses.to_string(), "");
    if let Some(segments) = score.segments {
        let (translation, rotation) = (segments.translation_percent, segments.rotation_deg_per_m);
        page.card(
            "translation error of segments",
            &format!("{translation:.3} %"),
            "",
        );
        page.card("rotation error of segments", &format!("{rotation:.5} deg/m"), "");
    }
    let plot = paths(&from_the_first(poses), &from_the_first(true_poses));
    let html = format!("<div class=\"plot\">{plot}</div>");
    page.panel(
        "from above, both from the first pose on, the first camera's view up",
        &html,
    );
    page.finish()
}

/// Positions relative to the first pose.
fn from_the_first(poses: &[Pose]) -> Vec<Vector3<f64>> {
    let first_from_world = poses.first().map(Pose::inverse).unwrap_or_default();
    poses
        .iter()
        .map(|pose| (first_from_world * pose).translation.vector)
        .collect()
}
