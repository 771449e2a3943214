//! Levenberg-Marquardt over the lens and the pose of every board, with a robust loss.
//!
//! In: views and a start. Out: a [`Calibration`]: lens, spread of its parameters, poses, residuals. Invariant: the robust error
//! never rises from step to step. Cost: `MOST_STEPS` steps at most, each linear in the corners; the boards' poses are eliminated
//! view by view, so a step solves a system of the lens's parameters alone.
//! Source: Madsen, Nielsen, Tingleff 2004; Huber's loss; the covariance is `sigma^2 (J' W J)^-1`.

use freespace::frame::Lens;
use freespace::space::Pose;
use nalgebra::{Point3, Vector2};

use super::View;
use super::parameters::parameters_of;
use super::start::start;
use crate::config::{ImageSize, LensModel};

const MOST_STEPS: usize = 60;
/// A step that lowers the error by less than this share ends the search.
const STILL: f64 = 1e-9;
/// Residuals beyond so many robust standard deviations count linearly.
pub(super) const HUBER: f64 = 2.0;
/// And beyond so many the corner is left out in the end: it was found in the wrong place.
const WILD: f64 = 6.0;
/// But never one this near: of very sharp pictures the noise is finer than the corners' small systematic errors.
const WILD_PX: f64 = 0.3;
/// Corners are never known better than this.
const FINEST_PX: f64 = 0.02;

/// A calibrated lens.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The lens.
    pub lens: Lens,
    /// Names, values and standard deviations of its parameters.
    pub parameters: Vec<Parameter>,
    /// Each view's board, `camera_from_board`.
    pub poses: Vec<Pose>,
    /// Each view's residuals in the order of its sightings, projected minus seen; none where the corner was left out.
    pub residuals: Vec<Vec<Option<Vector2<f64>>>>,
    /// Root of the mean squared distance between corners seen and projected, those left out not counted.
    pub rms_px: f64,
}

/// A parameter of the lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// As in `[camera.lens]`, coefficients numbered from one.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Why views give no lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CalibrationError {
    /// No lens explains the views.
    #[error("no lens of this model explains the corners")]
    NoStart,
    /// The views leave parameters open.
    #[error("the pictures do not determine the lens")]
    Undetermined,
}

/// Calibrates the lens of `views`.
///
/// # Errors
/// [`CalibrationError`]: take more, and more tilted, pictures.
pub fn calibrate(
    views: &[View],
    square_m: f64,
    size: ImageSize,
    model: LensModel,
) -> Result<Calibration, CalibrationError> {
    let (lens, poses) = start(views, square_m, size, model).ok_or(CalibrationError::NoStart)?;
    let corners: usize = views.iter().map(|view| view.sightings.len()).sum();
    let count = parameters_of(&lens).len();
    // Two equations a corner, six unknowns a view and the lens's own; a view gives at most two equations for the lens's core.
    if 2 * corners <= count + 6 * views.len() || views.len() < 3 {
        return Err(CalibrationError::Undetermined);
    }
    let mut state = State {
        views,
        square_m,
        lens,
        poses,
        weights: views.iter().map(|view| vec![1.0; view.sightings.len()]).collect(),
        scale_px: f64::INFINITY,
    };
    // The focal length and the coarse bend first: the high orders follow noise before these are right.
    state.descend(6.min(count))?;
    state.descend(count)?;
    state.drop_wild();
    state.descend(count)?;
    state.finish()
}

/// What is being refined.
pub(super) struct State<'a> {
    pub(super) views: &'a [View],
    pub(super) square_m: f64,
    pub(super) lens: Lens,
    pub(super) poses: Vec<Pose>,
    /// 0 for corners left out.
    pub(super) weights: Vec<Vec<f64>>,
    /// Robust standard deviation of a residual's length.
    pub(super) scale_px: f64,
}

impl State<'_> {
    /// Projected minus seen; none where the lens does not project the corner.
    pub(super) fn residual(
        &self,
        lens: &Lens,
        pose: &Pose,
        view: usize,
        corner: usize,
    ) -> Option<Vector2<f64>> {
        let sighting = &self.views[view].sightings[corner];
        let point = pose * Point3::from(sighting.point_m(self.square_m));
        Some(lens.project(&point.coords)? - sighting.pixel)
    }

    /// Huber's loss over all corners; infinite where one that counts is not projected.
    fn error(&self, lens: &Lens, poses: &[Pose]) -> f64 {
        let bound = HUBER * self.scale_px;
        let mut sum = 0.0;
        for (view, pose) in poses.iter().enumerate() {
            for (corner, weight) in self.weights[view].iter().enumerate() {
                if *weight > 0.0 {
                    let Some(residual) = self.residual(lens, pose, view, corner) else {
                        return f64::INFINITY;
                    };
                    let off = residual.norm();
                    sum += if off <= bound {
                        off * off
                    } else {
                        bound * (2.0 * off - bound)
                    };
                }
            }
        }
        sum
    }

    /// The robust standard deviation of a residual's length, of all corners that count.
    fn measure_scale(&mut self) {
        let mut lengths: Vec<f64> = Vec::new();
        for (view, pose) in self.poses.iter().enumerate() {
            for (corner, weight) in self.weights[view].iter().enumerate() {
                if *weight > 0.0 {
                    lengths.extend(self.residual(&self.lens, pose, view, corner).map(|r| r.norm()));
                }
            }
        }
        lengths.sort_by(f64::total_cmp);
        let median = lengths.get(lengths.len() / 2).copied().unwrap_or(f64::INFINITY);
        // A Rayleigh variable's median is 1.177 sigma.
        self.scale_px = (median / 1.177).max(FINEST_PX) * std::f64::consts::SQRT_2;
    }

    /// Steps over the first `free` parameters and all poses until the error stays.
    fn descend(&mut self, free: usize) -> Result<(), CalibrationError> {
        let mut damping = 1e-3;
        self.measure_scale();
        let mut error = self.error(&self.lens, &self.poses);
        for step in 0..MOST_STEPS {
            let normal = self.normal(free)?;
            let mut is_lower = false;
            while damping < 1e12 {
                let Some((lens, poses)) = self.step(&normal, damping) else {
                    damping *= 10.0;
                    continue;
                };
                let next = self.error(&lens, &poses);
                if next < error {
                    let share = (error - next) / error.max(1e-300);
                    (self.lens, self.poses) = (lens, poses);
                    damping = (damping * 0.1).max(1e-12);
                    is_lower = share > STILL;
                    error = next;
                    break;
                }
                damping *= 10.0;
            }
            if !is_lower {
                break;
            }
            // The loss is fixed while it is descended; its width follows the corners' noise now and then.
            if step % 8 == 7 {
                self.measure_scale();
                error = self.error(&self.lens, &self.poses);
            }
        }
        error
            .is_finite()
            .then_some(())
            .ok_or(CalibrationError::Undetermined)
    }

    /// Leaves out corners far beyond the noise of the others.
    fn drop_wild(&mut self) {
        self.measure_scale();
        let bound = (WILD * self.scale_px).max(WILD_PX);
        for view in 0..self.poses.len() {
            for corner in 0..self.weights[view].len() {
                let off = self.residual(&self.lens, &self.poses[view], view, corner);
                if !off.is_some_and(|off| off.norm() <= bound) {
                    self.weights[view][corner] = 0.0;
                }
            }
        }
    }

    fn finish(self) -> Result<Calibration, CalibrationError> {
        let values = parameters_of(&self.lens);
        let normal = self.normal(values.len())?;
        let mut reduced = normal.lens.clone();
        for (own, shared, _) in &normal.views {
            let inverse = own.try_inverse().ok_or(CalibrationError::Undetermined)?;
            reduced -= shared * inverse * shared.transpose();
        }
        let covariance = reduced.try_inverse().ok_or(CalibrationError::Undetermined)?;
        let residuals: Vec<Vec<Option<Vector2<f64>>>> = (0..self.poses.len())
            .map(|view| {
                let of = |(corner, weight): (usize, &f64)| {
                    (*weight > 0.0)
                        .then(|| self.residual(&self.lens, &self.poses[view], view, corner))
                        .flatten()
                };
                self.weights[view].iter().enumerate().map(of).collect()
            })
            .collect();
        let squares: Vec<f64> = residuals
            .iter()
            .flatten()
            .flatten()
            .map(|r| r.norm_squared())
            .collect();
        #[expect(clippy::cast_precision_loss, reason = "corners")]
        let (corners, unknowns) = (squares.len() as f64, (values.len() + 6 * self.poses.len()) as f64);
        let sum: f64 = squares.iter().sum();
        let variance = sum / (2.0 * corners - unknowns).max(1.0);
        let parameters = (values.into_iter().enumerate())
            .map(|(i, (name, value))| Parameter {
                name,
                value,
                sigma: (variance * covariance[(i, i)]).max(0.0).sqrt(),
            })
            .collect();
        Ok(Calibration {
            lens: self.lens,
            parameters,
            poses: self.poses,
            residuals,
            rms_px: (sum / corners.max(1.0)).sqrt(),
        })
    }
}
