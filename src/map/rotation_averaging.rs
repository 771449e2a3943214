//! Rotation averaging: the orientations that agree best with all relative rotations of the view graph.
//!
//! In: relative rotations between views, which views are held. Out: the free views' orientations, in place. Views that no
//! relative rotation reaches keep theirs. Cost: [`SWEEPS`] solutions of a Laplacian of at most
//! [`WINDOW_VIEWS`](crate::budget::WINDOW_VIEWS) unknowns.
//! Source: Chatterjee and Govindu, *Robust relative rotation averaging* (PAMI 2018): L1 sweeps, then Geman-McClure
//! reweighting on so(3), for the motion averaging of Robust SLAM.

use nalgebra::{UnitQuaternion, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::dense::solve_cholesky;
use crate::budget::WINDOW_VIEWS;

/// Reweighted sweeps: the first half L1, the rest Geman-McClure.
const SWEEPS: usize = 8;
/// Scale of the Geman-McClure weight: Chatterjee and Govindu's five degrees are for photo collections; between frames of a
/// drive a tenth of it.
const ERROR_SCALE_RAD: f64 = 0.009;
/// Ties every view to where it was, so that the equations always have a solution.
const TIE: f64 = 1e-6;

/// `rotation` takes the second view's space to the first's.
#[derive(Clone, Copy, Debug)]
pub(super) struct RotationEdge {
    pub(super) first: usize,
    pub(super) second: usize,
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) weight: f64,
}

/// Improves `world_from_view[held..]` in place.
pub(super) fn average_rotations(
    edges: &[RotationEdge],
    held: usize,
    world_from_view: &mut [UnitQuaternion<f64>],
) {
    let n = world_from_view.len().saturating_sub(held);
    if n == 0 || n > WINDOW_VIEWS {
        return;
    }
    for sweep in 0..SWEEPS {
        let mut laplacian = [0.0; WINDOW_VIEWS * WINDOW_VIEWS];
        let mut sides = [0.0; 3 * WINDOW_VIEWS];
        for i in 0..n {
            laplacian[i * n + i] = TIE;
        }
        for edge in edges {
            let error = error_in_world(edge, world_from_view);
            let size = error.norm();
            let robust = if sweep < SWEEPS / 2 {
                1.0 / size.max(1e-4)
            } else {
                (ERROR_SCALE_RAD.powi(2) / (ERROR_SCALE_RAD.powi(2) + size * size)).powi(2) / ERROR_SCALE_RAD
            };
            let weight = edge.weight * robust;
            let (first, second) = (edge.first.checked_sub(held), edge.second.checked_sub(held));
            for (unknown, sign) in [(first, -1.0), (second, 1.0)] {
                if let Some(i) = unknown {
                    laplacian[i * n + i] += weight;
                    for axis in 0..3 {
                        sides[axis * n + i] -= sign * weight * error[axis];
                    }
                }
            }
            if let (Some(i), Some(j)) = (first, second) {
                laplacian[i.max(j) * n + i.min(j)] -= weight;
            }
        }
        if !solve_cholesky(&mut laplacian[..n * n], n, &mut sides[..3 * n]) {
            return;
        }
        for i in 0..n {
            let turn = Vector3::new(sides[i], sides[n + i], sides[2 * n + i]);
            world_from_view[held + i] = UnitQuaternion::from_scaled_axis(turn) * world_from_view[held + i];
        }
    }
}

/// Rotation from where the edge puts the second view to where it is, in world space.
fn error_in_world(edge: &RotationEdge, world_from_view: &[UnitQuaternion<f64>]) -> Vector3<f64> {
    let expected = world_from_view[edge.first] * edge.rotation;
    (world_from_view[edge.second] * expected.inverse()).scaled_axis()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn truth_returns_from_edges_with_a_wrong_one(
            turns in prop::collection::vec(prop::array::uniform3(-0.2..0.2f64), 8),
            wrong in prop::array::uniform3(-0.5..0.5f64),
            wrong_edge in 0usize..18,
        ) {
            let mut truth: heapless::Vec<UnitQuaternion<f64>, 8> = heapless::Vec::new();
            let mut pose = UnitQuaternion::identity();
            for turn in &turns {
                pose *= UnitQuaternion::from_scaled_axis(Vector3::from(*turn));
                truth.push(pose).unwrap();
            }
            let mut edges: heapless::Vec<RotationEdge, 18> = heapless::Vec::new();
            for span in 1..=3 {
                for first in 0..8 - span {
                    let second = first + span;
                    let rotation = truth[first].inverse() * truth[second];
                    edges.push(RotationEdge { first, second, rotation, weight: 1.0 }).unwrap();
                }
            }
            edges[wrong_edge].rotation *= UnitQuaternion::from_scaled_axis(Vector3::from(wrong));
            let mut found = truth.clone();
            for (k, rotation) in found.iter_mut().enumerate().skip(1) {
                *rotation *= UnitQuaternion::from_scaled_axis(Vector3::new(0.02, -0.01, 0.015) * (k % 3) as f64);
            }
            average_rotations(&edges, 1, &mut found);
            // The last view hangs on three edges; the wrong one weighs little against the other two.
            for k in 0..8 {
                prop_assert!(found[k].angle_to(&truth[k]) < 5e-3, "{k}: {}", found[k].angle_to(&truth[k]));
            }
        }
    }
}
