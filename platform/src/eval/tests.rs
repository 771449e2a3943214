#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "tests"
)]

use std::path::Path;

use freespace::space::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::grid::{CellCount, GridLayout};
use super::masks::{PixelCount, TruthKind};
use super::{Truth, grid, masks, npy, trajectory};

/// A winding drive of about `length` metres in 1 m steps, camera axes.
fn drive(length: usize, bend: f64) -> Vec<Pose> {
    let mut pose = Pose::identity();
    (0..length)
        .map(|i| {
            let turn = bend * (0.05 * i as f64).sin();
            pose *= Pose::from_parts(
                Translation3::new(0.0, 0.002, 1.0),
                UnitQuaternion::from_euler_angles(0.0, turn, 0.0),
            );
            pose
        })
        .collect()
}

fn scaled(poses: &[Pose], scale: f64) -> Vec<Pose> {
    let scale_one = |pose: &Pose| Pose::from_parts((pose.translation.vector * scale).into(), pose.rotation);
    poses.iter().map(scale_one).collect()
}

proptest! {
    #[test]
    fn rigid_motion_of_the_truth_is_no_error(
        bend in 0.0..0.1f64, x in -50.0..50.0f64, yaw in -3.0..3.0f64, pitch in -1.0..1.0f64,
    ) {
        let truth = drive(150, bend);
        let moved = Pose::from_parts(Translation3::new(x, 3.0, -x), UnitQuaternion::from_euler_angles(pitch, yaw, 0.1));
        let estimate: Vec<Pose> = truth.iter().map(|pose| moved * pose).collect();
        let score = trajectory::compare(&estimate, &truth).unwrap();
        prop_assert!(score.ate_se3_m < 1e-6 && score.ate_sim3_m.unwrap() < 1e-6);
        prop_assert!((score.scale.unwrap() - 1.0).abs() < 1e-9);
        prop_assert!(score.segments.unwrap().translation_percent < 1e-6);
    }

    #[test]
    fn known_scale_is_found(bend in 0.0..0.1f64, scale in 0.5..2.0f64) {
        let truth = drive(150, bend);
        let score = trajectory::compare(&scaled(&truth, 1.0 / scale), &truth).unwrap();
        prop_assert!((score.scale.unwrap() - scale).abs() < 1e-9);
        prop_assert!(score.ate_sim3_m.unwrap() < 1e-6);
        prop_assert!(score.ate_sim3_m.unwrap() <= score.ate_se3_m + 1e-9);
        prop_assert!((score.distance_m - scale * score.estimated_distance_m).abs() < 1e-6);
    }

    #[test]
    fn npy_returns_what_was_written(rows in 1..40usize, columns in 1..40usize, seed in any::<u8>()) {
        let values: Vec<i8> = (0..rows * columns).map(|i| (i as u8).wrapping_mul(37).wrapping_add(seed) as i8).collect();
        let file = tempfile::NamedTempFile::new().unwrap();
        let bytes = npy::encode_i8(rows, columns, &values);
        prop_assert_eq!((bytes.len() - values.len()) % 64, 0);
        std::fs::write(file.path(), bytes).unwrap();
        prop_assert_eq!(npy::read_i8(file.path()).unwrap(), (rows, columns, values));
    }
}

#[test]
fn segment_error_is_that_of_a_one_percent_scale() {
    let truth = drive(400, 0.0);
    let segments = trajectory::compare(&scaled(&truth, 0.99), &truth)
        .unwrap()
        .segments
        .unwrap();
    // A segment ends at the first pose beyond its length, up to one step of 1 m in 100 m late.
    assert!((segments.translation_percent - 1.0).abs() < 0.02, "{segments:?}");
    assert!(segments.rotation_deg_per_m < 1e-9);
    assert!(
        trajectory::compare(&truth[..50], &truth[..50])
            .unwrap()
            .segments
            .is_none()
    );
}

#[test]
fn standing_still_has_no_scale() {
    let still = vec![Pose::identity(); 5];
    let score = trajectory::compare(&still, &drive(5, 0.0)).unwrap();
    assert_eq!((score.scale, score.ate_sim3_m), (None, None));
    let mut broken = drive(5, 0.0);
    broken[2].translation.vector = Vector3::repeat(f64::NAN);
    assert!(trajectory::compare(&broken, &drive(5, 0.0)).is_none());
}

#[test]
fn identical_masks_have_f_one_and_open_pixels_do_not_count() {
    let truth = [3, 3, 11, 4, 0];
    let mut count = PixelCount::default();
    count.add(&[1, 1, 1, 0, 0], &truth, TruthKind::Camvid).unwrap();
    assert_eq!((count.precision(), count.recall(), count.f()), (1.0, 1.0, 1.0));
    assert_eq!(count.hits + count.rejections, 4);

    let mut count = PixelCount::default();
    count
        .add(&[1, 0, 1, 1], &[1, 1, 0, 255], TruthKind::Kitti)
        .unwrap();
    assert_eq!((count.hits, count.misses, count.false_alarms), (1, 1, 1));
    assert_eq!((count.precision(), count.recall(), count.f()), (0.5, 0.5, 0.5));
    assert_eq!(count.add(&[0], &[7], TruthKind::Kitti), Err(7));
}

fn gray(path: &Path, width: u32, height: u32, value: u8) {
    image::GrayImage::from_pixel(width, height, image::Luma([value]))
        .save(path)
        .unwrap();
}

#[test]
fn mask_folders_are_matched_by_name_and_faults_named() {
    let (masks_dir, truth_dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (masks_dir, truth_dir) = (masks_dir.path(), truth_dir.path());
    gray(&masks_dir.join("a.png"), 8, 4, 1);
    gray(&truth_dir.join("b.png"), 8, 4, 1);
    let compare = |kind| masks::compare_folders(masks_dir, truth_dir, kind);
    assert!(
        compare(TruthKind::Kitti)
            .unwrap_err()
            .message()
            .contains("none of the 1 truth files")
    );
    gray(&truth_dir.join("a.png"), 8, 4, 1);
    let score = compare(TruthKind::Kitti).unwrap();
    assert_eq!((score.pooled.f(), score.missing), (1.0, vec!["b".to_owned()]));
    gray(&truth_dir.join("a.png"), 8, 4, 5);
    let error = compare(TruthKind::Kitti).unwrap_err();
    assert!(error.message().contains("a.png: holds the value 5") && error.fix().contains("--truth camvid"));
    gray(&truth_dir.join("a.png"), 8, 8, 1);
    assert!(
        compare(TruthKind::Kitti)
            .unwrap_err()
            .message()
            .contains("is 8x4, but its truth")
    );
}

const LAYOUT: GridLayout = GridLayout {
    rows: 3,
    columns: 2,
    cell_m: 10.0,
    origin_in_vehicle_m: [5.0, -10.0],
};

#[test]
fn unknown_is_not_free_and_unseen_truth_does_not_count() {
    let mut count = CellCount::default();
    // Free in both, free but occupied in truth, unknown but free, unseen in truth; the last row lies beyond 30 m.
    let predicted = [0, 0, -1, 0, 0, 0];
    let truth = [0, 100, 0, -1, 100, 100];
    count.add(&LAYOUT, &predicted, &truth, &grid::RANGE_M);
    assert_eq!(
        (count.both, count.either, count.falsely_free, count.seen),
        (1, 3, 1, 3)
    );
    let mut same = CellCount::default();
    same.add(&LAYOUT, &truth, &truth, &grid::RANGE_M);
    assert_eq!(same.iou(), 1.0);
}

#[test]
fn grid_folders_need_one_layout() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let write = |dir: &Path, layout: GridLayout| {
        std::fs::write(dir.join("k.npy"), npy::encode_i8(3, 2, &[0; 6])).unwrap();
        std::fs::write(dir.join("k.json"), serde_json::to_string(&layout).unwrap()).unwrap();
    };
    write(a.path(), LAYOUT);
    write(b.path(), LAYOUT);
    let compare = || grid::compare_folders(a.path(), b.path(), &grid::RANGE_M);
    assert_eq!(compare().unwrap().pooled.iou(), 1.0);
    write(
        b.path(),
        GridLayout {
            cell_m: 0.2,
            ..LAYOUT
        },
    );
    assert!(compare().unwrap_err().fix().contains("same rows"));
    std::fs::write(a.path().join("k.json"), "{\n\"rows\": }").unwrap();
    assert!(compare().unwrap_err().message().contains("k.json:2:"));
    std::fs::write(a.path().join("k.npy"), &npy::encode_i8(3, 2, &[0; 6])[..130]).unwrap();
    assert!(compare().unwrap_err().message().contains("is truncated"));
}

#[test]
fn trajectory_files_name_the_line_at_fault() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let read = |text: &str| {
        std::fs::write(file.path(), text).unwrap();
        trajectory::read(file.path())
    };
    let row = "1 0 0 0 0 1 0 0 0 0 1 5\n";
    assert_eq!(
        read(row).unwrap().poses[0].translation.vector,
        Vector3::new(0.0, 0.0, 5.0)
    );
    let tum = read("# t x y z q\n1.5 0 0 5 0 0 0 1\n").unwrap();
    assert_eq!(tum.stamps_s, Some(vec![1.5]));
    for (text, wanted) in [
        (format!("{row}1 2 3\n"), ":2: 3 numbers in the line"),
        (
            format!("{row}{}", row.replace('5', "nan")),
            ":2: `nan` is not a finite number",
        ),
        (
            "2 0 0 0 0 1 0 0 0 0 1 5\n".to_owned(),
            ":1: the left 3x3 part is no rotation",
        ),
        (String::new(), "holds no pose"),
    ] {
        let error = read(&text).unwrap_err();
        assert!(error.message().contains(wanted), "{error}");
    }
}

#[test]
fn report_keys_of_truth_stay() {
    let value = serde_json::to_value(Truth::default()).unwrap();
    for key in [
        "free_space_iou",
        "road",
        "ate_se3_m",
        "ate_sim3_m",
        "scale_error",
        "distance_m",
    ] {
        assert!(value.get(key).is_some_and(serde_json::Value::is_null), "{key}");
    }
}
