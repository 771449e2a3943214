//! Trajectories against truth: alignment after Horn (1987) and Umeyama (1991), root mean square position error, and the relative errors
//! of the KITTI odometry benchmark (Geiger 2012) over segments of 100 to 800 m.

use std::path::Path;

use freespace::space::Pose;
use nalgebra::{
    Matrix3, Matrix4, Point3, Quaternion, Rotation3, SymmetricEigen, Translation3, UnitQuaternion, Vector3,
};

use crate::bad_input::{BadInput, read_text};

/// The comparison of two trajectories.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryScore {
    /// Poses compared.
    pub poses: usize,
    /// Root mean square position error after the best rigid motion.
    pub ate_se3_m: f64,
    /// The same after the best rigid motion and scale; none where the estimate does not move.
    pub ate_sim3_m: Option<f64>,
    /// That scale, true length over estimated length.
    pub scale: Option<f64>,
    /// Length of the true path.
    pub distance_m: f64,
    /// Length of the estimated path.
    pub estimated_distance_m: f64,
    /// Relative errors; none where the path is shorter than the shortest segment.
    pub segments: Option<SegmentError>,
}

/// KITTI's relative errors, the mean over all segments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentError {
    /// Translation error over the segment's length, in percent.
    pub translation_percent: f64,
    /// Rotation error over the segment's length.
    pub rotation_deg_per_m: f64,
    /// Segments.
    pub count: usize,
}

/// Compares poses pair by pair; none for fewer than two pairs or where a number is not finite.
#[must_use]
pub fn compare(estimate: &[Pose], truth: &[Pose]) -> Option<TrajectoryScore> {
    let poses = estimate.len().min(truth.len());
    let (estimate, truth) = (&estimate[..poses], &truth[..poses]);
    let points = |poses: &[Pose]| -> Vec<Point3<f64>> {
        poses
            .iter()
            .map(|pose| Point3::from(pose.translation.vector))
            .collect()
    };
    let (from, to) = (points(estimate), points(truth));
    if poses < 2
        || from
            .iter()
            .chain(&to)
            .any(|p| !p.coords.iter().all(|v| v.is_finite()))
    {
        return None;
    }
    let rigid = align(&from, &to, false)?;
    let similar = align(&from, &to, true);
    let (estimated, distances) = (path_lengths(estimate), path_lengths(truth));
    Some(TrajectoryScore {
        poses,
        ate_se3_m: rigid.rmse_m(&from, &to),
        ate_sim3_m: similar.map(|motion| motion.rmse_m(&from, &to)),
        scale: similar.map(|motion| motion.scale),
        distance_m: distances.last().copied().unwrap_or_default(),
        estimated_distance_m: estimated.last().copied().unwrap_or_default(),
        segments: segment_error(estimate, truth, &distances),
    })
}

/// A motion with scale: `to = scale * rotation * from + shift`.
#[derive(Clone, Copy, Debug)]
struct Similarity {
    scale: f64,
    rotation: Matrix3<f64>,
    shift: Vector3<f64>,
}

impl Similarity {
    #[expect(clippy::cast_precision_loss, reason = "pose counts")]
    fn rmse_m(&self, from: &[Point3<f64>], to: &[Point3<f64>]) -> f64 {
        let sum: f64 = from
            .iter()
            .zip(to)
            .map(|(a, b)| (self.scale * (self.rotation * a.coords) + self.shift - b.coords).norm_squared())
            .sum();
        (sum / from.len() as f64).sqrt()
    }
}

/// Horn's closed form (1987, section 4) for the rotation, Umeyama's (1991, equation 42) for the scale; none with scale where
/// the points of `from` coincide.
///
/// The quaternion is used because it stays exact on nearly straight paths, where a singular value decomposition through
/// `A'A` loses half of its digits.
#[expect(clippy::cast_precision_loss, reason = "pose counts")]
fn align(from: &[Point3<f64>], to: &[Point3<f64>], with_scale: bool) -> Option<Similarity> {
    let n = from.len() as f64;
    let mean = |points: &[Point3<f64>]| points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / n;
    let (mean_from, mean_to) = (mean(from), mean(to));
    let mut s = Matrix3::zeros();
    let mut variance = 0.0;
    for (a, b) in from.iter().zip(to) {
        let (a, b) = (a.coords - mean_from, b.coords - mean_to);
        s += a * b.transpose() / n;
        variance += a.norm_squared() / n;
    }
    if with_scale && variance < 1e-9 {
        return None;
    }
    let rotation = best_rotation(&s)?;
    let scale = if with_scale {
        (rotation * s).trace() / variance
    } else {
        1.0
    };
    Some(Similarity {
        scale,
        rotation,
        shift: mean_to - scale * (rotation * mean_from),
    })
}

/// The rotation that turns `a` best onto `b`, of `s` the mean of `a b'`.
fn best_rotation(s: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let skew = Vector3::new(
        s[(1, 2)] - s[(2, 1)],
        s[(2, 0)] - s[(0, 2)],
        s[(0, 1)] - s[(1, 0)],
    );
    let symmetric = s + s.transpose() - Matrix3::identity() * s.trace();
    let mut n = Matrix4::zeros();
    n[(0, 0)] = s.trace();
    n.fixed_view_mut::<3, 1>(1, 0).copy_from(&skew);
    n.fixed_view_mut::<1, 3>(0, 1).copy_from(&skew.transpose());
    n.fixed_view_mut::<3, 3>(1, 1).copy_from(&symmetric);
    let eigen = SymmetricEigen::try_new(n, f64::EPSILON, 200)?;
    let q = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let quaternion = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
    Some(*quaternion.to_rotation_matrix().matrix())
}

/// Length of a path.
#[must_use]
pub fn path_length_m(poses: &[Pose]) -> f64 {
    path_lengths(poses).last().copied().unwrap_or_default()
}

/// Length of the path up to each pose.
fn path_lengths(poses: &[Pose]) -> Vec<f64> {
    let mut length = 0.0;
    let mut last = poses.first().map(|pose| pose.translation.vector);
    poses
        .iter()
        .map(|pose| {
            let position = pose.translation.vector;
            length += last.map_or(0.0, |last| (position - last).norm());
            last = Some(position);
            length
        })
        .collect()
}

/// Segment lengths of the KITTI odometry benchmark.
const SEGMENTS_M: [f64; 8] = [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0];
/// The benchmark starts a segment at every tenth frame.
const SEGMENT_STEP: usize = 10;

#[expect(clippy::cast_precision_loss, reason = "segment counts")]
fn segment_error(estimate: &[Pose], truth: &[Pose], distances: &[f64]) -> Option<SegmentError> {
    let (mut translation, mut rotation, mut count) = (0.0, 0.0, 0_usize);
    for first in (0..truth.len()).step_by(SEGMENT_STEP) {
        for length_m in SEGMENTS_M {
            let Some(last) = (first..truth.len()).find(|&i| distances[i] > distances[first] + length_m)
            else {
                break;
            };
            let relative = |poses: &[Pose]| poses[first].inv_mul(&poses[last]);
            let error = relative(estimate).inv_mul(&relative(truth));
            translation += error.translation.vector.norm() / length_m;
            rotation += error.rotation.angle() / length_m;
            count += 1;
        }
    }
    (count > 0).then(|| SegmentError {
        translation_percent: 100.0 * translation / count as f64,
        rotation_deg_per_m: (rotation / count as f64).to_degrees(),
        count,
    })
}

/// A trajectory as read: with stamps from a TUM file, without from a KITTI file.
#[derive(Clone, Debug, Default)]
pub struct TrajectoryFile {
    /// Seconds of each pose, where the file has them.
    pub stamps_s: Option<Vec<f64>>,
    /// Poses.
    pub poses: Vec<Pose>,
}

/// Reads 12 numbers a line (KITTI, `world_from_camera` 3x4) or 8 (TUM, stamp, position, quaternion x y z w).
///
/// # Errors
/// A file that cannot be read, is empty, or has a line of another form.
pub fn read(path: &Path) -> Result<TrajectoryFile, BadInput> {
    let fix = "each line has 12 numbers (KITTI, 3x4 matrix row by row) or 8 (TUM: time x y z qx qy qz qw)";
    let text = read_text(path, fix)?;
    let mut stamps = Vec::new();
    let mut poses = Vec::new();
    for (line, row) in text.lines().enumerate() {
        if row.trim().is_empty() || row.trim_start().starts_with('#') {
            continue;
        }
        let fault = |what: String| BadInput::at_line(path, &text, line, what, fix);
        let numbers: Vec<f64> = row
            .split_whitespace()
            .map(|word| {
                word.parse()
                    .ok()
                    .filter(|value: &f64| value.is_finite())
                    .ok_or_else(|| fault(format!("`{word}` is not a finite number")))
            })
            .collect::<Result<_, _>>()?;
        match *numbers.as_slice() {
            [a, b, c, x, d, e, f, y, g, h, i, z] => {
                let matrix = Matrix3::new(a, b, c, d, e, f, g, h, i);
                if (matrix.determinant() - 1.0).abs() > 1e-2 {
                    return Err(fault("the left 3x3 part is no rotation".to_owned()));
                }
                let rotation =
                    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
                        .into_inner();
                poses.push(Pose::from_parts(
                    Translation3::new(x, y, z),
                    UnitQuaternion::from_quaternion(rotation),
                ));
            }
            [stamp, x, y, z, i, j, k, w] => {
                stamps.push(stamp);
                let quaternion = Quaternion::new(w, i, j, k);
                if quaternion.norm() < 1e-6 {
                    return Err(fault("the quaternion is zero".to_owned()));
                }
                poses.push(Pose::from_parts(
                    Translation3::new(x, y, z),
                    UnitQuaternion::from_quaternion(quaternion),
                ));
            }
            _ => return Err(fault(format!("{} numbers in the line", numbers.len()))),
        }
        if !stamps.is_empty() && stamps.len() != poses.len() {
            return Err(fault("KITTI and TUM lines are mixed".to_owned()));
        }
    }
    if poses.is_empty() {
        return Err(BadInput::of_file(path, "holds no pose", fix));
    }
    let stamps_s = (!stamps.is_empty()).then_some(stamps);
    Ok(TrajectoryFile { stamps_s, poses })
}

/// Poses further apart in time than this are not the same frame.
const SAME_FRAME_S: f64 = 0.02;

/// Pairs of estimated and true poses: row by row, or by stamp where the estimate has stamps and `times` are the truth's.
///
/// # Errors
/// Row counts that differ without stamps, or no common stamp.
pub fn associate(
    estimate: (&Path, TrajectoryFile),
    truth: (&Path, TrajectoryFile),
    times: Option<&[f64]>,
) -> Result<(Vec<Pose>, Vec<Pose>), BadInput> {
    let (path, estimate) = estimate;
    let (truth_path, truth) = truth;
    let truth_stamps = truth.stamps_s.as_deref().or(times);
    if let (Some(stamps), Some(truth_stamps)) = (&estimate.stamps_s, truth_stamps) {
        if truth_stamps.len() < truth.poses.len() {
            return Err(BadInput::of_file(
                truth_path,
                format!("has {} poses for {} times", truth.poses.len(), truth_stamps.len()),
                "give the times.txt of this sequence",
            ));
        }
        let pairs: (Vec<Pose>, Vec<Pose>) = stamps
            .iter()
            .zip(&estimate.poses)
            .filter_map(|(stamp, pose)| {
                let (i, gap) = truth_stamps[..truth.poses.len()]
                    .iter()
                    .map(|t| (t - stamp).abs())
                    .enumerate()
                    .min_by(|a, b| a.1.total_cmp(&b.1))?;
                (gap < SAME_FRAME_S).then(|| (*pose, truth.poses[i]))
            })
            .unzip();
        if pairs.0.is_empty() {
            return Err(BadInput::of_file(
                path,
                "no stamp lies within 20 ms of a true one",
                "give both trajectories in seconds of the same clock, or --times the sequence's times.txt",
            ));
        }
        return Ok(pairs);
    }
    if estimate.poses.len() != truth.poses.len() {
        return Err(BadInput::of_file(
            path,
            format!(
                "has {} poses, {} has {}",
                estimate.poses.len(),
                truth_path.display(),
                truth.poses.len()
            ),
            "compare trajectory.tum with --times the sequence's times.txt, which pairs poses by their stamps",
        ));
    }
    Ok((estimate.poses, truth.poses))
}
