#![allow(clippy::unwrap_used, reason = "tests")]

use freespace::space::Pose;
use nalgebra::Translation3;

use super::*;
use crate::eval::grid::GridLayout;
use crate::eval::masks::TruthKind;
use crate::eval::{grid as grids, masks as road, npy, trajectory as path};

/// Whether a page needs nothing but itself.
fn stands_alone(page: &str) -> bool {
    page.starts_with("<!doctype html>")
        && !page.contains("http")
        && !page.contains("<script")
        && page.ends_with("</html>\n")
}

#[test]
fn masks_show_the_frames_that_differ_most() {
    let (called, truth) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for frame in 0..9_u32 {
        let name = format!("{frame:03}.png");
        let mask = image::GrayImage::from_fn(1300, 20, |x, _| image::Luma([u8::from(x < 100 * frame)]));
        mask.save(called.path().join(&name)).unwrap();
        let known = image::GrayImage::from_fn(1300, 20, |x, y| {
            image::Luma([if y == 0 { 255 } else { u8::from(x < 800) }])
        });
        known.save(truth.path().join(&name)).unwrap();
    }
    let score = road::compare_folders(called.path(), truth.path(), TruthKind::Kitti).unwrap();
    let page = render_masks(&score, called.path(), truth.path(), TruthKind::Kitti).unwrap();
    assert!(stands_alone(&page));
    assert_eq!(page.matches("<img ").count(), WORST);
    assert!(
        page.contains("000: IoU 0.00 %") && !page.contains("008: IoU"),
        "{page}"
    );
    assert_eq!(page.matches("<tr>").count(), 1 + 9);
}

#[test]
fn grids_show_what_was_called_beside_the_truth() {
    let layout = GridLayout {
        rows: 40,
        columns: 30,
        cell_m: 0.5,
        origin_in_vehicle_m: [0.0, -7.5],
    };
    let (called, truth) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for (folder, cells) in [(&called, vec![-1; 1200]), (&truth, vec![0; 1200])] {
        let file = |name: &str| folder.path().join(name);
        std::fs::write(file("k.npy"), npy::encode_i8(40, 30, &cells)).unwrap();
        std::fs::write(file("k.json"), serde_json::to_string(&layout).unwrap()).unwrap();
    }
    let score = grids::compare_folders(called.path(), truth.path(), &grids::RANGE_M).unwrap();
    let page = render_grid(&score, called.path(), truth.path(), 30.0).unwrap();
    assert!(stands_alone(&page) && page.matches("<img ").count() == 2 && page.contains("k: IoU 0.00 %"));
}

#[test]
fn trajectories_are_drawn_one_over_the_other() {
    let poses = |step: f64| -> Vec<Pose> {
        let pose = |i: i32| {
            Pose::from_parts(
                Translation3::new(5.0, 0.0, f64::from(i) * step),
                Default::default(),
            )
        };
        (0..50).map(pose).collect()
    };
    let (estimate, truth) = (poses(1.0), poses(1.02));
    let score = path::compare(&estimate, &truth).unwrap();
    let page = render_trajectory(&score, &estimate, &truth, ("a.tum", "b<i>.txt"));
    assert!(stands_alone(&page) && page.contains("the true path") && page.contains("b&lt;i>.txt"));
    assert!(page.contains("2.00 %"), "{page}");
}
