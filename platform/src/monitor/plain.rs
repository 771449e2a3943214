//! A snapshot as text, for scripts and logs: one fact a line, `name value`, aligned.
//!
//! Invariant: the names of the lines stay; what is not known has no line.

use std::fmt::Write as _;

use super::snapshot::{Count, Snapshot};

/// The text.
#[must_use]
pub fn render(snapshot: &Snapshot) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<20}{value}");
    };
    line("link", snapshot.link.name().to_owned());
    if let Some(reason) = &snapshot.reason {
        line("reason", reason.clone());
    }
    if let Some(silent_s) = snapshot.silent_s {
        line("message_age_s", format!("{silent_s:.2}"));
    }
    if let Some(message) = &snapshot.message {
        line("sequence", message.sequence.to_string());
        line("level", message.level.to_owned());
        line("faults", joined(message.faults.iter().copied()));
        line("blame", message.blame.unwrap_or("-").to_owned());
        line("used_ms", format!("{:.1}", message.used_ms));
        line("budget_ms", format!("{:.1}", message.budget_ms));
        line("scale", message.scale.to_owned());
        line("tracking", message.tracking.to_owned());
        line("camera", message.camera.to_owned());
        line("wheels", message.wheels.to_owned());
        line("can", message.can.to_owned());
        line("speed_mps", format!("{:.2}", message.speed_mps));
        line("free_ahead_m", format!("{:.1}", message.free_ahead_m));
        let free = message.boundary.free_m.iter();
        line("free_m", joined(free.map(|metres| format!("{metres:.1}"))));
    }
    let totals = &snapshot.totals;
    line("messages", totals.messages.to_string());
    line("lost", totals.lost.to_string());
    line("misses", totals.misses.to_string());
    line("misses_by_blame", counted(&totals.misses_by_blame));
    line("levels", counted(&totals.levels));
    if let Some(times) = snapshot.latency.percentiles {
        line(
            "latency_ms",
            format!(
                "p50 {:.1}  p99 {:.1}  p99.9 {:.1}  max {:.1}",
                times.p50, times.p99, times.p99_9, times.max
            ),
        );
    }
    if let Some(module) = &snapshot.module {
        line("frames", module.frames.to_string());
        line("dropped_frames", module.dropped_frames.to_string());
        line("restarts", module.restarts.to_string());
    }
    for read in &snapshot.temperatures {
        line("temperature_c", format!("{:.1} {}", read.celsius, read.zone));
    }
    if let Some(note) = &snapshot.temperature_note {
        line("temperature_note", note.clone());
    }
    text
}

fn joined(words: impl Iterator<Item = impl ToString>) -> String {
    let words: Vec<String> = words.map(|word| word.to_string()).collect();
    if words.is_empty() {
        "-".to_owned()
    } else {
        words.join(" ")
    }
}

fn counted(counts: &[Count]) -> String {
    joined(
        counts
            .iter()
            .map(|count| format!("{}={}", count.name, count.count)),
    )
}
