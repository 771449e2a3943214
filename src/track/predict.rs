//! Prediction: where a track will be in the new frame.
//!
//! In: the predicted motion of the camera, the road plane in the last camera, and what is known of the track's distance. Out:
//! a [`Guess`]. A known distance moves the ray by the whole motion; the road's homography moves and stretches what lies on
//! the plane; without either the infinite homography (rotation alone) is the guess. Cost: one projection, four where a
//! stretch is asked for.
#![allow(
    clippy::cast_possible_truncation,
    reason = "pixel arithmetic: guesses are f32 pixels"
)]

use nalgebra::{Matrix2, Vector2, Vector3};

use super::klt::Guess;
use crate::frame::Lens;
use crate::space::{Plane, Pose};

/// Offset at which the stretch is measured: half a tracking window.
const PROBE_PX: f64 = 8.0;
/// Stretch beyond which a window is not worth warping.
const MAX_STRETCH: f64 = 2.0;
/// A point this near the plane is taken to lie in it, as far as its stretch goes.
const ON_PLANE_M: f64 = 0.2;

/// The predicted motion between two frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Predictor<'a> {
    pub(crate) lens: &'a Lens,
    /// Road plane in the last camera.
    pub(crate) plane: &'a Plane,
    pub(crate) current_from_previous: Pose,
}

impl Predictor<'_> {
    /// The guess for a point at `1 / inverse_m` along a unit ray of the last camera; 0 is infinitely far.
    pub(crate) fn at_distance(
        &self,
        pixel: &Vector2<f32>,
        ray: &Vector3<f64>,
        inverse_m: f64,
    ) -> Option<Guess> {
        let moved = self.moved(ray, inverse_m);
        let at = self.lens.project(&moved)?;
        let on_plane = inverse_m > 0.0
            && (self.plane.normal.dot(ray) / inverse_m + self.plane.offset_m).abs() < ON_PLANE_M;
        let stretch = if on_plane {
            self.stretch_on_plane(pixel, &at)
        } else {
            let nearer = ray.z / moved.z;
            (nearer.is_finite() && nearer > 1.0 / MAX_STRETCH && nearer < MAX_STRETCH)
                .then(|| Matrix2::identity() * nearer as f32)
        };
        Some(Guess {
            pixel: at.cast(),
            stretch: stretch.unwrap_or_else(Matrix2::identity),
        })
    }

    /// The guess for a point of the road; none for a ray that does not meet it.
    pub(crate) fn on_plane(&self, pixel: &Vector2<f32>, ray: &Vector3<f64>) -> Option<Guess> {
        self.at_distance(pixel, ray, self.plane_inverse_m(ray)?)
    }

    /// Inverse distance to the road along a unit ray.
    pub(crate) fn plane_inverse_m(&self, ray: &Vector3<f64>) -> Option<f64> {
        self.plane.ray_distance(ray).filter(|d| *d > 0.1).map(|d| 1.0 / d)
    }

    fn moved(&self, ray: &Vector3<f64>, inverse_m: f64) -> Vector3<f64> {
        let motion = &self.current_from_previous;
        motion.rotation * ray + motion.translation.vector * inverse_m
    }

    /// Derivative of the road's homography by finite differences, the lens included.
    fn stretch_on_plane(&self, pixel: &Vector2<f32>, at: &Vector2<f64>) -> Option<Matrix2<f32>> {
        let column = |offset: Vector2<f64>| {
            let ray = self.lens.unproject(&(pixel.cast::<f64>() + offset))?;
            let moved = self.moved(&ray, self.plane_inverse_m(&ray)?);
            Some((self.lens.project(&moved)? - at) / PROBE_PX)
        };
        let across = column(Vector2::new(PROBE_PX, 0.0))?;
        let down = column(Vector2::new(0.0, PROBE_PX))?;
        let stretch = Matrix2::from_columns(&[across, down]);
        let sane = stretch.iter().all(|v| v.is_finite())
            && stretch.amax() < MAX_STRETCH
            && stretch.determinant() > 1.0 / (MAX_STRETCH * MAX_STRETCH);
        sane.then(|| stretch.cast())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn the_road_comes_nearer_and_grows() {
        let lens = Lens::pinhole(700.0, 700.0, 600.0, 180.0);
        let plane = Plane {
            normal: -Vector3::y(),
            offset_m: 1.65,
        };
        let predictor = Predictor {
            lens: &lens,
            plane: &plane,
            current_from_previous: Pose::translation(0.0, 0.0, -1.5),
        };
        let from = lens.project(&Vector3::new(1.0, 1.65, 9.0)).unwrap();
        let ray = lens.unproject(&from).unwrap();
        let guess = predictor.on_plane(&from.cast(), &ray).unwrap();
        let truth = lens.project(&Vector3::new(1.0, 1.65, 7.5)).unwrap();
        assert!((guess.pixel.cast::<f64>() - truth).norm() < 1e-3);
        assert!((f64::from(guess.stretch.m11) - 1.2).abs() < 0.01);
        assert!((f64::from(guess.stretch.m22) - 1.44).abs() < 0.05);
        let sky = lens.unproject(&Vector2::new(600.0, 100.0)).unwrap();
        assert!(predictor.on_plane(&Vector2::new(600.0, 100.0), &sky).is_none());
    }
}
