//! A corner to a few hundredths of a pixel: the point that all gradients around it are at right angles to.
//!
//! In: a lightly blurred picture, the lattice. Out: the lattice with its corners moved; one that moves too far, or has no
//! gradients in two directions, is left out. Cost: a window of at most 21 x 21 pixels, `STEPS` times a corner.
//! Source: Förstner and Gülch 1987: minimise the sum of `w (g . (q - p))^2`.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use nalgebra::{Matrix2, Vector2};

use super::lattice::Lattice;
use super::plane::Plane;

const STEPS: usize = 20;
/// Half the window as a share of the distance to the nearest corner: its own edges only.
const WINDOW: f64 = 0.35;
/// Smallest and largest half window.
const HALF_PX: (f64, f64) = (2.0, 10.0);
/// A move by less ends the search.
const STILL_PX: f64 = 0.002;

pub(super) fn refined(blurred: &Plane, lattice: &Lattice) -> Lattice {
    lattice.mapped(|place, corner| {
        let step = lattice.shortest_step(place)?;
        let half = (WINDOW * step).clamp(HALF_PX.0, HALF_PX.1);
        let mut at = *corner;
        for _ in 0..STEPS {
            let next = moved(blurred, &at, half)?;
            let moved = (next - at).norm();
            at = next;
            if moved < STILL_PX {
                break;
            }
        }
        ((at - corner).norm() < 0.5 * half + 1.0).then_some(at)
    })
}

/// One step: gradients weighed by their distance from `at`; none at the picture's edge or without two edges.
fn moved(blurred: &Plane, at: &Vector2<f64>, half: f64) -> Option<Vector2<f64>> {
    let reach = half.ceil() as isize;
    let centre = (at.x.round() as isize, at.y.round() as isize);
    let (width, height) = (blurred.width() as isize, blurred.height() as isize);
    let is_inside = centre.0 - reach > 0
        && centre.1 - reach > 0
        && centre.0 + reach < width - 1
        && centre.1 + reach < height - 1;
    if !is_inside {
        return None;
    }
    let (mut sum, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for y in centre.1 - reach..=centre.1 + reach {
        for x in centre.0 - reach..=centre.0 + reach {
            let offset = Vector2::new(x as f64, y as f64) - at;
            let (column, row) = (x as usize, y as usize);
            let gradient = Vector2::new(
                f64::from(blurred.at(column + 1, row) - blurred.at(column - 1, row)),
                f64::from(blurred.at(column, row + 1) - blurred.at(column, row - 1)),
            );
            let near = offset / (0.6 * half);
            let weight = (-0.5 * near.norm_squared()).exp();
            let part = gradient * gradient.transpose() * weight;
            sum += part;
            right += part * offset;
        }
    }
    // Two edges that are nearly one have no crossing.
    let is_sound = sum.determinant() > 1e-3 * sum.trace() * sum.trace();
    let step = is_sound.then(|| sum.try_inverse()).flatten()? * right;
    Some(at + step)
}
