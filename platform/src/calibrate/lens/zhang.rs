//! Zhang's closed form: a pinhole from the homographies of a plane, and a plane's pose from one of them.
//!
//! Source: Zhang, A flexible new technique for camera calibration, 2000, sections 2.3 and 3.1, without skew.

use freespace::space::Pose;
use nalgebra::{
    Matrix3, Rotation3, SMatrix, SVector, SymmetricEigen, Translation3, UnitQuaternion, Vector2, Vector3,
};

/// Focal lengths and principal point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pinhole {
    pub(super) fx: f64,
    pub(super) fy: f64,
    pub(super) cx: f64,
    pub(super) cy: f64,
}

/// Moves points to their centre and scales them to a mean distance of one: `normalised = matrix * point`.
fn normaliser(points: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    #[expect(clippy::cast_precision_loss, reason = "corners of a board")]
    let count = points.len() as f64;
    let centre = points.iter().sum::<Vector2<f64>>() / count;
    let spread = points.iter().map(|point| (point - centre).norm()).sum::<f64>() / count;
    let scale = 1.0 / spread;
    (scale.is_finite() && scale > 0.0).then(|| {
        Matrix3::new(
            scale,
            0.0,
            -scale * centre.x,
            0.0,
            scale,
            -scale * centre.y,
            0.0,
            0.0,
            1.0,
        )
    })
}

/// The homography that takes `from` to `to` in the least-squares sense; none of fewer than four points.
pub(super) fn homography(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    if from.len() < 4 || from.len() != to.len() {
        return None;
    }
    let (from_normal, to_normal) = (normaliser(from)?, normaliser(to)?);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (a, b) in from.iter().zip(to) {
        let p = from_normal * a.push(1.0);
        let q = to_normal * b.push(1.0);
        let mut first = SVector::<f64, 9>::zeros();
        let mut second = SVector::<f64, 9>::zeros();
        for i in 0..3 {
            first[i] = p[i];
            first[6 + i] = -q.x * p[i];
            second[3 + i] = p[i];
            second[6 + i] = -q.y * p[i];
        }
        normal += first * first.transpose() + second * second.transpose();
    }
    let eigen = SymmetricEigen::try_new(normal, 1e-15, 1000)?;
    let h = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    Some(to_normal.try_inverse()? * h * from_normal)
}

/// The pinhole of at least three views, or none where they do not determine it.
pub(super) fn closed_form(homographies: &[Matrix3<f64>], width: f64, height: f64) -> Option<Pinhole> {
    if homographies.len() < 3 {
        return None;
    }
    // In units of the picture, for the sake of the numbers.
    let unit = Matrix3::new(
        2.0 / width,
        0.0,
        -1.0,
        0.0,
        2.0 / width,
        -height / width,
        0.0,
        0.0,
        1.0,
    );
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    for homography in homographies {
        let h = unit * homography;
        let h = h / h.norm();
        let (a, b) = (h.column(0).into_owned(), h.column(1).into_owned());
        for row in [constraint(&a, &b), constraint(&a, &a) - constraint(&b, &b)] {
            normal += row * row.transpose();
        }
    }
    let eigen = SymmetricEigen::try_new(normal, 1e-15, 1000)?;
    let b = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let b = if b[0] < 0.0 {
        -b.into_owned()
    } else {
        b.into_owned()
    };
    let (cx, cy) = (-b[2] / b[0], -b[3] / b[1]);
    let rest = b[4] - b[2] * b[2] / b[0] - b[3] * b[3] / b[1];
    let (fx, fy) = ((rest / b[0]).sqrt(), (rest / b[1]).sqrt());
    let half = 0.5 * width;
    let pinhole = Pinhole {
        fx: fx * half,
        fy: fy * half,
        cx: (cx + 1.0) * half,
        cy: cy * half + 0.5 * height,
    };
    let is_sound = [fx, fy].iter().all(|f| (0.1..20.0).contains(f)) && cx.abs() < 1.0 && cy.abs() < 1.0;
    is_sound.then_some(pinhole)
}

/// `a' B b` as a row over `B11, B22, B13, B23, B33`.
fn constraint(a: &Vector3<f64>, b: &Vector3<f64>) -> SVector<f64, 5> {
    SVector::<f64, 5>::new(
        a.x * b.x,
        a.y * b.y,
        a.x * b.z + a.z * b.x,
        a.y * b.z + a.z * b.y,
        a.z * b.z,
    )
}

/// The pose of a plane, `camera_from_board`, from the homography that takes its points to undistorted rays (x, y, 1).
pub(super) fn pose(rays_from_board: &Matrix3<f64>) -> Option<Pose> {
    let h = rays_from_board;
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    // The board is before the camera.
    let scale = if h[(2, 2)] < 0.0 { -scale } else { scale };
    let (first, second) = (h.column(0) * scale, h.column(1) * scale);
    let raw = Matrix3::from_columns(&[first, second, first.cross(&second)]);
    let svd = raw.try_svd(true, true, 1e-15, 1000)?;
    let rotation = svd.u? * svd.v_t?;
    let translation: Vector3<f64> = h.column(2) * scale;
    let is_sound = rotation.determinant() > 0.5 && translation.iter().all(|value| value.is_finite());
    is_sound.then(|| {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Pose::from_parts(Translation3::from(translation), rotation)
    })
}
