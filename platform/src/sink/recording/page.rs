//! `index.html`: the run on one page that needs no network and no file beside it.
//!
//! Written piece by piece: one key frame's pictures are in memory at a time. A long run has more key frames than a browser
//! takes; then every nth is shown, and besides the first [`MISSES_SHOWN`] misses, and the [`WORST_SHOWN`] that were slowest and
//! that differ most from the truth. Those that one should look at first stand in a row of their own.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Write as _;

use nalgebra::Vector3;

use super::folder::OutputFolder;
use super::report::Report;
use super::scores::{self, Scores};
use super::timing::{self, Row};
use super::{RecordingError, RunTitle};
use crate::page::{STYLE, base64, card, escaped, image, paths};
use crate::statistics::Percentiles;

/// Page frame: style, layout and the player; the rest is put in at the marks.
const TEMPLATE: &str = include_str!("page.html");
/// Where the key frames go.
const KEY_FRAMES: &str = "/*KEY_FRAMES*/[]";

/// Key frames that the page shows at most, but for misses and the worst: with their pictures they are some 8 MB.
const KEY_FRAMES_SHOWN: usize = 80;
/// Misses shown besides.
const MISSES_SHOWN: usize = 20;
/// Slowest shown besides, and as many that differ most from the truth.
const WORST_SHOWN: usize = 3;
/// Widest overlay on the page; the full one is in `overlays/`.
const PICTURE_WIDTH_PX: u32 = 960;
/// Quality of the overlays on the page, 0 to 100.
const PICTURE_QUALITY: u8 = 78;

/// What the page is made of.
pub(super) struct Run<'a> {
    pub(super) title: &'a RunTitle,
    pub(super) folder: &'a OutputFolder,
    pub(super) report: &'a Report,
    /// Rows of the finished `timing.csv`.
    pub(super) rows: usize,
    /// Of every frame, relative to the first camera.
    pub(super) positions: &'a [Vector3<f64>],
    /// The same of the truth; none where it is not known.
    pub(super) true_positions: &'a [Vector3<f64>],
}

/// Writes the page.
pub(super) fn write(run: &Run<'_>) -> Result<(), RecordingError> {
    let (before, after) = TEMPLATE.split_once(KEY_FRAMES).unwrap_or((TEMPLATE, ""));
    let mut page = run.folder.lines("index.html")?;
    let written = page.write_all(head(run, before).as_bytes());
    written.map_err(|error| page.fault(error))?;
    let stride = run.rows.div_ceil(KEY_FRAMES_SHOWN).max(1);
    let scores = scores::read(&run.folder.partial("scores.csv"))?;
    let worst = worst(run, &scores)?;
    let (mut separator, mut misses) = ("[", 0);
    for (i, row) in timing::rows(&run.folder.partial("timing.csv"))?.enumerate() {
        let is_extra = i % stride != 0 && !worst.contains(&i);
        if is_extra && (row.met || misses >= MISSES_SHOWN) {
            continue;
        }
        misses += usize::from(is_extra);
        let iou = scores.get(&row.name).copied();
        page.line(format_args!("{separator}{}", entry(run.folder, &row, iou)))?;
        separator = ",";
    }
    let opening = if separator == "[" { "[" } else { "" };
    page.line(format_args!("{opening}]{}", after.trim_end()))?;
    page.finish()
}

/// Rows of the slowest key frames, and of those that differ most from the truth.
fn worst(run: &Run<'_>, scores: &Scores) -> Result<BTreeSet<usize>, RecordingError> {
    let (mut slowest, mut furthest) = (Worst::default(), Worst::default());
    for (i, row) in timing::rows(&run.folder.partial("timing.csv"))?.enumerate() {
        if let Some(latency_ms) = row.latency_ms {
            slowest.offer(i, latency_ms);
        }
        if let Some(iou) = scores.get(&row.name) {
            furthest.offer(i, -iou);
        }
    }
    Ok(slowest.0.into_iter().chain(furthest.0).map(|(i, _)| i).collect())
}

/// The rows with the largest values so far, the largest first.
#[derive(Default)]
struct Worst(Vec<(usize, f64)>);

impl Worst {
    fn offer(&mut self, row: usize, value: f64) {
        let place = self.0.partition_point(|(_, other)| *other >= value);
        if place < WORST_SHOWN {
            self.0.insert(place, (row, value));
            self.0.truncate(WORST_SHOWN);
        }
    }
}

/// The page up to the key frames.
fn head(run: &Run<'_>, template: &str) -> String {
    let title = &run.title.title;
    let heading = if title.is_empty() { "freespace run" } else { title };
    let stages = freespace::stage::Stage::ALL.map(freespace::stage::Stage::name);
    template
        .replace("<!--STYLE-->", STYLE)
        .replace("<!--TITLE-->", &escaped(heading))
        .replace("<!--CARDS-->", &cards(run.report))
        .replace("<!--SHOWN-->", &shown(run.rows))
        .replace("<!--STAGES-->", &stage_table(run.report))
        .replace("<!--LATENCY-->", &latency(run))
        .replace("<!--PATH-->", &paths(run.positions, run.true_positions))
        .replace("/*STAGES*/[]", &script_json(&stages))
}

/// Says which key frames are shown, where it is not all of them.
fn shown(rows: usize) -> String {
    match rows.div_ceil(KEY_FRAMES_SHOWN) {
        0 | 1 => String::new(),
        stride => format!(
            "<div class=\"facts\">One key frame in {stride} of {rows} is shown, and misses and the worst besides.</div>"
        ),
    }
}

/// A key frame with its pictures.
fn entry(folder: &OutputFolder, row: &Row, iou: Option<f64>) -> String {
    let picture = |kind: &str| {
        folder
            .read(&format!("{kind}/{}.png", row.name))
            .unwrap_or_default()
    };
    format!(
        "{{\"row\":{},\"road\":{:.4},\"iou\":{},\"overlay\":\"data:image/jpeg;base64,{}\",\"birdseye\":\"data:image/png;base64,{}\"}}",
        script_json(row),
        road_share(&picture("masks")),
        script_json(&iou),
        base64(&small_jpeg(&picture("overlays"))),
        base64(&picture("birdseye"))
    )
}

/// Share of a mask that is road.
#[expect(clippy::cast_precision_loss, reason = "pixel counts")]
fn road_share(png: &[u8]) -> f64 {
    let Ok(mask) = image::load_from_memory(png) else {
        return 0.0;
    };
    let mask = mask.into_luma8();
    mask.iter().filter(|&&road| road != 0).count() as f64 / mask.len().max(1) as f64
}

/// The latency picture.
fn latency(run: &Run<'_>) -> String {
    let deadline_ms = run.title.deadline_ms;
    let said = if deadline_ms > 0.0 {
        format!(", deadline {deadline_ms:.0} ms")
    } else {
        String::new()
    };
    let png = run.folder.read("latency.png").unwrap_or_default();
    image("png", &png, &format!("time from capture to publication{said}"))
}

/// JSON that may stand in a script element.
fn script_json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value)
        .unwrap_or_default()
        .replace("</", "<\\/")
}

fn cards(report: &Report) -> String {
    let mut out = String::new();
    card(&mut out, "key frames", &report.key_frames.to_string(), "");
    if report.is_source_cut {
        card(
            &mut out,
            "recording: what came after is in no figure",
            "cut off",
            "bad",
        );
    }
    if report.has_recorded_times {
        card(&mut out, "deadlines and times", "the recorded drive's", "");
    }
    if report.is_timed {
        let misses = report.deadline_misses;
        card(
            &mut out,
            "deadline misses",
            &misses.to_string(),
            if misses == 0 { "good" } else { "bad" },
        );
    }
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
