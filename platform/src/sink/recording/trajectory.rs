//! Trajectories as files.
//!
//! `trajectory.kitti` has a row for each place in the sequence, so that it lines up with the truth: a missing frame gets the
//! pose between its neighbours. `trajectory.tum` has the frames that were there, with their stamps. Both are relative to the
//! first camera, as KITTI's are: its pose is the identity.

use std::fmt::Write;

use freespace::space::{Micros, Pose};

use super::FrameRecord;

/// The 3x4 matrix of a pose, row by row.
pub(super) fn rows_of(pose: &Pose) -> [f64; 12] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|i| matrix[(i / 4, i % 4)])
}

/// Seconds with six decimals, exactly.
pub(super) fn seconds(stamp: Micros) -> String {
    format!("{}.{:06}", stamp.0 / 1_000_000, stamp.0 % 1_000_000)
}

pub(super) fn kitti(frames: &[FrameRecord]) -> String {
    let mut text = String::new();
    let Some(first) = frames.first() else {
        return text;
    };
    let first_from_world = first.world_from_camera.inverse();
    let mut last: Option<&FrameRecord> = None;
    for frame in frames {
        if let Some(last) = last {
            for index in last.index + 1..frame.index {
                let part = fraction(index - last.index, frame.index - last.index);
                let pose = between(&last.world_from_camera, &frame.world_from_camera, part);
                row(&mut text, &(first_from_world * pose));
            }
        }
        row(&mut text, &(first_from_world * frame.world_from_camera));
        last = Some(frame);
    }
    text
}

#[expect(clippy::cast_precision_loss, reason = "frame counts")]
fn fraction(part: usize, whole: usize) -> f64 {
    part as f64 / whole as f64
}

fn between(a: &Pose, b: &Pose, part: f64) -> Pose {
    // Opposite rotations have no path between them; two neighbouring frames never are.
    a.try_lerp_slerp(b, part, 1e-9).unwrap_or(*a)
}

fn row(text: &mut String, pose: &Pose) {
    for (i, value) in rows_of(pose).into_iter().enumerate() {
        let gap = if i == 0 { "" } else { " " };
        let _ = write!(text, "{gap}{value:.9e}");
    }
    text.push('\n');
}

pub(super) fn tum(frames: &[FrameRecord]) -> String {
    let mut text =
        String::from("# time_s x_m y_m z_m qx qy qz qw (first camera: x right, y down, z ahead)\n");
    let Some(first) = frames.first() else {
        return text;
    };
    let first_from_world = first.world_from_camera.inverse();
    for frame in frames {
        let pose = first_from_world * frame.world_from_camera;
        let (p, q) = (pose.translation.vector, pose.rotation.coords);
        let _ = writeln!(
            text,
            "{} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            seconds(frame.stamp),
            p.x,
            p.y,
            p.z,
            q.x,
            q.y,
            q.z,
            q.w
        );
    }
    text
}
