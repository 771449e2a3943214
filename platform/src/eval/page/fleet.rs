//! A fleet: its totals, its latencies, and its drives.

use super::percent;
use crate::eval::fleet::{DriveScore, Fleet, Ratios};
use crate::page::{Page, latency_bars};

/// The page.
#[must_use]
pub fn render(fleet: &Fleet) -> String {
    let mut page = Page::new("freespace fleet");
    cards(&mut page, fleet);
    let counts = &fleet.totals.counts;
    page.panel(
        "time from capture to publication",
        &latency_bars(&counts.capture_to_publish),
    );
    let named = |counts: &std::collections::BTreeMap<String, u64>| -> Vec<Vec<String>> {
        counts
            .iter()
            .map(|(name, count)| vec![name.clone(), count.to_string()])
            .collect()
    };
    page.table(
        "answers by quality level",
        &["level", "key frames"],
        &named(&counts.levels),
    );
    if !counts.misses_by_stage.is_empty() {
        page.table(
            "misses by what is to blame",
            &["blamed", "key frames"],
            &named(&counts.misses_by_stage),
        );
    }
    let columns = [
        "drive",
        "key frames",
        "misses",
        "p50, ms",
        "p99, ms",
        "km",
        "road F",
        "IoU",
        "position error, m",
        "scale error",
    ];
    let rows: Vec<Vec<String>> = fleet.drives.iter().map(row).collect();
    page.table("drives", &columns, &rows);
    if !fleet.failed.is_empty() {
        let rows: Vec<_> = (fleet.failed.iter())
            .map(|drive| vec![drive.name.clone(), drive.cause.clone()])
            .collect();
        page.table("not evaluated, and in no sum", &["drive", "cause"], &rows);
    }
    page.finish()
}

fn cards(page: &mut Page, fleet: &Fleet) {
    let (counts, ratios) = (&fleet.totals.counts, &fleet.totals.ratios);
    page.card(
        "drives",
        &format!("{} of {}", fleet.totals.drives, fleet.list.drives),
        "",
    );
    page.card("driven", &format!("{:.1} km", ratios.driven_km), "");
    if counts.cut_drives > 0 {
        page.card("recordings cut off", &counts.cut_drives.to_string(), "bad");
    }
    page.card("key frames", &counts.key_frames.to_string(), "");
    let state = if counts.deadline_misses == 0 {
        "good"
    } else {
        "bad"
    };
    page.card("deadline misses", &counts.deadline_misses.to_string(), state);
    if let Some(times) = fleet.totals.capture_to_publish_ms {
        page.card("capture to publish, median", &format!("{:.1} ms", times.p50), "");
        page.card("p99.9", &format!("{:.1} ms", times.p99_9), "");
    }
    for (label, share) in [
        ("road F", ratios.road_f),
        ("free-space IoU, 0 to 30 m", ratios.free_space_iou),
        ("occupied cells called free", ratios.falsely_free),
        ("distance error", ratios.distance_error),
    ] {
        if let Some(share) = share {
            page.card(label, &percent(share), "");
        }
    }
}

fn row(drive: &DriveScore) -> Vec<String> {
    let (counts, ratios) = (&drive.counts, Ratios::of(&drive.counts));
    let times = counts.capture_to_publish.percentiles();
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    vec![
        drive.name.clone(),
        counts.key_frames.to_string(),
        counts.deadline_misses.to_string(),
        or_dash(times.map(|times| format!("{:.1}", times.p50))),
        or_dash(times.map(|times| format!("{:.1}", times.p99))),
        format!("{:.3}", ratios.driven_km),
        or_dash(ratios.road_f.map(percent)),
        or_dash(ratios.free_space_iou.map(percent)),
        or_dash(drive.trajectory.map(|row| format!("{:.2}", row.ate_se3_m))),
        or_dash(drive.trajectory.and_then(|row| row.scale_error).map(percent)),
    ]
}
