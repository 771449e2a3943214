//! `latency.png`: how long key frames took from capture to publication, and what their stages took of it.
//!
//! In: the statistics of a drive and its deadline. Out: an RGB picture of fixed size: above, key frames over a logarithmic
//! axis of time, with deadline, percentiles and maximum marked; below, a bar a stage on a linear axis, solid up to the
//! median, pale up to p99, a line up to the maximum. Cost: once a run, a few milliseconds.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the picture"
)]

use super::canvas::{Anchor, Canvas, Colour, mixed, text_width};
use crate::statistics::{DriveStatistics, Percentiles};

const WIDTH: usize = 1200;
const HEIGHT: usize = 780;

const PANEL: Colour = [27, 31, 38];
const INK: Colour = [232, 234, 238];
const DIM: Colour = [154, 161, 173];
const GRID: Colour = [52, 58, 68];
const BAR: Colour = [69, 192, 122];
const LATE: Colour = [255, 107, 87];
const MARK: Colour = [250, 200, 88];

/// Text: of everything, and of the two headings.
const TEXT: usize = 2;
const HEADING: usize = 3;

/// The histogram's plot: left, right, top, bottom.
const PLOT: Area = Area {
    left: 150.0,
    right: 1160.0,
    top: 122.0,
    bottom: 372.0,
};
/// The stages' bars.
const BARS: Area = Area {
    left: 210.0,
    right: 880.0,
    top: 470.0,
    bottom: 704.0,
};
/// Right ends of the columns of numbers beside the bars.
const COLUMNS: [(f64, &str); 3] = [(980.0, "p50"), (1070.0, "p99"), (1160.0, "max")];
/// Lines that the labels above the plot may stand on; a label goes to the first with room.
const LABEL_LINES: [f64; 3] = [112.0, 90.0, 68.0];
/// Bars of the histogram.
const BINS: usize = 101;
/// A bar of one key frame among thousands must still be seen.
const LEAST_BAR_PX: f64 = 3.0;

/// A part of the picture, in pixels.
struct Area {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

/// Draws the statistics into `pixels`; gives width and height.
pub(super) fn draw(statistics: &DriveStatistics, deadline_ms: f64, pixels: &mut Vec<u8>) -> (usize, usize) {
    let mut canvas = Canvas::filled(pixels, WIDTH, HEIGHT, PANEL);
    canvas.text((40.0, 42.0), Anchor::Left, HEADING, "capture to publish", INK);
    let middle = (0.5 * (PLOT.left + PLOT.right), 0.5 * (PLOT.top + PLOT.bottom));
    if let Some(times) = statistics.capture_to_publish().percentiles() {
        let said = format!(
            "{} key frames, {} misses",
            statistics.key_frames(),
            statistics.misses()
        );
        let colour = if statistics.misses() == 0 { DIM } else { LATE };
        canvas.text((1160.0, 42.0), Anchor::Right, TEXT, &said, colour);
        let axis = LogAxis::around(statistics, times.max, deadline_ms);
        histogram(&mut canvas, statistics, deadline_ms, &axis);
        marks(&mut canvas, &times, deadline_ms, &axis);
        stages(&mut canvas, statistics);
    } else if !statistics.is_timed() {
        let said = "as fast as it goes: no deadline applies";
        canvas.text(middle, Anchor::Middle, TEXT, said, DIM);
        stages(&mut canvas, statistics);
    } else {
        canvas.text(middle, Anchor::Middle, TEXT, "no key frame was published", DIM);
    }
    (WIDTH, HEIGHT)
}

/// 1, 2 and 5 times the powers of ten: the largest up to `value`, or the smallest from it on.
fn round_number(value: f64, up: bool) -> f64 {
    let decade = 10_f64.powf(value.max(1e-9).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade);
    let found = if up {
        steps.into_iter().find(|step| *step >= value * (1.0 - 1e-9))
    } else {
        steps.into_iter().rev().find(|step| *step <= value * (1.0 + 1e-9))
    };
    found.unwrap_or(value)
}

/// Few digits: tenths below ten.
fn short(ms: f64) -> String {
    if ms < 9.95 {
        format!("{ms:.1}")
    } else {
        format!("{ms:.0}")
    }
}

/// Milliseconds along the histogram's plot.
struct LogAxis {
    low_ms: f64,
    high_ms: f64,
}

impl LogAxis {
    /// Holds every sample, and the deadline where there is one.
    fn around(statistics: &DriveStatistics, max_ms: f64, deadline_ms: f64) -> Self {
        let min_micros = statistics.capture_to_publish().min_micros().unwrap_or(1);
        let low_ms = round_number(
            (min_micros.max(100) as f64 * 1e-3).min(0.5 * max_ms.max(1.0)),
            false,
        );
        let high_ms = round_number((1.15 * max_ms).max(1.05 * deadline_ms).max(4.0 * low_ms), true);
        Self { low_ms, high_ms }
    }

    /// Share of the way along the axis.
    fn share(&self, ms: f64) -> f64 {
        ((ms / self.low_ms).ln() / (self.high_ms / self.low_ms).ln()).clamp(0.0, 1.0)
    }

    fn x(&self, ms: f64) -> f64 {
        PLOT.left + self.share(ms) * (PLOT.right - PLOT.left)
    }

    /// Round times from end to end.
    fn ticks(&self) -> Vec<f64> {
        let mut ticks = vec![self.low_ms];
        while let Some(&last) = ticks.last()
            && last < self.high_ms * 0.999
        {
            ticks.push(round_number(last * 1.5, true));
        }
        ticks
    }
}

/// Key frames over time; those after the deadline in its colour.
fn histogram(canvas: &mut Canvas<'_>, statistics: &DriveStatistics, deadline_ms: f64, axis: &LogAxis) {
    let mut bins = [0_u64; BINS];
    statistics.capture_to_publish().for_each(|micros, count| {
        let bin = (axis.share(micros as f64 * 1e-3) * BINS as f64) as usize;
        bins[bin.min(BINS - 1)] += count;
    });
    let most = bins.iter().copied().max().unwrap_or_default().max(1) as f64;
    let step = round_number(most / 5.0, true).max(1.0);
    let top = step * (most / step).ceil();
    let height = PLOT.bottom - PLOT.top;
    for tick in 0..=(top / step) as usize {
        let y = PLOT.bottom - height * tick as f64 * step / top;
        canvas.rectangle((PLOT.left, y), (PLOT.right, y + 1.0), GRID, 8);
        let count = format!("{:.0}", tick as f64 * step);
        canvas.text((PLOT.left - 12.0, y + 7.0), Anchor::Right, TEXT, &count, DIM);
    }
    let width = (PLOT.right - PLOT.left) / BINS as f64;
    for (bin, count) in bins.iter().enumerate().filter(|(_, count)| **count > 0) {
        let x = PLOT.left + width * bin as f64;
        let y = PLOT.bottom - (height * *count as f64 / top).max(LEAST_BAR_PX);
        let is_late = deadline_ms > 0.0 && bin as f64 / BINS as f64 >= axis.share(deadline_ms);
        let colour = if is_late { LATE } else { BAR };
        canvas.rectangle((x + 1.0, y), (x + width, PLOT.bottom), colour, 8);
    }
    let mut free_from = f64::MIN;
    for tick in axis.ticks() {
        let x = axis.x(tick);
        canvas.rectangle((x, PLOT.bottom), (x + 1.0, PLOT.bottom + 7.0), DIM, 8);
        let label = if tick < 1.0 {
            format!("{tick:.1}")
        } else {
            format!("{tick:.0}")
        };
        let half = 0.5 * text_width(&label, TEXT as f64);
        if x - half > free_from {
            canvas.text((x, PLOT.bottom + 28.0), Anchor::Middle, TEXT, &label, DIM);
            free_from = x + half + 14.0;
        }
    }
    let under = (PLOT.left - 30.0, PLOT.bottom + 28.0);
    canvas.text(under, Anchor::Right, TEXT, "ms", DIM);
}

/// A time to be marked above the plot.
struct Mark {
    ms: f64,
    name: String,
    colour: Colour,
}

impl Mark {
    fn label(&self) -> String {
        format!("{} {}", self.name, short(self.ms))
    }
}

/// What is marked, in ascending order; what reads the same is one mark.
fn marked(times: &Percentiles, deadline_ms: f64) -> Vec<Mark> {
    let mut marks: Vec<Mark> = Vec::new();
    let named = [
        (times.p50, "p50"),
        (times.p99, "p99"),
        (times.p99_9, "p99.9"),
        (times.max, "max"),
    ];
    for (ms, name) in named {
        match marks.last_mut() {
            Some(last) if short(last.ms) == short(ms) => {
                last.name = format!("{}, {name}", last.name);
                last.ms = ms;
            }
            _ => marks.push(Mark {
                ms,
                name: name.to_owned(),
                colour: MARK,
            }),
        }
    }
    if deadline_ms > 0.0 {
        marks.push(Mark {
            ms: deadline_ms,
            name: "deadline".to_owned(),
            colour: LATE,
        });
    }
    marks.sort_by(|a, b| a.ms.total_cmp(&b.ms));
    marks
}

/// Percentiles, maximum and deadline as lines with labels above the plot.
fn marks(canvas: &mut Canvas<'_>, times: &Percentiles, deadline_ms: f64, axis: &LogAxis) {
    let mut ends = [f64::MIN; LABEL_LINES.len()];
    for mark in marked(times, deadline_ms) {
        let (x, label) = (axis.x(mark.ms), mark.label());
        let half = 0.5 * text_width(&label, TEXT as f64);
        let middle = x.min(PLOT.right - half);
        let free = ends.iter().position(|end| middle - half > *end);
        let line = free.unwrap_or(LABEL_LINES.len() - 1);
        ends[line] = middle + half + 14.0;
        let (dash, width) = if mark.colour == LATE {
            (7.0, 2.0)
        } else {
            (3.0, 1.0)
        };
        let mut from = LABEL_LINES[line] + 5.0;
        while from < PLOT.bottom {
            let to = (from + dash).min(PLOT.bottom);
            canvas.rectangle((x, from), (x + width, to), mark.colour, 8);
            from += dash + 4.0;
        }
        // The line of a higher label may run through a lower one.
        let y = LABEL_LINES[line];
        let (left, right) = (middle - half - 3.0, middle + half + 3.0);
        canvas.rectangle((left, y - 16.0), (right, y + 4.0), PANEL, 8);
        canvas.text((middle, y), Anchor::Middle, TEXT, &label, mark.colour);
    }
}

fn stages(canvas: &mut Canvas<'_>, statistics: &DriveStatistics) {
    let heading = (40.0, BARS.top - 32.0);
    canvas.text(heading, Anchor::Left, HEADING, "time of each stage", INK);
    for (right, name) in COLUMNS {
        canvas.text((right, BARS.top - 12.0), Anchor::Right, TEXT, name, DIM);
    }
    let mut rows = statistics.stages_ms();
    rows.extend(statistics.frame_ms().map(|times| ("every frame", times)));
    let longest = rows.iter().map(|(_, times)| times.max).fold(0.1, f64::max);
    let step = round_number(longest / 6.0, true);
    let end_ms = step * (longest / step).ceil();
    let x = |ms: f64| BARS.left + ms / end_ms * (BARS.right - BARS.left);
    for tick in 0..=(end_ms / step).round() as usize {
        let ms = tick as f64 * step;
        canvas.rectangle((x(ms), BARS.top), (x(ms) + 1.0, BARS.bottom), GRID, 8);
        let label = if step < 1.0 {
            format!("{ms:.1}")
        } else {
            format!("{ms:.0}")
        };
        canvas.text((x(ms), BARS.bottom + 22.0), Anchor::Middle, TEXT, &label, DIM);
    }
    canvas.text(
        (BARS.left - 24.0, BARS.bottom + 22.0),
        Anchor::Right,
        TEXT,
        "ms",
        DIM,
    );
    let pitch = (BARS.bottom - BARS.top) / 9.0;
    for (row, (name, times)) in rows.iter().enumerate() {
        let middle = BARS.top + pitch * (row as f64 + 0.5);
        let (top, bottom) = (middle - 8.0, middle + 8.0);
        canvas.text((BARS.left - 14.0, middle + 7.0), Anchor::Right, TEXT, name, INK);
        canvas.rectangle((x(0.0), middle - 1.0), (x(times.max), middle + 1.0), DIM, 8);
        canvas.rectangle(
            (x(times.max) - 2.0, top + 2.0),
            (x(times.max), bottom - 2.0),
            DIM,
            8,
        );
        canvas.rectangle((x(0.0), top), (x(times.p99), bottom), mixed(PANEL, BAR, 3), 8);
        canvas.rectangle((x(0.0), top), (x(times.p50), bottom), BAR, 8);
        for ((right, _), ms) in COLUMNS.into_iter().zip([times.p50, times.p99, times.max]) {
            canvas.text(
                (right, middle + 7.0),
                Anchor::Right,
                TEXT,
                &format!("{ms:.1}"),
                INK,
            );
        }
    }
    let levels = format!("quality: {}", statistics.levels().line());
    canvas.text((40.0, HEIGHT as f64 - 24.0), Anchor::Left, TEXT, &levels, DIM);
}
