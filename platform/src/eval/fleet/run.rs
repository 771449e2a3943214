//! One finished run, counted.
//!
//! In: the folder of a run (`report.json`, `trajectory.kitti`, `trajectory.tum`, `masks/`, `grids/`) and, where there is one,
//! the folder of its truth (any of `poses.txt`, `masks/`, `grids/`, as the demo writes them). Out: a [`DriveScore`]. Cost: every
//! mask and grid that has a truth is read.

use std::path::Path;

use freespace::space::Pose;
use serde::Deserialize;

use super::tally::{DriveScore, GridTally, Named, PathTally, RoadTally, Tally, TrajectoryRow};
use crate::bad_input::{BadInput, read_text};
use crate::eval::masks::{self, TruthKind};
use crate::eval::{grid, trajectory};
use crate::statistics::LatencyCounts;

/// What is read of `report.json`.
#[derive(Deserialize)]
struct ReportFile {
    key_frames: u64,
    deadline_misses: u64,
    misses_by_stage: Named,
    levels: Named,
    is_source_cut: bool,
    is_timed: bool,
    capture_to_publish: LatencyCounts,
    frames: u64,
    tracked_frames: u64,
    dropped_frames: u64,
}

/// Counts a run; `index` and `name` are those of its drive in the list.
///
/// # Errors
/// A folder that no run of this version left, counts that do not fit together, or a truth of another size.
pub fn score_run(index: usize, name: &str, run: &Path, truth: Option<&Path>) -> Result<DriveScore, BadInput> {
    let report = report(&run.join("report.json"))?;
    let poses = poses(&run.join("trajectory.kitti"))?;
    let true_poses = truth
        .map(|truth| truth.join("poses.txt"))
        .filter(|path| path.is_file());
    let true_poses = true_poses.map(|path| trajectory::read(&path)).transpose()?;
    let score = true_poses.and_then(|file| trajectory::compare(&poses, &file.poses));
    // Without a deadline there is none to miss.
    let timed = if report.is_timed { report.key_frames } else { 0 };
    let counts = Tally {
        cut_drives: report.is_source_cut.into(),
        key_frames: report.key_frames,
        timed_key_frames: timed,
        deadline_misses: report.deadline_misses.min(timed),
        misses_by_stage: if report.is_timed {
            report.misses_by_stage
        } else {
            Named::new()
        },
        levels: report.levels,
        capture_to_publish: report.capture_to_publish,
        frames: report.frames,
        tracked_frames: report.tracked_frames,
        dropped_frames: report.dropped_frames,
        driven_micros: driven_micros(&run.join("trajectory.tum"))?,
        driven_mm: millimetres(trajectory::path_length_m(&poses)),
        road: truth.map_or(Ok(RoadTally::default()), |truth| road(run, truth))?,
        grid: truth.map_or(Ok(GridTally::default()), |truth| cells(run, truth))?,
        path: score.as_ref().map(path).unwrap_or_default(),
    };
    Ok(DriveScore {
        index,
        name: name.to_owned(),
        network_sha256: None,
        counts,
        trajectory: score.as_ref().map(row),
    })
}

fn report(path: &Path) -> Result<ReportFile, BadInput> {
    let fix = "give the folder that run, replay or demo of this version left, or drive it again";
    let text = read_text(path, fix)?;
    let report: ReportFile = serde_json::from_str(&text)
        .map_err(|error| BadInput::at_line(path, &text, error.line().saturating_sub(1), error, fix))?;
    let answers = report
        .levels
        .values()
        .try_fold(0_u64, |sum, count| sum.checked_add(*count));
    let times = if report.is_timed { answers } else { Some(0) };
    let is_sound = report.capture_to_publish.is_sound()
        && answers.is_some()
        && report.capture_to_publish.count() == times
        && report.deadline_misses <= report.key_frames;
    if is_sound {
        return Ok(report);
    }
    let what = "its counts do not fit together: levels, capture_to_publish and key_frames";
    Err(BadInput::of_file(path, what, fix))
}

/// Poses of a run's file; none of a run without a frame.
fn poses(path: &Path) -> Result<Vec<Pose>, BadInput> {
    if path.metadata().is_ok_and(|file| file.len() == 0) {
        return Ok(Vec::new());
    }
    Ok(trajectory::read(path)?.poses)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturates; a path of a drive is finite and not negative"
)]
fn millimetres(metres: f64) -> u64 {
    (metres * 1e3).round() as u64
}

/// From the first stamp to the last, exactly: the file has them in microseconds.
fn driven_micros(tum: &Path) -> Result<u64, BadInput> {
    let fix = "each line begins with a time in seconds with six decimals";
    let text = read_text(tum, fix)?;
    let rows: Vec<(usize, &str)> = (text.lines().enumerate())
        .filter(|(_, row)| !row.starts_with('#') && !row.is_empty())
        .collect();
    let micros = |(_, row): &(usize, &str)| {
        let (seconds, rest) = row.split_once(' ')?.0.split_once('.')?;
        let whole: u64 = seconds.parse().ok()?;
        let part: u64 = rest.parse().ok().filter(|_| rest.len() == 6)?;
        whole.checked_mul(1_000_000)?.checked_add(part)
    };
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else {
        return Ok(0);
    };
    let at = |row: &(usize, &str)| {
        micros(row).ok_or_else(|| BadInput::at_line(tum, &text, row.0, "has no time", fix))
    };
    Ok(at(last)?.saturating_sub(at(first)?))
}

fn path(score: &trajectory::TrajectoryScore) -> PathTally {
    PathTally {
        drives: 1,
        true_mm: millimetres(score.distance_m),
        estimated_mm: millimetres(score.estimated_distance_m),
    }
}

fn row(score: &trajectory::TrajectoryScore) -> TrajectoryRow {
    TrajectoryRow {
        poses: score.poses as u64,
        ate_se3_m: score.ate_se3_m,
        ate_sim3_m: score.ate_sim3_m,
        scale_error: score.scale.map(|scale| (scale - 1.0).abs()),
        segment_translation_percent: score.segments.map(|segments| segments.translation_percent),
        segment_rotation_deg_per_m: score.segments.map(|segments| segments.rotation_deg_per_m),
    }
}

fn road(run: &Path, truth: &Path) -> Result<RoadTally, BadInput> {
    let truth = truth.join("masks");
    if !truth.is_dir() {
        return Ok(RoadTally::default());
    }
    let score = masks::compare_common(&run.join("masks"), &truth, TruthKind::World)?;
    let pixels = score.pooled;
    Ok(RoadTally {
        masks: score.frames.len() as u64,
        unanswered: score.missing.len() as u64,
        hits: pixels.hits,
        false_alarms: pixels.false_alarms,
        misses: pixels.misses,
        rejections: pixels.rejections,
    })
}

fn cells(run: &Path, truth: &Path) -> Result<GridTally, BadInput> {
    let truth = truth.join("grids");
    if !truth.is_dir() {
        return Ok(GridTally::default());
    }
    let score = grid::compare_common(&run.join("grids"), &truth, &grid::RANGE_M)?;
    let cells = score.pooled;
    Ok(GridTally {
        grids: score.frames.len() as u64,
        unanswered: score.missing.len() as u64,
        free: cells.both,
        falsely_free: cells.falsely_free,
        falsely_not_free: cells.either - cells.both - cells.falsely_free,
        not_free: cells.seen - cells.either,
    })
}
