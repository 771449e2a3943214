//! A fleet as a table: the totals, then a row a drive.

use std::fmt::Write as _;

use crate::eval::fleet::{DriveScore, Fleet, Ratios, Tally};
use crate::statistics::{LEVEL_NAMES, Percentiles};

/// The text.
pub(super) fn render(fleet: &Fleet) -> String {
    let mut text = String::new();
    totals(&mut text, fleet);
    text.push('\n');
    rows(&mut text, &fleet.drives);
    if !fleet.failed.is_empty() {
        let _ = writeln!(text, "\nnot evaluated, and in no sum:");
        for drive in &fleet.failed {
            let _ = writeln!(text, "  {}: {}", drive.name, drive.cause);
        }
    }
    text
}

/// A share in percent; `-` where nothing was counted.
fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "-".to_owned(), |share| format!("{:.2} %", 100.0 * share))
}

fn totals(text: &mut String, fleet: &Fleet) {
    let (counts, ratios) = (&fleet.totals.counts, &fleet.totals.ratios);
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<22}{value}");
    };
    line(
        "drives",
        format!("{} of {}", fleet.totals.drives, fleet.list.drives),
    );
    line(
        "driven",
        format!("{:.3} km in {:.3} h", ratios.driven_km, ratios.driven_hours),
    );
    if counts.cut_drives > 0 {
        let text = format!(
            "{} of {} recordings are cut off: what came after is not counted",
            counts.cut_drives, fleet.totals.drives
        );
        line("incomplete", text);
    }
    line("key frames", counts.key_frames.to_string());
    let (met, of) = (counts.deadlines_met(), counts.timed_key_frames);
    let share = percent(ratios.deadlines_met);
    line("deadlines met", format!("{met} of {of} ({share})"));
    if !counts.misses_by_stage.is_empty() {
        let named = counts
            .misses_by_stage
            .iter()
            .map(|(name, count)| format!("{name} {count}"));
        line("misses blamed on", named.collect::<Vec<_>>().join("  "));
    }
    line("quality", levels(counts));
    if let Some(times) = &fleet.totals.capture_to_publish_ms {
        line("capture to publish", latency(times));
    }
    line(
        "frames",
        format!(
            "{} tracked of {}, {} dropped",
            counts.tracked_frames, counts.frames, counts.dropped_frames
        ),
    );
    for (name, value) in truth(counts, ratios) {
        line(name, value);
    }
}

/// Shares of the quality levels, best first.
fn levels(counts: &Tally) -> String {
    let all: u64 = counts.levels.values().sum();
    let place = |name: &str| {
        LEVEL_NAMES
            .iter()
            .position(|level| *level == name)
            .unwrap_or(LEVEL_NAMES.len())
    };
    let mut named: Vec<_> = counts.levels.iter().collect();
    named.sort_by_key(|(name, _)| place(name));
    let shares = named.into_iter().map(|(name, count)| {
        #[expect(clippy::cast_precision_loss, reason = "a share in percent")]
        let share = percent((all > 0).then(|| *count as f64 / all as f64));
        format!("{name} {count} ({share})")
    });
    shares.collect::<Vec<_>>().join("  ")
}

fn latency(times: &Percentiles) -> String {
    format!(
        "p50 {:.0}  p99 {:.0}  p99.9 {:.0}  max {:.0} ms",
        times.p50, times.p99, times.p99_9, times.max
    )
}

/// What was compared with truth; nothing where there was none.
fn truth(counts: &Tally, ratios: &Ratios) -> Vec<(&'static str, String)> {
    let mut lines = Vec::new();
    if counts.road.masks + counts.road.unanswered > 0 {
        lines.push((
            "road",
            format!(
                "F {}  precision {}  recall {}  ({} frames, {} unanswered)",
                percent(ratios.road_f),
                percent(ratios.road_precision),
                percent(ratios.road_recall),
                counts.road.masks,
                counts.road.unanswered
            ),
        ));
    }
    if counts.grid.grids + counts.grid.unanswered > 0 {
        let iou = ratios
            .free_space_iou
            .map_or_else(|| "-".to_owned(), |iou| format!("{iou:.4}"));
        lines.push((
            "free space, 0 to 30 m",
            format!(
                "IoU {iou}  occupied called free {}  ({} grids, {} unanswered)",
                percent(ratios.falsely_free),
                counts.grid.grids,
                counts.grid.unanswered
            ),
        ));
    }
    if counts.path.drives > 0 {
        let error = percent(ratios.distance_error);
        lines.push((
            "distance error",
            format!("{error} over {} drives", counts.path.drives),
        ));
    }
    lines
}

fn rows(text: &mut String, drives: &[DriveScore]) {
    let longest = drives
        .iter()
        .map(|drive| drive.name.chars().count())
        .max()
        .unwrap_or_default();
    let width = longest.clamp(5, 60);
    let _ = writeln!(
        text,
        "{:<width$} {:>10} {:>6} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "drive", "key frames", "misses", "p50 ms", "p99 ms", "km", "road F %", "IoU", "ATE m", "scale %"
    );
    for drive in drives {
        let (counts, ratios) = (&drive.counts, Ratios::of(&drive.counts));
        let times = counts.capture_to_publish.percentiles();
        let number = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        let _ = writeln!(
            text,
            "{:<width$} {:>10} {:>6} {:>8} {:>8} {:>8.3} {:>8} {:>8} {:>8} {:>8}",
            drive.name,
            counts.key_frames,
            counts.deadline_misses,
            number(times.map(|times| times.p50), 0),
            number(times.map(|times| times.p99), 0),
            ratios.driven_km,
            number(ratios.road_f.map(|f| 100.0 * f), 2),
            number(ratios.free_space_iou, 4),
            number(drive.trajectory.map(|row| row.ate_se3_m), 2),
            number(
                drive
                    .trajectory
                    .and_then(|row| row.scale_error)
                    .map(|e| 100.0 * e),
                2
            ),
        );
    }
}
