//! Translation averaging: the positions that agree best with all directions of the view graph and the wheel distances.
//!
//! In: unit directions between views in world space (orientations already averaged), metric steps along the path, which views
//! are held. Out: the free views' positions, in place. Cost: [`SWEEPS`] solutions of at most 3 x
//! [`WINDOW_VIEWS`](crate::budget::WINDOW_VIEWS) unknowns.
//! Source: the cross-product equations of Govindu (2001), reweighted by least unsquared deviations (Ozyesil and Singer 2015),
//! then, near the solution, by Geman-McClure;
//! the distances, which fix the scale in the same equations, are this project's.

use nalgebra::{Matrix3, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::dense::solve_cholesky;
use crate::budget::WINDOW_VIEWS;

/// Reweighted sweeps, half of each kind.
const SWEEPS: usize = 8;
/// Angle below which the deviation of a direction counts as squared: what two-view geometry is good for over a metre.
const DIRECTION_SIGMA_RAD: f64 = 0.01;
/// Ties every view to where it was, in units of a direction's weight at one metre.
const TIE: f64 = 1e-4;

/// `direction` points from the first camera to the second.
#[derive(Clone, Copy, Debug)]
pub(super) struct DirectionEdge {
    pub(super) first: usize,
    pub(super) second: usize,
    pub(super) direction: Vector3<f64>,
    pub(super) weight: f64,
}

/// A metric step between neighbours: `offset` is what the distance is measured between less the cameras' positions
/// (second less first), so that the lever arm of the rear axle counts.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepEdge {
    pub(super) first: usize,
    pub(super) second: usize,
    pub(super) offset: Vector3<f64>,
    pub(super) length_m: f64,
    pub(super) sigma_m: f64,
}

struct Equations {
    held: usize,
    n: usize,
    normal: [f64; 9 * WINDOW_VIEWS * WINDOW_VIEWS],
    side: [f64; 3 * WINDOW_VIEWS],
}

impl Equations {
    fn new(held: usize, views: usize) -> Self {
        let n = 3 * (views - held);
        let mut new = Self {
            held,
            n,
            normal: [0.0; 9 * WINDOW_VIEWS * WINDOW_VIEWS],
            side: [0.0; 3 * WINDOW_VIEWS],
        };
        for i in 0..n {
            new.normal[i * n + i] = TIE;
        }
        new
    }

    /// Adds `weight` times the squared error `error + step second - step first`, `weight` being a 3 x 3 matrix.
    fn add(&mut self, first: usize, second: usize, weight: &Matrix3<f64>, error: &Vector3<f64>) {
        let pull = weight * error;
        let ends = [
            (first.checked_sub(self.held), -1.0),
            (second.checked_sub(self.held), 1.0),
        ];
        for (a, sign_a) in ends {
            let Some(a) = a else { continue };
            for r in 0..3 {
                self.side[3 * a + r] -= sign_a * pull[r];
                for (b, sign_b) in ends {
                    let Some(b) = b else { continue };
                    for c in 0..3 {
                        self.normal[(3 * a + r) * self.n + 3 * b + c] += sign_a * sign_b * weight[(r, c)];
                    }
                }
            }
        }
    }
}

/// Improves `positions[held..]` in place.
pub(super) fn average_translations(
    directions: &[DirectionEdge],
    steps: &[StepEdge],
    held: usize,
    positions: &mut [Vector3<f64>],
) {
    if positions.len() <= held || positions.len() - held > WINDOW_VIEWS {
        return;
    }
    for sweep in 0..SWEEPS {
        let mut equations = Equations::new(held, positions.len());
        for edge in directions {
            let between = positions[edge.second] - positions[edge.first];
            let length = between.norm().max(0.05);
            let off_line = Matrix3::identity() - edge.direction * edge.direction.transpose();
            let angle = (off_line * between).norm() / length;
            let robust = if sweep < SWEEPS / 2 {
                1.0 / angle.max(DIRECTION_SIGMA_RAD)
            } else {
                (1.0 + (angle / (3.0 * DIRECTION_SIGMA_RAD)).powi(2)).powi(-2) / DIRECTION_SIGMA_RAD
            };
            let weight = edge.weight * robust / (DIRECTION_SIGMA_RAD * length * length);
            equations.add(edge.first, edge.second, &(off_line * weight), &between);
        }
        for step in steps {
            let between = positions[step.second] - positions[step.first] + step.offset;
            let Some(along) = between.try_normalize(1e-6) else {
                continue;
            };
            let weight = along * along.transpose() / step.sigma_m.powi(2);
            equations.add(
                step.first,
                step.second,
                &weight,
                &(between - along * step.length_m),
            );
        }
        let n = equations.n;
        if !solve_cholesky(&mut equations.normal[..n * n], n, &mut equations.side[..n]) {
            return;
        }
        for (i, position) in positions[held..].iter_mut().enumerate() {
            *position += Vector3::new(
                equations.side[3 * i],
                equations.side[3 * i + 1],
                equations.side[3 * i + 2],
            );
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn path_returns_from_directions_and_distances(bends in prop::array::uniform7(-0.2..0.2f64), wrong_edge in 0usize..12) {
            let mut truth = [Vector3::zeros(); 8];
            for k in 1..8 {
                let heading: f64 = bends[..k].iter().sum();
                truth[k] = truth[k - 1] + 1.2 * Vector3::new(heading.cos(), heading.sin(), 0.05 * bends[k - 1]);
            }
            let mut directions: heapless::Vec<DirectionEdge, 18> = heapless::Vec::new();
            for span in 1..=3 {
                for first in 0..8 - span {
                    let second = first + span;
                    directions.push(DirectionEdge { first, second, direction: (truth[second] - truth[first]).normalize(), weight: 1.0 }).unwrap();
                }
            }
            directions[wrong_edge].direction = Vector3::new(0.6, 0.8, 0.0);
            let steps: [StepEdge; 7] = core::array::from_fn(|k| StepEdge {
                first: k, second: k + 1, offset: Vector3::zeros(), length_m: (truth[k + 1] - truth[k]).norm(), sigma_m: 0.01,
            });
            let mut found = truth;
            for k in 1..8 {
                found[k] += Vector3::new(0.15, -0.1, 0.05) * (k % 3) as f64;
            }
            average_translations(&directions, &steps, 1, &mut found);
            for k in 0..8 {
                prop_assert!((found[k] - truth[k]).norm() < 0.06, "{k}: {}", (found[k] - truth[k]).norm());
            }
        }
    }
}
