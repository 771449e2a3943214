//! The normal equations of a step: the lens's block, each board's own, and what they share.
//!
//! In: a `State`. Out: a step that eliminates the boards one by one and solves for the lens. Derivatives by the lens's parameters and
//! by the point are central differences, exact to 1e-9, so that a further lens model needs no more than its projection.

use freespace::frame::Lens;
use freespace::space::Pose;
use nalgebra::{
    DMatrix, DVector, Matrix2x3, Matrix3, Matrix6, OMatrix, SMatrix, Translation3, U2, U6, UnitQuaternion,
    Vector3, Vector6,
};

use super::parameters::{MOST_PARAMETERS, changed, parameters_of};
use super::refine::{CalibrationError, HUBER, State};

/// A pixel by the lens's parameters, and by its board's turn and shift.
type ByLens = SMatrix<f64, 2, MOST_PARAMETERS>;
type ByPose = OMatrix<f64, U2, U6>;

/// Normal equations: the lens's block, and for each view its own, the one it shares with the lens, and the right sides.
pub(super) struct Normal {
    pub(super) lens: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    pub(super) views: Vec<(Matrix6<f64>, DMatrix<f64>, Vector6<f64>)>,
}

fn moved(pose: &Pose, step: &Vector6<f64>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    let mut rotation = turn * pose.rotation;
    rotation.renormalize();
    Pose::from_parts(
        Translation3::from(pose.translation.vector + Vector3::new(step[3], step[4], step[5])),
        rotation,
    )
}

impl State<'_> {
    pub(super) fn normal(&self, free: usize) -> Result<Normal, CalibrationError> {
        let mut normal = Normal {
            lens: DMatrix::zeros(free, free),
            right: DVector::zeros(free),
            views: Vec::with_capacity(self.poses.len()),
        };
        let steps: Vec<f64> = parameters_of(&self.lens)
            .iter()
            .map(|(_, value)| 1e-6 * value.abs().max(1.0))
            .collect();
        let bound = HUBER * self.scale_px;
        for (view, pose) in self.poses.iter().enumerate() {
            let mut own = Matrix6::zeros();
            let mut shared = DMatrix::zeros(free, 6);
            let mut right = Vector6::zeros();
            for (corner, weight) in self.weights[view].iter().enumerate() {
                if *weight <= 0.0 {
                    continue;
                }
                let residual = self
                    .residual(&self.lens, pose, view, corner)
                    .ok_or(CalibrationError::Undetermined)?;
                let weight = (bound / residual.norm().max(1e-12)).min(1.0);
                let (by_lens, by_pose) = self.derivatives(pose, view, corner, free, &steps)?;
                own += by_pose.transpose() * by_pose * weight;
                right += by_pose.transpose() * residual * weight;
                let by_lens = by_lens.columns(0, free);
                normal.lens += by_lens.transpose() * by_lens * weight;
                normal.right += by_lens.transpose() * residual * weight;
                shared += by_lens.transpose() * by_pose * weight;
            }
            normal.views.push((own, shared, right));
        }
        Ok(normal)
    }

    /// A corner's pixel by the lens's parameters, and by its board's turn and shift.
    fn derivatives(
        &self,
        pose: &Pose,
        view: usize,
        corner: usize,
        free: usize,
        steps: &[f64],
    ) -> Result<(ByLens, ByPose), CalibrationError> {
        let missing = CalibrationError::Undetermined;
        let sighting = &self.views[view].sightings[corner];
        let turned = pose.rotation * sighting.point_m(self.square_m);
        let point = turned + pose.translation.vector;
        let mut by_lens = ByLens::zeros();
        for (parameter, &h) in steps.iter().enumerate().take(free) {
            let at = |h: f64| changed(&self.lens, |i| if i == parameter { h } else { 0.0 }).project(&point);
            let (after, before) = at(h).zip(at(-h)).ok_or(missing)?;
            by_lens.set_column(parameter, &((after - before) / (2.0 * h)));
        }
        let mut by_point = Matrix2x3::zeros();
        let h = 1e-6 * point.norm();
        for axis in 0..3 {
            let mut offset = Vector3::zeros();
            offset[axis] = h;
            let (after, before) = (self.lens.project(&(point + offset)))
                .zip(self.lens.project(&(point - offset)))
                .ok_or(missing)?;
            by_point.set_column(axis, &((after - before) / (2.0 * h)));
        }
        let mut by_pose = ByPose::zeros();
        let by_turn: Matrix3<f64> = -turned.cross_matrix();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&(by_point * by_turn));
        by_pose.fixed_columns_mut::<3>(3).copy_from(&by_point);
        Ok((by_lens, by_pose))
    }

    /// A damped step: the poses are eliminated, the lens solved, the poses follow.
    pub(super) fn step(&self, normal: &Normal, damping: f64) -> Option<(Lens, Vec<Pose>)> {
        let mut reduced = normal.lens.clone();
        for i in 0..reduced.nrows() {
            reduced[(i, i)] *= 1.0 + damping;
        }
        let mut right = normal.right.clone();
        let mut inverses = Vec::with_capacity(normal.views.len());
        for (own, shared, view_right) in &normal.views {
            let mut damped = *own;
            for i in 0..6 {
                damped[(i, i)] *= 1.0 + damping;
            }
            let inverse = damped.try_inverse()?;
            let weighed = shared * inverse;
            reduced -= &weighed * shared.transpose();
            right -= &weighed * view_right;
            inverses.push(inverse);
        }
        let by_lens = -reduced.cholesky()?.solve(&right);
        let lens = changed(&self.lens, |i| by_lens.get(i).copied().unwrap_or(0.0));
        let poses = (self.poses.iter().zip(&normal.views).zip(&inverses))
            .map(|((pose, (_, shared, view_right)), inverse)| {
                let from_lens: Vector6<f64> =
                    Vector6::from_column_slice((shared.transpose() * &by_lens).as_slice());
                moved(pose, &(-(inverse * (view_right + from_lens))))
            })
            .collect();
        Some((lens, poses))
    }
}
