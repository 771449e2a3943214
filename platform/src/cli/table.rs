//! The table at the end of a run.

use std::path::Path;

use super::terminal;
use crate::sink::recording::Report;

/// Prints a report to standard output: a short table, or the JSON of `report.json`.
pub(super) fn print(report: &Report, engine: &str, out: Option<&Path>, as_json: bool) {
    if as_json {
        // A report always has a JSON form.
        let json = serde_json::to_string_pretty(report).unwrap_or_default();
        terminal::show(format_args!("{json}"));
        return;
    }
    let line = |name: &str, value: String| terminal::show(format_args!("{name:<22}{value}"));
    if report.is_cut_short {
        line("cut short", "a signal ended the drive".to_owned());
    }
    if report.is_source_cut {
        line("recording", "cut off: what came after is in no figure".to_owned());
    }
    if report.has_recorded_times {
        line(
            "times",
            "those of the recorded drive, not of this replay".to_owned(),
        );
    }
    if report.is_timed {
        let met = report.key_frames - report.deadline_misses;
        line("deadlines met", format!("{met} of {}", report.key_frames));
        if !report.misses_by_stage.0.is_empty() {
            line("misses blamed on", report.misses_by_stage.line());
        }
    } else {
        let text = format!("{}, as fast as it goes: no deadline applies", report.key_frames);
        line("key frames", text);
    }
    if let Some(latency) = report.capture_to_publish_ms {
        let text = format!(
            "p50 {:.0}  p99 {:.0}  p99.9 {:.0}  max {:.0} ms",
            latency.p50, latency.p99, latency.p99_9, latency.max
        );
        line("capture to publish", text);
    }
    if let Some(frame) = report.frame_ms {
        let text = format!(
            "p50 {:.1}  p99 {:.1}  p99.9 {:.1}  max {:.1} ms",
            frame.p50, frame.p99, frame.p99_9, frame.max
        );
        line("frame and track", text);
    }
    let slowest: Vec<String> = report
        .stages_ms
        .iter()
        .map(|(stage, times)| format!("{stage} {:.1}", times.p50))
        .collect();
    line("stages, median ms", slowest.join("  "));
    line("quality", report.levels.line());
    let frames = format!(
        "{} tracked of {}, {} dropped",
        report.tracked_frames, report.frames, report.dropped_frames
    );
    line("frames", frames);
    if let Some(allocations) = report.allocations_after_start {
        line("allocations", format!("{allocations} after start"));
    }
    if let Some(mb) = report.peak_rss_mb {
        line("memory", format!("{mb:.0} MB at most"));
    }
    if let Some(memory) = &report.memory {
        let text = format!(
            "{:.1} MB planned, {:.1} MB locked, grew by {:.2} MB, {} page faults once warm",
            memory.planned_mb, memory.locked_mb, memory.rss_growth_mb, memory.page_faults_after_warm_up
        );
        line("", text);
    }
    line("network", engine.to_owned());
    if let Some(truth) = &report.truth {
        if let Some(iou) = truth.free_space_iou {
            line("free-space IoU", format!("{iou:.3} (0 to 30 m ahead)"));
        }
        if let Some(road) = truth.road {
            let text = format!(
                "F {:.2} %  precision {:.2} %  recall {:.2} %  ({} frames)",
                100.0 * road.f,
                100.0 * road.precision,
                100.0 * road.recall,
                road.frames
            );
            line("road", text);
        }
        if let (Some(ate), Some(distance)) = (truth.ate_se3_m, truth.distance_m) {
            line("position error", format!("{ate:.2} m over {distance:.0} m"));
        }
        if let Some(scale) = truth.scale_error {
            line("scale error", format!("{:.2} %", 100.0 * scale));
        }
    }
    if let Some(out) = out {
        line("written to", format!("{} (open index.html)", out.display()));
    }
}
