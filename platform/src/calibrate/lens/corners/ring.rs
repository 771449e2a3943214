//! The ring test: around the corner of four squares the brightness changes sides exactly four times.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;

use super::plane::Plane;

/// Radius of the ring, pixels: squares are larger than this.
const RADIUS_PX: f64 = 5.0;
const SAMPLES: u16 = 32;
/// The faintest corner, half the difference between bright and dark, gray levels.
const FAINTEST: f64 = 5.0;
/// How far the two halves of an edge may be from a straight line: the candidate is not yet at the exact corner.
const BENT_RAD: f64 = 0.6;
/// The narrowest corner of a square, seen from the side.
const NARROWEST_RAD: f64 = 0.3;

/// Two edges that cross.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// Directions of the edges, radians in `0..PI`.
    pub(super) edges: [f64; 2],
    /// Angle of twice the bright diagonal: neighbours on a board differ by half a turn.
    pub(super) phase: f64,
}

impl Crossing {
    /// Whether a corner's neighbour may look like that: bright where this one is dark.
    pub(super) fn is_opposite(&self, other: &Self) -> bool {
        (self.phase - other.phase).cos() < -0.4
    }
}

/// The edges through a point; none where it is no corner of four squares.
pub(super) fn crossing(blurred: &Plane, at: &Vector2<f64>) -> Option<Crossing> {
    let mut values = [0.0; SAMPLES as usize];
    for (value, sample) in values.iter_mut().zip(0..SAMPLES) {
        let (sin, cos) = angle(f64::from(sample)).sin_cos();
        *value = f64::from(blurred.sample(at.x + RADIUS_PX * cos, at.y + RADIUS_PX * sin)?);
    }
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if 0.5 * (high - low) < FAINTEST {
        return None;
    }
    let middle = 0.5 * (high + low);
    let changes = sign_changes(&values, middle)?;
    let edge = |a: f64, b: f64| {
        let bent = (b - a - PI).abs();
        (bent < BENT_RAD).then(|| (0.5 * (a + b - PI)).rem_euclid(PI))
    };
    let edges = [edge(changes[0], changes[2])?, edge(changes[1], changes[3])?];
    let between = (edges[0] - edges[1]).abs();
    if between.min(PI - between) < NARROWEST_RAD {
        return None;
    }
    let (mut x, mut y) = (0.0, 0.0);
    for (value, sample) in values.iter().zip(0..SAMPLES) {
        let (sin, cos) = (2.0 * angle(f64::from(sample))).sin_cos();
        x += (value - middle) * cos;
        y += (value - middle) * sin;
    }
    Some(Crossing {
        edges,
        phase: y.atan2(x),
    })
}

fn angle(sample: f64) -> f64 {
    sample * TAU / f64::from(SAMPLES)
}

/// The four angles at which the ring changes sides; none where they are more or fewer.
fn sign_changes(values: &[f64; SAMPLES as usize], middle: f64) -> Option<[f64; 4]> {
    let mut changes = [0.0; 4];
    let mut count = 0;
    for sample in 0..SAMPLES {
        let here = values[usize::from(sample)] - middle;
        let next = values[usize::from((sample + 1) % SAMPLES)] - middle;
        if (here < 0.0) != (next < 0.0) {
            *changes.get_mut(count)? = angle(f64::from(sample) + here / (here - next));
            count += 1;
        }
    }
    (count == 4).then_some(changes)
}
