//! Lens models: between a direction in camera space and a pixel.
//!
//! Brown-Conrady (Brown 1966, as in OpenCV's `calib3d`) for ordinary lenses, Kannala-Brandt (2006) for wide ones.
//! Undistortion is a Newton iteration with [`NEWTON_STEPS`] as its cap; the ray table pays for it once a pixel.

use nalgebra::{Matrix2, Vector2, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

/// Newton steps of an undistortion; five suffice for lenses up to 120 degrees.
const NEWTON_STEPS: usize = 12;

/// Pinhole with radial and tangential distortion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(deny_unknown_fields))]
pub struct BrownConrady {
    /// Focal lengths in pixels.
    pub fx: f64,
    /// See `fx`.
    pub fy: f64,
    /// Principal point in pixels.
    pub cx: f64,
    /// See `cx`.
    pub cy: f64,
    /// Radial coefficients of r^2, r^4, r^6.
    #[cfg_attr(feature = "serde", serde(default))]
    pub k: [f64; 3],
    /// Tangential coefficients.
    #[cfg_attr(feature = "serde", serde(default))]
    pub p: [f64; 2],
}

/// Fisheye: the image radius is a polynomial of the angle to the axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(deny_unknown_fields))]
pub struct KannalaBrandt {
    /// Focal lengths in pixels.
    pub fx: f64,
    /// See `fx`.
    pub fy: f64,
    /// Principal point in pixels.
    pub cx: f64,
    /// See `cx`.
    pub cy: f64,
    /// Coefficients of theta^3, theta^5, theta^7, theta^9.
    #[cfg_attr(feature = "serde", serde(default))]
    pub k: [f64; 4],
}

/// A calibrated lens.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(tag = "model", rename_all = "snake_case")
)]
pub enum Lens {
    /// See [`BrownConrady`].
    BrownConrady(BrownConrady),
    /// See [`KannalaBrandt`].
    KannalaBrandt(KannalaBrandt),
}

impl Lens {
    /// A lens without distortion.
    #[must_use]
    pub fn pinhole(fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self::BrownConrady(BrownConrady {
            fx,
            fy,
            cx,
            cy,
            ..BrownConrady::default()
        })
    }

    /// Focal length in pixels, the mean of both axes.
    #[must_use]
    pub fn focal_px(&self) -> f64 {
        match self {
            Self::BrownConrady(l) => 0.5 * (l.fx + l.fy),
            Self::KannalaBrandt(l) => 0.5 * (l.fx + l.fy),
        }
    }

    /// The same lens for an image scaled by `(x, y)`, pixel centres at whole numbers.
    #[must_use]
    pub fn scaled(&self, x: f64, y: f64) -> Self {
        let centre = |c: f64, s: f64| (c + 0.5) * s - 0.5;
        match *self {
            Self::BrownConrady(l) => Self::BrownConrady(BrownConrady {
                fx: l.fx * x,
                fy: l.fy * y,
                cx: centre(l.cx, x),
                cy: centre(l.cy, y),
                ..l
            }),
            Self::KannalaBrandt(l) => Self::KannalaBrandt(KannalaBrandt {
                fx: l.fx * x,
                fy: l.fy * y,
                cx: centre(l.cx, x),
                cy: centre(l.cy, y),
                ..l
            }),
        }
    }

    /// The pixel of a point in camera space; none where it lies behind the camera or outside the model's range.
    #[must_use]
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        match self {
            Self::BrownConrady(l) => {
                if point.z <= 1e-6 {
                    return None;
                }
                let undistorted = Vector2::new(point.x / point.z, point.y / point.z);
                l.increases_at(undistorted.norm_squared()).then_some(())?;
                let d = l.distort(&undistorted);
                Some(Vector2::new(l.fx * d.x + l.cx, l.fy * d.y + l.cy))
            }
            Self::KannalaBrandt(l) => {
                let radius = point.x.hypot(point.y);
                if radius < 1e-12 {
                    return (point.z > 0.0).then(|| Vector2::new(l.cx, l.cy));
                }
                let image_radius = l.image_radius(radius.atan2(point.z));
                let (x, y) = (point.x / radius * image_radius, point.y / radius * image_radius);
                Some(Vector2::new(l.fx * x + l.cx, l.fy * y + l.cy))
            }
        }
    }

    /// The unit ray in camera space through a pixel; none where the model has none there.
    #[must_use]
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        match self {
            Self::BrownConrady(l) => {
                let target = Vector2::new((pixel.x - l.cx) / l.fx, (pixel.y - l.cy) / l.fy);
                let u = l.undistort(&target)?;
                Some(Vector3::new(u.x, u.y, 1.0).normalize())
            }
            Self::KannalaBrandt(l) => {
                let target = Vector2::new((pixel.x - l.cx) / l.fx, (pixel.y - l.cy) / l.fy);
                let image_radius = target.norm();
                if image_radius < 1e-12 {
                    return Some(Vector3::z());
                }
                let theta = l.angle(image_radius)?;
                let (sin, cos) = theta.sin_cos();
                Some(Vector3::new(
                    target.x / image_radius * sin,
                    target.y / image_radius * sin,
                    cos,
                ))
            }
        }
    }
}

impl BrownConrady {
    /// Whether the radial polynomial still grows there; beyond, a far direction would land inside the image.
    fn increases_at(&self, r2: f64) -> bool {
        let [k1, k2, k3] = self.k;
        1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3)) > 0.05
    }

    fn distort(&self, u: &Vector2<f64>) -> Vector2<f64> {
        let [k1, k2, k3] = self.k;
        let [p1, p2] = self.p;
        let r2 = u.norm_squared();
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        Vector2::new(
            u.x * radial + 2.0 * p1 * u.x * u.y + p2 * (r2 + 2.0 * u.x * u.x),
            u.y * radial + p1 * (r2 + 2.0 * u.y * u.y) + 2.0 * p2 * u.x * u.y,
        )
    }

    fn undistort(&self, target: &Vector2<f64>) -> Option<Vector2<f64>> {
        if self.k == [0.0; 3] && self.p == [0.0; 2] {
            return Some(*target);
        }
        let mut u = *target;
        for _ in 0..NEWTON_STEPS {
            let error = self.distort(&u) - target;
            if error.norm_squared() < 1e-24 {
                break;
            }
            u -= self.jacobian(&u).try_inverse()? * error;
        }
        ((self.distort(&u) - target).norm_squared() < 1e-12 && self.increases_at(u.norm_squared()))
            .then_some(u)
    }

    fn jacobian(&self, u: &Vector2<f64>) -> Matrix2<f64> {
        let [k1, k2, k3] = self.k;
        let [p1, p2] = self.p;
        let r2 = u.norm_squared();
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let cross = slope * u.x * u.y + 2.0 * p1 * u.x + 2.0 * p2 * u.y;
        Matrix2::new(
            radial + slope * u.x * u.x + 2.0 * p1 * u.y + 6.0 * p2 * u.x,
            cross,
            cross,
            radial + slope * u.y * u.y + 6.0 * p1 * u.y + 2.0 * p2 * u.x,
        )
    }
}

impl KannalaBrandt {
    fn image_radius(&self, theta: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        let t2 = theta * theta;
        theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    }

    fn angle(&self, image_radius: f64) -> Option<f64> {
        let [k1, k2, k3, k4] = self.k;
        let mut theta = image_radius.min(core::f64::consts::FRAC_PI_2);
        for _ in 0..NEWTON_STEPS {
            let t2 = theta * theta;
            let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
            if slope.abs() < 1e-9 {
                return None;
            }
            theta -= (self.image_radius(theta) - image_radius) / slope;
        }
        ((self.image_radius(theta) - image_radius).abs() < 1e-6
            && (0.0..core::f64::consts::PI).contains(&theta))
        .then_some(theta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lenses() -> [Lens; 3] {
        [
            Lens::pinhole(721.5, 721.5, 609.6, 172.9),
            Lens::BrownConrady(BrownConrady {
                fx: 500.0,
                fy: 505.0,
                cx: 320.0,
                cy: 240.0,
                k: [-0.28, 0.07, 0.001],
                p: [0.0005, -0.0003],
            }),
            Lens::KannalaBrandt(KannalaBrandt {
                fx: 330.0,
                fy: 331.0,
                cx: 320.0,
                cy: 240.0,
                k: [-0.02, 0.005, -0.002, 0.0003],
            }),
        ]
    }

    proptest! {
        #[test]
        fn unproject_inverts_project(x in 20.0..620.0f64, y in 20.0..460.0f64) {
            for lens in lenses() {
                let pixel = Vector2::new(x, y);
                let ray = lens.unproject(&pixel).unwrap();
                prop_assert!((ray.norm() - 1.0).abs() < 1e-9);
                prop_assert!((lens.project(&(ray * 7.0)).unwrap() - pixel).norm() < 1e-4);
            }
        }
    }

    #[test]
    fn scaled_lens_sees_the_same_ray() {
        for lens in lenses() {
            let ray = lens.unproject(&Vector2::new(99.5, 199.5)).unwrap();
            let half = lens
                .scaled(0.5, 0.5)
                .unproject(&Vector2::new(49.5, 99.5))
                .unwrap();
            assert!((ray - half).norm() < 1e-9);
        }
    }

    #[test]
    fn nothing_behind_a_pinhole() {
        assert!(lenses()[0].project(&Vector3::new(0.0, 0.0, -1.0)).is_none());
    }
}
