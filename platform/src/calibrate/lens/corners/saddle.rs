//! Saddles of the brightness: where two dark and two bright squares may meet.
//!
//! In: a blurred picture. Out: candidates, strongest first, at most `MOST`. Cost: one pass, and a ring a peak.
#![allow(
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use nalgebra::Vector2;

use super::plane::Plane;
use super::ring::{Crossing, crossing};

/// Candidates kept, strongest first: a board of 50 x 50 corners and some texture beside it.
pub(super) const MOST: usize = 3000;
/// A saddle weaker than this share of the strongest is texture.
const WEAKEST: f32 = 0.003;
/// The response of the faintest board that is read: an amplitude of 8 gray levels under a blur of 2 px.
const FAINTEST: f32 = 0.4;
/// Pixels at the edge that have no full ring around them.
const MARGIN: usize = 7;

/// A point that looks like the corner of four squares.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) at: Vector2<f64>,
    pub(super) crossing: Crossing,
}

/// All candidates of a picture.
pub(super) fn candidates(blurred: &Plane) -> Vec<Candidate> {
    let (width, height) = (blurred.width(), blurred.height());
    if width < 2 * MARGIN + 3 || height < 2 * MARGIN + 3 {
        return Vec::new();
    }
    let response = responses(blurred);
    let strongest = response.iter().copied().fold(0.0, f32::max);
    let threshold = (WEAKEST * strongest).max(FAINTEST);
    let mut peaks: Vec<(f32, usize, usize)> = Vec::new();
    for y in MARGIN..height - MARGIN {
        for x in MARGIN..width - MARGIN {
            let value = response[y * width + x];
            if value > threshold && is_peak(&response, width, x, y) {
                peaks.push((value, x, y));
            }
        }
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
    peaks.truncate(MOST);
    peaks
        .into_iter()
        .filter_map(|(_, x, y)| {
            let at = Vector2::new(x as f64, y as f64) + within_pixel(&response, width, x, y);
            crossing(blurred, &at).map(|crossing| Candidate { at, crossing })
        })
        .collect()
}

/// Minus the determinant of the Hessian: positive at saddles.
fn responses(blurred: &Plane) -> Vec<f32> {
    let (width, height) = (blurred.width(), blurred.height());
    let mut response = vec![0.0; width * height];
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let centre = 2.0 * blurred.at(x, y);
            let xx = blurred.at(x + 1, y) + blurred.at(x - 1, y) - centre;
            let yy = blurred.at(x, y + 1) + blurred.at(x, y - 1) - centre;
            let xy = 0.25
                * (blurred.at(x + 1, y + 1) + blurred.at(x - 1, y - 1)
                    - blurred.at(x + 1, y - 1)
                    - blurred.at(x - 1, y + 1));
            response[y * width + x] = xy * xy - xx * yy;
        }
    }
    response
}

fn is_peak(response: &[f32], width: usize, x: usize, y: usize) -> bool {
    let value = response[y * width + x];
    for row in y - 2..=y + 2 {
        for column in x - 2..=x + 2 {
            let other = response[row * width + column];
            // Of equal neighbours the first one is the peak.
            let wins = value > other || (value == other && (y, x) <= (row, column));
            if !wins {
                return false;
            }
        }
    }
    true
}

/// The peak of a parabola through the response, a pixel at most from its centre.
fn within_pixel(response: &[f32], width: usize, x: usize, y: usize) -> Vector2<f64> {
    let along = |step: usize| {
        let at = y * width + x;
        let (before, here, after) = (response[at - step], response[at], response[at + step]);
        let bend = before + after - 2.0 * here;
        if bend < 0.0 {
            f64::from(0.5 * (before - after) / bend).clamp(-0.5, 0.5)
        } else {
            0.0
        }
    };
    Vector2::new(along(1), along(width))
}
