//! Times from capture to publication of many drives as an SVG picture, over a logarithmic axis.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the picture"
)]

use std::fmt::Write as _;

use freespace::budget::DEADLINE_MICROS;

use crate::statistics::LatencyCounts;

/// Bars.
const BINS: usize = 80;
/// The plot within the picture: left, right, top, bottom.
const PLOT: (f64, f64, f64, f64) = (50.0, 780.0, 26.0, 200.0);
/// Round times that the axis names, milliseconds.
const TICKS_MS: [f64; 13] = [
    1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10_000.0,
];

/// The axis: natural logarithms of microseconds at its ends.
struct Axis {
    low: f64,
    high: f64,
}

impl Axis {
    fn share(&self, micros: u64) -> f64 {
        (((micros.max(1) as f64).ln() - self.low) / (self.high - self.low)).clamp(0.0, 1.0)
    }

    fn x(&self, micros: u64) -> f64 {
        PLOT.0 + self.share(micros) * (PLOT.1 - PLOT.0)
    }
}

/// Draws counts, what lies beyond the deadline in red; nothing of none.
pub(crate) fn latency_bars(counts: &LatencyCounts) -> String {
    let (Some(min), Some(times)) = (counts.min_micros(), counts.percentiles()) else {
        return String::new();
    };
    let longest = (1.1 * 1e3 * times.max).max(1.3 * DEADLINE_MICROS as f64);
    let axis = Axis {
        low: (0.8 * min.max(100) as f64).ln(),
        high: longest.ln(),
    };
    let mut bins = [0_u64; BINS];
    for (micros, count) in counts.iter() {
        bins[((axis.share(micros) * BINS as f64) as usize).min(BINS - 1)] += count;
    }
    let mut svg = String::from(
        "<svg viewBox=\"0 0 800 230\" role=\"img\" aria-label=\"times from capture to publication\">",
    );
    bars(&mut svg, &bins, &axis);
    ticks(&mut svg, &axis);
    let at = axis.x(DEADLINE_MICROS);
    let _ = write!(
        svg,
        "<line class=\"late\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{}\" y2=\"{}\"/><text x=\"{at:.1}\" y=\"{}\" \
         text-anchor=\"middle\">deadline</text></svg>",
        PLOT.2,
        PLOT.3,
        PLOT.2 - 8.0
    );
    svg
}

fn bars(svg: &mut String, bins: &[u64; BINS], axis: &Axis) {
    let most = bins.iter().copied().max().unwrap_or_default().max(1);
    let width = (PLOT.1 - PLOT.0) / BINS as f64;
    for (bin, count) in bins.iter().enumerate().filter(|(_, count)| **count > 0) {
        // One key frame among thousands must still be seen.
        let height = ((PLOT.3 - PLOT.2) * *count as f64 / most as f64).max(2.0);
        let is_late = bin as f64 / BINS as f64 >= axis.share(DEADLINE_MICROS);
        let _ = write!(
            svg,
            "<rect class=\"{}\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\"/>",
            if is_late { "late" } else { "bar" },
            PLOT.0 + width * bin as f64,
            PLOT.3 - height,
            width - 1.0
        );
    }
    let _ = write!(
        svg,
        "<line class=\"rule\" x1=\"{0}\" x2=\"{1}\" y1=\"{2}\" y2=\"{2}\"/><text x=\"{3}\" y=\"{4}\" \
         text-anchor=\"end\">{most}</text><text x=\"{3}\" y=\"{2}\" text-anchor=\"end\">0</text>",
        PLOT.0,
        PLOT.1,
        PLOT.3,
        PLOT.0 - 6.0,
        PLOT.2 + 8.0
    );
}

fn ticks(svg: &mut String, axis: &Axis) {
    for ms in TICKS_MS {
        let micros = (1e3 * ms) as u64;
        let share = axis.share(micros);
        if share > 0.0 && share < 1.0 {
            let (x, y) = (axis.x(micros), PLOT.3 + 18.0);
            let _ = write!(
                svg,
                "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{ms:.0} ms</text>"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::LatencyHistogram;

    #[test]
    fn late_key_frames_are_red_and_none_draw_nothing() {
        let mut histogram = LatencyHistogram::new();
        (0..1000).for_each(|i| histogram.record(40_000 + 10 * i));
        assert!(!latency_bars(&LatencyCounts::of(&histogram)).contains("rect class=\"late\""));
        histogram.record(700_000);
        let svg = latency_bars(&LatencyCounts::of(&histogram));
        assert_eq!(svg.matches("rect class=\"late\"").count(), 1);
        assert!(svg.contains(">500 ms<") && svg.contains(">deadline<") && !svg.contains("NaN"));
        assert_eq!(latency_bars(&LatencyCounts::default()), "");
    }
}
