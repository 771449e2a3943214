//! The latency histogram as bars of text, what lies beyond the budget in red.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the window"
)]

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style};

use crate::monitor::snapshot::Snapshot;

const EIGHTHS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Draws into `area`: percentiles, bars, a scale.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, snapshot: &Snapshot) {
    if area.height < 3 || area.width < 8 {
        return;
    }
    let latency = &snapshot.latency;
    let budget_ms = snapshot
        .message
        .as_ref()
        .map_or(500.0, |message| message.budget_ms);
    let text = latency.percentiles.map_or_else(
        || "no sample yet".to_owned(),
        |times| {
            format!(
                "p50 {:.0}  p99 {:.0}  p99.9 {:.0}  max {:.0} ms  ({})",
                times.p50, times.p99, times.p99_9, times.max, latency.count
            )
        },
    );
    buffer.set_stringn(area.x, area.y, text, usize::from(area.width), Style::new());
    let group = latency.bins.len().div_ceil(usize::from(area.width)).max(1);
    let bars: Vec<u64> = latency.bins.chunks(group).map(|bins| bins.iter().sum()).collect();
    let most = bars.iter().copied().max().unwrap_or(0).max(1);
    let height = area.height - 2;
    let bar_ms = latency.bin_ms * group as f64;
    for (x, count) in bars.iter().enumerate() {
        // Whatever was seen once shows.
        let eighths = (*count as f64 / most as f64 * f64::from(height) * 8.0).ceil() as u16;
        let is_late = x as f64 * bar_ms >= budget_ms;
        let colour = if is_late { Color::Red } else { Color::Green };
        for row in 0..height {
            let filled = eighths.saturating_sub(8 * (height - 1 - row)).min(8);
            let cell = &mut buffer[(area.x + x as u16, area.y + 1 + row)];
            cell.set_char(EIGHTHS[usize::from(filled)]).set_fg(colour);
        }
    }
    let last = area.y + area.height - 1;
    let dim = Style::new().fg(Color::DarkGray);
    buffer.set_string(area.x, last, "0", dim);
    let at = (budget_ms / bar_ms) as u16;
    let label = format!("^ budget {budget_ms:.0} ms");
    let room = usize::from(area.width.saturating_sub(at));
    if room >= label.len() {
        buffer.set_string(area.x + at, last, label, dim);
    } else {
        let label = format!("budget {budget_ms:.0} ms ^");
        let start = (at + 1).saturating_sub(label.len() as u16);
        buffer.set_stringn(area.x + start, last, label, usize::from(area.width - start), dim);
    }
}
