#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "tests"
)]

use std::fs;
use std::path::Path;

use nalgebra::{Translation3, UnitQuaternion};
use serde_json::Value;

use super::*;
use crate::eval::trajectory::read;
use crate::runtime::allocation::RealTimeScope;
use crate::statistics::Publication;
use freespace::health::{Faults, QualityLevel, ScaleState, TrackingState};
use freespace::stage::Stage;

const LAYOUT: GridLayout = GridLayout {
    rows: 60,
    columns: 40,
    cell_m: 0.5,
    origin_in_vehicle_m: [0.0, -10.0],
};

fn pose(ahead_m: f64) -> Pose {
    let mount = Pose::from_parts(
        Translation3::new(1.0, 2.0, 3.0),
        UnitQuaternion::from_euler_angles(0.3, -0.2, 0.1),
    );
    mount * Pose::translation(0.0, 0.0, ahead_m)
}

/// Three frames, the second missing, and two key frames, the second late.
fn record(dir: &Path) -> Result<Report, RecordingError> {
    let mut recording = Recording::create(
        dir,
        RunTitle {
            is_reproducible: true,
            title: "a <run>".to_owned(),
            deadline_ms: 500.0,
            ..RunTitle::default()
        },
    )?;
    let mut statistics = DriveStatistics::new();
    for index in [0, 2, 3] {
        recording.frame(&FrameRecord {
            index,
            stamp: Micros(index as u64 * 100_000 + 7),
            world_from_camera: pose(index as f64),
        })?;
        statistics.frame(TrackingState::Good);
    }
    let image = vec![128; 64 * 48];
    let labels: Vec<u8> = (0..32 * 24).map(|i| u8::from(i / 32 >= 12)).collect();
    let mut mask = vec![0; 64 * 48];
    Upsampler::new((32, 24), (64, 48)).upsample(&labels, &mut mask);
    let cells: Vec<i8> = (0..2400).map(|i| [0, 100, -1][i % 3]).collect();
    for (name, latency_micros, level) in [
        ("000000", 40_000, QualityLevel::Full),
        ("000002", 600_000, QualityLevel::Invalid),
    ] {
        let mut times = StageTimes::default();
        times.add(Stage::Track, 3_000);
        times.add(Stage::Map, latency_micros / 10);
        let deadline_met = level == QualityLevel::Full;
        statistics.publication(&Publication {
            frame: None,
            stamp: Micros(0),
            cuts: freespace::stage::Cuts::default(),
            level,
            faults: Faults::NONE.with(Faults::DEADLINE_MISSED, !deadline_met),
            scale: ScaleState::Wheels,
            times,
            latency_micros,
            is_miss: !deadline_met,
            blame: None,
        });
        recording.key_frame(&KeyFrameRecord {
            can_frames: &[],
            name,
            stamp: Micros(7),
            image: ImageView {
                width: 64,
                height: 48,
                channels: 1,
                bytes: &image,
            },
            mask: &mask,
            layout: LAYOUT,
            cells: &cells,
            world_from_vehicle: Pose::identity(),
            level: level.name(),
            deadline_met,
            publish_latency_ms: Some(latency_micros as f64 / 1e3),
            times,
            outlines: &[[(-10.0, 5.0), (100.0, f32::NAN)], [(-10.0, 5.0), (100.0, 20.0)]],
        })?;
    }
    let counts = RunCounts {
        key_frames: 2,
        deadline_misses: 1,
        frames: 3,
        tracked_frames: 3,
        dropped_frames: 1,
        allocations_after_start: Some(0),
        peak_rss_mb: None,
        memory: None,
        restarts: 0,
        is_cut_short: true,
    };
    recording.finish(&counts, &statistics, None)
}

#[test]
fn recording_holds_what_it_promises() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    record(&dir).unwrap();

    let report: Value = serde_json::from_slice(&fs::read(dir.join("report.json")).unwrap()).unwrap();
    for (key, wanted) in [
        ("key_frames", 2),
        ("deadline_misses", 1),
        ("dropped_frames", 1),
        ("tracked_frames", 3),
        ("frames", 3),
        ("allocations_after_start", 0),
    ] {
        assert_eq!(report[key], wanted, "{key}");
    }
    assert_eq!(report["capture_to_publish_ms"]["p99_9"], 600.0);
    let map_ms = report["stages_ms"]["map"]["p50"].as_f64().unwrap();
    assert!((map_ms - 4.0).abs() < 0.005, "{map_ms}");
    assert_eq!(report["levels"]["full"], 1);
    assert_eq!(report["misses_by_stage"]["unknown"], 1);
    assert_eq!(report["faults"]["deadline_missed"], 1);
    assert!(report["frame_ms"].is_null() && report["drops"]["hand_over"].is_null());
    assert_eq!(report["is_cut_short"], true);
    assert!(report["truth"].is_null() && report["peak_rss_mb"].is_null());

    let mask = image::open(dir.join("masks/000000.png")).unwrap().into_luma8();
    assert_eq!(mask.dimensions(), (64, 48));
    assert!(
        mask.enumerate_pixels()
            .all(|(_, y, pixel)| pixel[0] == u8::from(y >= 24))
    );
    assert_eq!(
        image::open(dir.join("overlays/000002.png"))
            .unwrap()
            .into_rgb8()
            .get_pixel(5, 2)[0],
        128
    );
    let (rows, columns, cells) = npy::read_i8(&dir.join("grids/000000.npy")).unwrap();
    assert_eq!((rows, columns, cells[1]), (60, 40, 100));
    let header: Value = serde_json::from_slice(&fs::read(dir.join("grids/000000.json")).unwrap()).unwrap();
    assert_eq!(
        (header["cell_m"].as_f64(), header["stamp_micros"].as_u64()),
        (Some(0.5), Some(7))
    );

    let timing = fs::read_to_string(dir.join("timing.csv")).unwrap();
    let lines: Vec<&str> = timing.lines().collect();
    assert_eq!(
        lines[0],
        "name,stamp_s,publish_latency_ms,level,deadline_met,frame_ms,track_ms,map_ms,priors_ms,segmentation_ms,crf_ms,\
         grid_ms,emit_ms"
    );
    assert_eq!(
        lines[2],
        "000002,0.000007,600.000,invalid,0,0.000,3.000,60.000,0.000,0.000,0.000,0.000,0.000"
    );
    let latency = image::open(dir.join("latency.png")).unwrap();
    assert!(latency.width() >= 800 && latency.height() >= 500);
    assert!(!dir.join(".partial").exists());
}

#[test]
fn trajectory_starts_at_identity_and_has_a_row_for_the_missing_frame() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    record(&dir).unwrap();
    let kitti = read(&dir.join("trajectory.kitti")).unwrap().poses;
    assert_eq!(kitti.len(), 4);
    for (i, pose) in kitti.iter().enumerate() {
        assert!((pose.translation.vector.z - i as f64).abs() < 1e-8 && pose.rotation.angle() < 1e-8);
    }
    let tum = read(&dir.join("trajectory.tum")).unwrap();
    assert_eq!(tum.stamps_s, Some(vec![0.000_007, 0.200_007, 0.300_007]));
}

#[test]
fn a_replay_shows_the_path_it_should_have_taken() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    let mut recording = Recording::create(&dir, RunTitle::default()).unwrap();
    for index in 0..3 {
        let frame = FrameRecord {
            index,
            stamp: Micros(index as u64),
            world_from_camera: pose(index as f64),
        };
        recording.frame(&frame).unwrap();
    }
    recording.know_path(&[pose(5.0), pose(6.0), pose(7.5), pose(9.0)]);
    recording
        .finish(&RunCounts::default(), &DriveStatistics::new(), None)
        .unwrap();
    let page = fs::read_to_string(dir.join("index.html")).unwrap();
    assert!(page.contains("path from above, and the true path") && page.contains(">truth<"));
}

#[test]
fn page_stands_alone() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    record(&dir).unwrap();
    let page = fs::read_to_string(dir.join("index.html")).unwrap();
    assert!(page.contains("a &lt;run>") && page.contains("data:image/jpeg;base64,/9j/"));
    assert!(page.contains("deadline 500 ms") && !page.contains("<!--") && !page.contains("/*"));
    assert!(!page.contains("http"));
}

#[test]
fn two_runs_do_not_fill_one_folder() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    let first = Recording::create(&dir, RunTitle::default()).unwrap();
    let refused = Recording::create(&dir, RunTitle::default()).unwrap_err();
    assert!(
        refused.to_string().contains("written to by another run"),
        "{refused}"
    );
    let finished = first.finish(&RunCounts::default(), &DriveStatistics::new(), None);
    finished.unwrap();
    Recording::create(&dir, RunTitle::default()).unwrap();
}

#[test]
fn earlier_run_is_replaced_and_foreign_files_are_refused() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    record(&dir).unwrap();
    fs::write(dir.join("masks/old.png"), "").unwrap();
    record(&dir).unwrap();
    assert!(!dir.join("masks/old.png").exists() && dir.join("masks/000002.png").exists());
    fs::write(dir.join("thesis.tex"), "").unwrap();
    let error = record(&dir).unwrap_err();
    assert!(matches!(&error, RecordingError::Folder(_)) && error.to_string().contains("thesis.tex"));
    assert!(dir.join("masks/000002.png").exists() && dir.join("thesis.tex").exists());
}

#[test]
fn abandoned_run_leaves_nothing() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    drop(Recording::create(&dir, RunTitle::default()).unwrap());
    assert!(!dir.exists());
    record(&dir).unwrap();
    drop(Recording::create(&dir, RunTitle::default()).unwrap());
    assert!(dir.join("report.json").exists() && !dir.join(".partial").exists());
}

#[test]
fn same_run_gives_the_same_bytes() {
    let parent = tempfile::tempdir().unwrap();
    for run in ["a", "b"] {
        record(&parent.path().join(run)).unwrap();
    }
    for name in [
        "masks/000000.png",
        "overlays/000002.png",
        "birdseye/000002.png",
        "grids/000002.npy",
        "trajectory.kitti",
        "index.html",
    ] {
        let bytes = |run: &str| fs::read(parent.path().join(run).join(name)).unwrap();
        assert!(bytes("a") == bytes("b"), "{name}");
    }
}

#[test]
fn frames_take_no_memory() {
    let parent = tempfile::tempdir().unwrap();
    let mut recording = Recording::create(&parent.path().join("run"), RunTitle::default()).unwrap();
    let frame = |index: usize| FrameRecord {
        index,
        stamp: Micros(index as u64),
        world_from_camera: pose(index as f64),
    };
    recording.frame(&frame(0)).unwrap();
    recording.true_pose(&frame(0)).unwrap();
    let scope = RealTimeScope::enter();
    for index in 1..2000 {
        recording.frame(&frame(index)).unwrap();
        recording.true_pose(&frame(index)).unwrap();
    }
    assert_eq!(scope.allocations(), 0);
    drop(scope);
    assert_eq!(recording.poses().unwrap().len(), 2000);
}

#[test]
fn a_run_that_lost_its_way_is_recorded_all_the_same() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    let mut recording = Recording::create(&dir, RunTitle::default()).unwrap();
    let mut grown = pose(1.0);
    grown.rotation = UnitQuaternion::new_unchecked(grown.rotation.into_inner() * 1.5);
    let frame = |index: usize, world_from_camera: Pose| FrameRecord {
        index,
        stamp: Micros(index as u64),
        world_from_camera,
    };
    recording.frame(&frame(0, pose(0.0))).unwrap();
    recording.frame(&frame(1, grown)).unwrap();
    assert_eq!(recording.poses().unwrap().len(), 2);
    recording.frame(&frame(2, pose(f64::NAN))).unwrap();
    assert_eq!(recording.poses().unwrap().len(), 0);
    recording
        .finish(&RunCounts::default(), &DriveStatistics::new(), None)
        .unwrap();
    assert!(dir.join("index.html").exists());
}

#[test]
fn a_sequence_that_begins_late_still_lines_up() {
    let parent = tempfile::tempdir().unwrap();
    let mut recording = Recording::create(&parent.path().join("run"), RunTitle::default()).unwrap();
    assert_eq!(recording.poses().unwrap().len(), 0);
    for index in [2, 4] {
        let frame = FrameRecord {
            index,
            stamp: Micros(index as u64),
            world_from_camera: pose(index as f64),
        };
        recording.frame(&frame).unwrap();
        recording.true_pose(&frame).unwrap();
    }
    let ahead_m: Vec<f64> = (recording.poses().unwrap().iter())
        .map(|pose| pose.translation.vector.z.round())
        .collect();
    assert_eq!(ahead_m, [0.0, 0.0, 0.0, 1.0, 2.0]);
    assert_eq!(recording.true_poses().unwrap().len(), 5);
}

#[test]
fn a_long_run_shows_a_part_of_its_key_frames_misses_and_the_worst() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    let mut recording = Recording::create(&dir, RunTitle::default()).unwrap();
    let (image, mask, cells) = ([0; 16], [1; 16], [0; 480]);
    for i in 0..300 {
        let is_miss = i == 101;
        recording
            .key_frame(&KeyFrameRecord {
                name: &format!("{i:06}"),
                stamp: Micros(i),
                image: ImageView {
                    width: 4,
                    height: 4,
                    channels: 1,
                    bytes: &image,
                },
                mask: &mask,
                layout: GridLayout {
                    rows: 480,
                    columns: 1,
                    ..LAYOUT
                },
                cells: &cells,
                world_from_vehicle: Pose::identity(),
                level: "full",
                deadline_met: !is_miss,
                publish_latency_ms: Some(if (200..204).contains(&i) && i != 202 {
                    i as f64
                } else {
                    1.0
                }),
                times: StageTimes::default(),
                can_frames: &[],
                outlines: &[],
            })
            .unwrap();
        if (205..300).contains(&i) {
            let name = format!("{i:06}");
            recording
                .score(&name, ScoreOf::FreeSpace, i as f64 * 1e-3)
                .unwrap();
        }
    }
    recording
        .finish(&RunCounts::default(), &DriveStatistics::new(), None)
        .unwrap();
    let page = fs::read_to_string(dir.join("index.html")).unwrap();
    // Each fourth, the miss, the slowest (one of each fourth, and two more), and the three furthest from the truth.
    assert_eq!(page.matches("\"overlay\":").count(), 75 + 1 + 2 + 3);
    for name in ["000100", "000101", "000203", "000205", "000206", "000207"] {
        assert!(page.contains(&format!("\"name\":\"{name}\"")), "{name}");
    }
    assert!(page.contains("\"iou\":0.207") && page.contains("\"iou\":null"));
    assert!(page.contains("One key frame in 4 of 300 is shown"));
    let timing = fs::read_to_string(dir.join("timing.csv")).unwrap();
    assert_eq!(timing.lines().count(), 301);
}

#[test]
fn an_upsampled_mask_is_cut_at_one_half() {
    let labels = [0, 0, 0, 7];
    let mut out = [9; 16];
    Upsampler::new((2, 2), (4, 4)).upsample(&labels, &mut out);
    assert_eq!(out, [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 0, 0, 1, 1]);
    let mut same = [9; 4];
    Upsampler::new((2, 2), (2, 2)).upsample(&labels, &mut same);
    assert_eq!(same, [0, 0, 0, 1]);
}

#[test]
fn the_latency_picture_has_its_parts_even_where_nothing_was_published() {
    let mut pixels = Vec::new();
    latency::draw(&DriveStatistics::new(), 500.0, &mut pixels);
    let empty = pixels.clone();
    let mut statistics = DriveStatistics::new();
    for latency_micros in [0, 1, 45_000, 46_000, 90_000_000] {
        statistics.publication(&Publication {
            frame: None,
            stamp: Micros(0),
            cuts: freespace::stage::Cuts::default(),
            level: QualityLevel::Full,
            faults: Faults::NONE,
            scale: ScaleState::Wheels,
            times: StageTimes([latency_micros; 8]),
            latency_micros,
            is_miss: false,
            blame: None,
        });
    }
    let (width, height) = latency::draw(&statistics, 0.0, &mut pixels);
    assert_eq!(pixels.len(), 3 * width * height);
    assert!(pixels != empty && empty.len() == pixels.len());
}

#[test]
fn birdseye_has_ahead_up_and_left_left() {
    let mut cells = vec![-1; 2400];
    cells[59 * 40 + 39] = 100; // farthest row, leftmost column
    let mut pixels = Vec::new();
    let (width, _) = picture::birdseye(&LAYOUT, &cells, &mut pixels);
    let at = |x: usize, y: usize| &pixels[3 * (y * width + x)..][..3];
    assert_eq!(at(1, 1), [126, 28, 32]);
    assert_ne!(at(width - 2, 1), at(1, 1));
}
