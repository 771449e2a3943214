//! Places new views: motion averaging over the batch, then the landmarks.
//!
//! In: the window with its new views where the tracked motion puts them. Out: their poses. Relative poses of neighbours are averaged,
//! rotations first; each view is then resected where there are enough landmarks. Invariant: views before the new ones stay; what is
//! not finite is left as it was. Source: Patra et al., Robust SLAM (2017), as in [`super`].

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::super::motion_factor::wheel_sigma_m;
use super::super::resection::{mismatch, resect};
use super::super::rotation_averaging::{RotationEdge, average_rotations};
use super::super::translation_averaging::{DirectionEdge, StepEdge, average_translations};
use super::super::two_view::{Match, relative_pose};
use super::super::window::is_finite;
use super::Map;
use crate::budget::{BATCH_VIEWS, MAX_TRACKS, VIEW_GRAPH_SPAN, WINDOW_VIEWS};
use crate::space::Pose;

/// Weight of a tracked rotation among the averaged ones, in inliers.
const TRACKED_WEIGHT: f64 = 5.0;
/// Standard deviation of a tracked step without wheels, as a share.
const TRACKED_STEP_SIGMA: f64 = 0.1;

const EDGES: usize = BATCH_VIEWS * (VIEW_GRAPH_SPAN + 1);

/// The graph of the new views' relative poses.
struct ViewGraph {
    rotations: heapless::Vec<RotationEdge, EDGES>,
    /// Direction in the first view's space; it becomes one in world space once rotations are averaged.
    directions: heapless::Vec<DirectionEdge, EDGES>,
}

impl Map {
    /// Poses of the new views: motion averaging over the batch, then the landmarks where there are enough of them.
    pub(super) fn place(&mut self, first_new: usize) {
        let count = self.window.views().len();
        let held = first_new.max(1);
        if count <= held {
            return;
        }
        let graph = self.view_graph(held);
        let mut rotations: heapless::Vec<UnitQuaternion<f64>, WINDOW_VIEWS> = self
            .window
            .views()
            .iter()
            .map(|v| v.world_from_camera.rotation)
            .collect();
        average_rotations(&graph.rotations, held, &mut rotations);
        let positions = self.averaged_positions(&graph, held, &rotations);
        for j in held..count {
            let averaged = Pose::from_parts(Translation3::from(positions[j]), rotations[j]);
            let view = &self.window.views()[j];
            let chained = self.window.views()[j - 1].world_from_camera * view.tracked_step;
            let start = self.better(j, averaged, chained);
            let seen = resect(view, &self.window.points, &start);
            let pose = seen.map_or(start, |r| self.better(j, r.world_from_camera, start));
            if is_finite(&pose) {
                let view = &mut self.window.views_mut()[j];
                view.world_from_camera = pose;
                view.world_from_camera.rotation.renormalize();
            }
        }
    }

    /// The first pose unless the landmarks fit the second clearly better.
    fn better(&self, view: usize, first: Pose, second: Pose) -> Pose {
        let view = &self.window.views()[view];
        let fit = |pose: &Pose| mismatch(view, &self.window.points, pose);
        match (fit(&first), fit(&second)) {
            (Some(a), Some(b)) if b < a => second,
            _ if is_finite(&first) => first,
            _ => second,
        }
    }

    /// Relative poses of each new view with the [`VIEW_GRAPH_SPAN`] before it.
    fn view_graph(&mut self, held: usize) -> ViewGraph {
        let mut graph = ViewGraph {
            rotations: heapless::Vec::new(),
            directions: heapless::Vec::new(),
        };
        let focal_px = self.camera.lens.focal_px();
        for second in held..self.window.views().len() {
            let mut tracked = Pose::identity();
            for first in (second.saturating_sub(VIEW_GRAPH_SPAN)..second).rev() {
                let views = self.window.views();
                tracked = views[first + 1].tracked_step * tracked;
                if first + 1 == second {
                    let edge = RotationEdge {
                        first,
                        second,
                        rotation: tracked.rotation,
                        weight: TRACKED_WEIGHT,
                    };
                    let _ = graph.rotations.push(edge);
                }
                self.collect_matches(first, second);
                let Some(pair) = relative_pose(&self.matches, &tracked, focal_px, &mut self.random) else {
                    continue;
                };
                let weight = pair.inliers as f64;
                let _ = graph.rotations.push(RotationEdge {
                    first,
                    second,
                    rotation: pair.rotation,
                    weight,
                });
                if pair.has_parallax {
                    let _ = graph.directions.push(DirectionEdge {
                        first,
                        second,
                        direction: pair.direction,
                        weight,
                    });
                }
            }
        }
        graph
    }

    fn collect_matches(&mut self, first: usize, second: usize) {
        self.matches.clear();
        let (a, b) = (
            &self.window.views()[first].sightings,
            &self.window.views()[second].sightings,
        );
        let mut k = 0;
        for sighting in a {
            while k < b.len() && b[k].track < sighting.track {
                k += 1;
            }
            if k < b.len() && b[k].track == sighting.track {
                self.matches.push(Match {
                    first: sighting.bearing(),
                    second: b[k].bearing(),
                });
            }
        }
    }

    fn averaged_positions(
        &self,
        graph: &ViewGraph,
        held: usize,
        rotations: &[UnitQuaternion<f64>],
    ) -> heapless::Vec<Vector3<f64>, WINDOW_VIEWS> {
        let views = self.window.views();
        let mut positions: heapless::Vec<Vector3<f64>, WINDOW_VIEWS> = views
            .iter()
            .map(|v| v.world_from_camera.translation.vector)
            .collect();
        let in_world: heapless::Vec<DirectionEdge, EDGES> = graph
            .directions
            .iter()
            .map(|edge| DirectionEdge {
                direction: rotations[edge.first] * edge.direction,
                // The best pair counts one; the deviation is in radians already.
                weight: edge.weight / MAX_TRACKS as f64,
                ..*edge
            })
            .collect();
        let mut steps: heapless::Vec<StepEdge, WINDOW_VIEWS> = heapless::Vec::new();
        for second in held..views.len() {
            let first = second - 1;
            let offset =
                rotations[second] * self.rig.rear_in_camera - rotations[first] * self.rig.rear_in_camera;
            let tracked_m = self.rig.step_m(&Pose::identity(), &views[second].tracked_step);
            let (length_m, sigma_m) = views[second]
                .wheel_step
                .map_or((tracked_m, TRACKED_STEP_SIGMA * tracked_m + 0.05), |wheel| {
                    (wheel.chord_m, wheel_sigma_m(wheel.chord_m))
                });
            let _ = steps.push(StepEdge {
                first,
                second,
                offset,
                length_m,
                sigma_m,
            });
        }
        average_translations(&in_world, &steps, held, &mut positions);
        positions
    }
}
