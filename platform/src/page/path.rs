//! Paths from above as an SVG picture: ahead of the first camera up, a scale bar, the truth dashed.

use std::fmt::Write as _;

use nalgebra::Vector3;

/// Points of a path that are drawn.
const MOST_POINTS: usize = 1500;
/// The picture, and the part of it that the paths may fill; below lie scale bar and legend.
const SIZE: (f64, f64) = (300.0, 300.0);
const DRAWN: f64 = 240.0;

/// A point of the picture before scaling: right, and behind.
type Point = (f64, f64);

/// Draws positions relative to the first camera, x right, z ahead, in metres; `truth` may have none.
pub(crate) fn paths(estimate: &[Vector3<f64>], truth: &[Vector3<f64>]) -> String {
    let (estimate, truth) = (thinned(estimate), thinned(truth));
    let Some(view) = View::around(&[&estimate[..], &truth[..]].concat()) else {
        return String::new();
    };
    let mut svg = format!(
        "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"path from above{}\">",
        SIZE.0,
        SIZE.1,
        if truth.is_empty() {
            ""
        } else {
            ", and the true path"
        }
    );
    view.line(&mut svg, "", &estimate);
    view.line(&mut svg, "true", &truth);
    for (class, end) in [("start", estimate.first()), ("", estimate.last())] {
        if let Some(point) = end {
            let (x, y) = view.place(*point);
            let _ = write!(
                svg,
                "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"/>"
            );
        }
    }
    view.scale_bar(&mut svg);
    if !truth.is_empty() {
        let (left, y) = (SIZE.0 - 140.0, SIZE.1 - 14.0);
        for (x, class, name) in [(left, "", "estimate"), (left + 82.0, "true", "truth")] {
            let _ = write!(
                svg,
                "<polyline class=\"{class}\" points=\"{x},{} {},{}\"/><text x=\"{}\" y=\"{y}\">{name}</text>",
                y - 4.0,
                x + 18.0,
                y - 4.0,
                x + 22.0
            );
        }
    }
    svg.push_str("</svg>");
    svg
}

fn thinned(positions: &[Vector3<f64>]) -> Vec<Point> {
    let stride = positions.len().div_ceil(MOST_POINTS).max(1);
    let points = positions.iter().step_by(stride).chain(positions.last());
    points
        .map(|position| (position.x, -position.z))
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .collect()
}

/// 1, 2 or 5 times a power of ten, at most `value`.
fn round_length(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [5.0, 2.0, 1.0].map(|step| step * decade);
    steps.into_iter().find(|step| *step <= value).unwrap_or(decade)
}

/// How metres come to the picture.
struct View {
    middle: Point,
    scale: f64,
    extent_m: f64,
}

impl View {
    /// Holds all points; none of none.
    fn around(points: &[Point]) -> Option<Self> {
        let first = points.first()?;
        let (low, high) = points.iter().fold((*first, *first), |(low, high), (x, y)| {
            ((low.0.min(*x), low.1.min(*y)), (high.0.max(*x), high.1.max(*y)))
        });
        let extent_m = (high.0 - low.0).max(high.1 - low.1).max(1.0);
        Some(Self {
            middle: (0.5 * (low.0 + high.0), 0.5 * (low.1 + high.1)),
            scale: DRAWN / extent_m,
            extent_m,
        })
    }

    fn place(&self, (x, y): Point) -> Point {
        (
            0.5 * SIZE.0 + (x - self.middle.0) * self.scale,
            0.5 * DRAWN + 12.0 + (y - self.middle.1) * self.scale,
        )
    }

    fn line(&self, svg: &mut String, class: &str, points: &[Point]) {
        if points.is_empty() {
            return;
        }
        let _ = write!(svg, "<polyline class=\"{class}\" points=\"");
        for point in points {
            let (x, y) = self.place(*point);
            let _ = write!(svg, "{x:.1},{y:.1} ");
        }
        svg.push_str("\"/>");
    }

    fn scale_bar(&self, svg: &mut String) {
        let metres = round_length(0.4 * self.extent_m);
        let (left, y) = (16.0, SIZE.1 - 14.0);
        let right = left + metres * self.scale;
        let _ = write!(
            svg,
            "<path class=\"scale\" d=\"M{left:.1} {:.1}v6h{:.1}v-6\"/><text x=\"{:.1}\" y=\"{y:.1}\">{metres} m</text>",
            y - 6.0,
            right - left,
            right + 6.0
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_have_one_scale_and_nothing_draws_nothing() {
        let path: Vec<_> = (0..5000)
            .map(|i| Vector3::new(0.0, 0.0, f64::from(i) * 0.1))
            .collect();
        let svg = paths(&path, &path[..100]);
        assert!(svg.contains("the true path") && svg.contains(">100 m</text>"));
        assert!(svg.len() < 40_000 && svg.matches("<circle").count() == 2);
        assert_eq!(paths(&[], &[]), "");
        assert_eq!(paths(&[Vector3::repeat(f64::NAN)], &[]), "");
        assert!(!paths(&path[..1], &[]).contains("NaN"));
    }

    #[test]
    fn lengths_are_round() {
        for (value, wanted) in [(0.4, 0.2), (1.0, 1.0), (99.0, 50.0), (480.0, 200.0)] {
            assert_eq!(round_length(value), wanted);
        }
    }
}
