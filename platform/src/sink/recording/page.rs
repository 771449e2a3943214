//! `index.html`: the run on one page that needs no network and no file beside it.

use std::fmt::Write;

use super::folder::OutputFolder;
use super::report::{Percentiles, Report};
use super::trajectory::seconds;
use super::{FrameRecord, RecordingError, Row, RunTitle};
use freespace::space::Micros;

/// Page frame: style, layout and the player; the rest is put in at the marks.
const TEMPLATE: &str = include_str!("page.html");

/// Widest overlay on the page; the full one is in `overlays/`.
const PICTURE_WIDTH_PX: u32 = 960;
/// Quality of the overlays on the page, 0 to 100.
const PICTURE_QUALITY: u8 = 78;

pub(super) fn html(
    title: &RunTitle,
    folder: &OutputFolder,
    report: &Report,
    rows: &[Row],
    stages: &[&'static str],
    frames: &[FrameRecord],
) -> Result<String, RecordingError> {
    let mut key_frames = String::from("[");
    for (i, row) in rows.iter().enumerate() {
        let picture = |name: &str| folder.read(name).unwrap_or_default();
        let overlay = small_jpeg(&picture(&format!("overlays/{}.png", row.name)));
        let birdseye = picture(&format!("birdseye/{}.png", row.name));
        let _ = write!(
            key_frames,
            "{}{{\"row\":{},\"time\":\"{}\",\"overlay\":\"data:image/jpeg;base64,{}\",\"birdseye\":\"data:image/png;base64,{}\"}}",
            if i == 0 { "" } else { ",\n" },
            script_json(row),
            seconds(Micros(row.stamp_micros)),
            base64(&overlay),
            base64(&birdseye)
        );
    }
    key_frames.push(']');
    let heading = if title.title.is_empty() {
        "freespace run"
    } else {
        &title.title
    };
    Ok(TEMPLATE
        .replace("<!--TITLE-->", &escaped(heading))
        .replace("<!--CARDS-->", &cards(report))
        .replace("<!--STAGES-->", &stage_table(report))
        .replace("<!--HISTOGRAM-->", &histogram(rows, title.deadline_ms))
        .replace("<!--PATH-->", &path(frames))
        .replace("/*STAGES*/[]", &script_json(&stages))
        .replace("/*KEY_FRAMES*/[]", &key_frames))
}

/// JSON that may stand in a script element.
fn script_json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value)
        .unwrap_or_default()
        .replace("</", "<\\/")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

fn card(out: &mut String, label: &str, value: &str, state: &str) {
    let _ = write!(
        out,
        "<div class=\"card {state}\"><b>{}</b><span>{}</span></div>",
        escaped(value),
        escaped(label)
    );
}

fn cards(report: &Report) -> String {
    let mut out = String::new();
    let misses = report.deadline_misses;
    card(&mut out, "key frames", &report.key_frames.to_string(), "");
    card(
        &mut out,
        "deadline misses",
        &misses.to_string(),
        if misses == 0 { "good" } else { "bad" },
    );
    if let Some(latency) = report.capture_to_publish_ms {
        card(
            &mut out,
            "capture to publish, median",
            &format!("{:.1} ms", latency.p50),
            "",
        );
        card(
            &mut out,
            "capture to publish, p99",
            &format!("{:.1} ms", latency.p99),
            "",
        );
    }
    let tracked = format!("{} / {}", report.tracked_frames, report.frames);
    card(&mut out, "frames tracked", &tracked, "");
    if report.dropped_frames > 0 {
        card(
            &mut out,
            "frames dropped or missing",
            &report.dropped_frames.to_string(),
            "bad",
        );
    }
    let truth = report.truth.unwrap_or_default();
    if let Some(iou) = truth.free_space_iou {
        card(&mut out, "free-space IoU, 0 to 30 m", &format!("{iou:.3}"), "");
    }
    if let Some(road) = truth.road {
        card(&mut out, "road F", &format!("{:.1} %", 100.0 * road.f), "");
    }
    if let (Some(ate), Some(distance)) = (truth.ate_se3_m, truth.distance_m) {
        card(
            &mut out,
            &format!("position error over {distance:.0} m"),
            &format!("{ate:.2} m"),
            "",
        );
    }
    if let Some(scale) = truth.scale_error {
        card(&mut out, "scale error", &format!("{:.2} %", 100.0 * scale), "");
    }
    if let Some(rss) = report.peak_rss_mb {
        card(&mut out, "peak memory", &format!("{rss:.0} MB"), "");
    }
    out
}

fn stage_table(report: &Report) -> String {
    let mut out = String::new();
    let mut line = |name: &str, times: &Percentiles, class: &str| {
        let _ = write!(
            out,
            "<tr class=\"{class}\"><td>{}</td><td>{:.1}</td><td>{:.1}</td><td>{:.1}</td><td>{:.1}</td></tr>",
            escaped(name),
            times.p50,
            times.p99,
            times.p99_9,
            times.max
        );
    };
    for (stage, times) in &report.stages_ms {
        line(stage, times, "");
    }
    if let Some(times) = &report.capture_to_publish_ms {
        line("capture to publish", times, "total");
    }
    out
}

/// Bars of the histogram.
const BINS: usize = 40;

/// Latencies of all key frames as an SVG picture, the deadline as a line.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "bars of a histogram"
)]
fn histogram(rows: &[Row], deadline_ms: f64) -> String {
    let largest = rows.iter().map(|row| row.latency_ms).fold(1.0, f64::max);
    let deadline_shown = deadline_ms > 0.0 && deadline_ms < 8.0 * largest;
    let end = if deadline_shown {
        largest.max(deadline_ms) * 1.05
    } else {
        largest * 1.05
    };
    let mut counts = [0_usize; BINS];
    for row in rows {
        let bin = (row.latency_ms.max(0.0) / end * BINS as f64) as usize;
        counts[bin.min(BINS - 1)] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or_default().max(1) as f64;
    let mut svg = String::from("<svg viewBox=\"0 0 480 170\" role=\"img\" aria-label=\"latency histogram\">");
    for (i, &count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        let height = 120.0 * count as f64 / most;
        let (x, y) = (10.0 + 11.5 * i as f64, 140.0 - height);
        let low = end * i as f64 / BINS as f64;
        let high = end * (i + 1) as f64 / BINS as f64;
        let _ = write!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"10\" height=\"{height:.1}\" rx=\"2\"><title>{low:.0} to {high:.0} ms: {count}</title></rect>"
        );
    }
    svg.push_str("<path class=\"axis\" d=\"M10 140H470\"/>");
    for tick in 0..=4 {
        let x = 10.0 + 115.0 * f64::from(tick);
        let _ = write!(
            svg,
            "<text x=\"{x:.0}\" y=\"158\">{:.0}</text>",
            end * f64::from(tick) / 4.0
        );
    }
    if deadline_shown {
        let x = 10.0 + 460.0 * deadline_ms / end;
        let _ = write!(
            svg,
            "<path class=\"deadline\" d=\"M{x:.1} 8V140\"/><text class=\"deadline\" x=\"{:.1}\" y=\"16\" text-anchor=\"end\">deadline {deadline_ms:.0} ms</text>",
            x - 6.0
        );
    }
    svg.push_str("</svg>");
    svg
}

/// The path from above as an SVG picture, ahead of the first camera up.
fn path(frames: &[FrameRecord]) -> String {
    let Some(first) = frames.first() else {
        return String::new();
    };
    let first_from_world = first.world_from_camera.inverse();
    let points: Vec<(f64, f64)> = frames
        .iter()
        .map(|frame| (first_from_world * frame.world_from_camera).translation.vector)
        .map(|position| (position.x, -position.z))
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .collect();
    let bounds = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)))
    };
    let (left, right) = bounds(&mut points.iter().map(|p| p.0));
    let (top, bottom) = bounds(&mut points.iter().map(|p| p.1));
    let extent = (right - left).max(bottom - top).max(1.0);
    let scale = 200.0 / extent;
    let place = |(x, y): &(f64, f64)| {
        let x = 120.0 + (x - 0.5 * (left + right)) * scale;
        (x, 115.0 + (y - 0.5 * (top + bottom)) * scale)
    };
    let mut svg = String::from(
        "<svg viewBox=\"0 0 240 250\" role=\"img\" aria-label=\"path from above\"><polyline points=\"",
    );
    for point in &points {
        let (x, y) = place(point);
        let _ = write!(svg, "{x:.1},{y:.1} ");
    }
    svg.push_str("\"/>");
    if let (Some(start), Some(end)) = (points.first().map(place), points.last().map(place)) {
        let _ = write!(
            svg,
            "<circle class=\"start\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\"/><circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\"/>",
            start.0, start.1, end.0, end.1
        );
    }
    let _ = write!(
        svg,
        "<text x=\"120\" y=\"244\" text-anchor=\"middle\">{extent:.0} m across</text></svg>"
    );
    svg
}

/// An overlay as a small JPEG; empty where it cannot be made, which leaves a gap on the page.
fn small_jpeg(png: &[u8]) -> Vec<u8> {
    let Ok(image) = image::load_from_memory(png) else {
        return Vec::new();
    };
    let image = if image.width() > PICTURE_WIDTH_PX {
        image.resize(PICTURE_WIDTH_PX, u32::MAX, image::imageops::FilterType::Triangle)
    } else {
        image
    };
    let mut bytes = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, PICTURE_QUALITY);
    match image.write_with_encoder(encoder) {
        Ok(()) => bytes,
        Err(_) => Vec::new(),
    }
}

/// RFC 4648, section 4.
pub(super) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let at = |i: usize| u32::from(group.get(i).copied().unwrap_or_default());
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i) & 63) as usize];
            out.push(if i <= group.len() { char::from(digit) } else { '=' });
        }
    }
    out
}
