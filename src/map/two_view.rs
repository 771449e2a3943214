//! Relative pose of two views from their common tracks.
//!
//! In: matched bearings (normalised image plane, z = 1) and the motion as tracked. Out: rotation, direction of travel, inliers
//! and whether there is parallax enough for the direction to mean anything. The tracked motion is hypothesis zero; five-point
//! samples follow, as many as its inlier share leaves necessary, at most [`RANSAC_SAMPLES`]. The best is refined by
//! Gauss-Newton on the robust Sampson error, [`REFINE_STEPS`] steps. Samples come from a seeded generator.
//! Source: Nister 2004; Torr and Zisserman, *MLESAC* (2000), for the truncated score.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::neg_cmp_op_on_partial_ord,
    clippy::type_complexity,
    reason = "indices into at most MAX_TRACKS matches; a NaN must fail a comparison; five pairs are a plain type"
)]

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::five_point::essential_matrices;
use crate::budget::RANSAC_SAMPLES;
use crate::space::Pose;

/// Gauss-Newton steps on the five degrees of freedom.
const REFINE_STEPS: usize = 6;
/// Matches that score a hypothesis; an even stride through all of them.
const SCORED_MATCHES: usize = 200;
/// Sampson error of an inlier: three standard deviations of a KLT track.
const INLIER_PX: f64 = 1.5;
/// Mean angle between the rays of a pair below which its direction is not used: noise of half a pixel at 720 px focal
/// length alone makes 1.3e-3.
const WEAK_PARALLAX_RAD: f64 = 2.0e-3;
/// Inliers below which a pair is not used.
const MIN_INLIERS: usize = 20;

/// A track in both views of a pair.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    pub(super) first: Vector3<f64>,
    pub(super) second: Vector3<f64>,
}

/// Motion between two views up to the length of its translation.
#[derive(Clone, Copy, Debug)]
pub(super) struct RelativePose {
    pub(super) rotation: UnitQuaternion<f64>,
    /// Unit vector from the first camera to the second, in the first's space.
    pub(super) direction: Vector3<f64>,
    pub(super) inliers: usize,
    /// Whether the direction is known; without parallax only the rotation is.
    pub(super) has_parallax: bool,
}

/// Permuted congruential generator (O'Neill 2014, XSH-RR 64/32).
#[derive(Clone, Debug)]
pub(super) struct Pcg(u64);

impl Pcg {
    pub(super) const fn new(seed: u64) -> Self {
        Self(seed.wrapping_add(1_442_695_040_888_963_407))
    }

    /// Even in [0, 1).
    #[cfg(test)]
    pub(super) fn unit(&mut self) -> f64 {
        self.below(1 << 30) as f64 / f64::from(1 << 30)
    }

    fn below(&mut self, bound: usize) -> usize {
        let old = self.0;
        self.0 = old
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let bits = (((old >> 18) ^ old) >> 27) as u32;
        let value = bits.rotate_right((old >> 59) as u32);
        ((u64::from(value) * bound as u64) >> 32) as usize
    }
}

/// Rotation and unit translation with their essential matrix: `first . E second = 0`.
#[derive(Clone, Copy)]
struct Hypothesis {
    rotation: UnitQuaternion<f64>,
    direction: Vector3<f64>,
}

impl Hypothesis {
    fn essential(&self) -> Matrix3<f64> {
        self.direction.cross_matrix() * self.rotation.to_rotation_matrix().matrix()
    }
}

/// The relative pose of the second view in the first; none with fewer than [`MIN_INLIERS`] matches that agree.
pub(super) fn relative_pose(
    matches: &[Match],
    tracked: &Pose,
    focal_px: f64,
    random: &mut Pcg,
) -> Option<RelativePose> {
    if matches.len() < MIN_INLIERS {
        return None;
    }
    let mut best = Hypothesis {
        rotation: tracked.rotation,
        direction: tracked
            .translation
            .vector
            .try_normalize(1e-6)
            .unwrap_or(Vector3::z()),
    };
    best = refine(matches, best, focal_px);
    let mut best_score = score(matches, &best.essential(), focal_px);
    let mut needed = samples_needed(inlier_share(matches, &best.essential(), focal_px));
    let mut sample = 0;
    while sample < needed.min(RANSAC_SAMPLES) {
        sample += 1;
        let Some((first, second)) = draw(matches, random) else {
            continue;
        };
        for essential in essential_matrices(&first, &second) {
            // A raw sample carries the noise of five points; refined it may still win.
            if score(matches, &essential, focal_px) >= 1.3 * best_score {
                continue;
            }
            let Some(candidate) = decompose(&essential, matches, focal_px) else {
                continue;
            };
            let candidate = refine(matches, candidate, focal_px);
            let candidate_score = score(matches, &candidate.essential(), focal_px);
            if candidate_score < best_score {
                best = candidate;
                best_score = candidate_score;
                needed = samples_needed(inlier_share(matches, &best.essential(), focal_px));
            }
        }
    }
    judge(matches, &best, focal_px)
}

/// Samples until one is clean with 99 percent confidence.
fn samples_needed(inlier_share: f64) -> usize {
    let clean = inlier_share.powi(5);
    if clean > 0.99 {
        return 1;
    }
    let samples = (0.01_f64).ln() / (1.0 - clean).ln();
    if samples < RANSAC_SAMPLES as f64 {
        samples as usize + 1
    } else {
        RANSAC_SAMPLES
    }
}

/// Five different matches.
fn draw(matches: &[Match], random: &mut Pcg) -> Option<([Vector3<f64>; 5], [Vector3<f64>; 5])> {
    let mut chosen = [usize::MAX; 5];
    for k in 0..5 {
        let index = random.below(matches.len());
        if chosen[..k].contains(&index) {
            return None;
        }
        chosen[k] = index;
    }
    Some((
        chosen.map(|i| matches[i].first),
        chosen.map(|i| matches[i].second),
    ))
}

/// Signed first-order distance from the epipolar constraint, in pixels.
fn sampson_px(essential: &Matrix3<f64>, m: &Match, focal_px: f64) -> f64 {
    let line = essential * m.second;
    let other = essential.tr_mul(&m.first);
    let size = line.x * line.x + line.y * line.y + other.x * other.x + other.y * other.y;
    focal_px * m.first.dot(&line) / size.max(1e-24).sqrt()
}

fn scored(matches: &[Match]) -> impl Iterator<Item = &Match> {
    matches
        .iter()
        .step_by(matches.len().div_ceil(SCORED_MATCHES).max(1))
}

fn score(matches: &[Match], essential: &Matrix3<f64>, focal_px: f64) -> f64 {
    scored(matches)
        .map(|m| {
            sampson_px(essential, m, focal_px)
                .powi(2)
                .min(INLIER_PX * INLIER_PX)
        })
        .sum()
}

fn inlier_share(matches: &[Match], essential: &Matrix3<f64>, focal_px: f64) -> f64 {
    let (mut inliers, mut all) = (0.0, 0.0);
    for m in scored(matches) {
        all += 1.0;
        if sampson_px(essential, m, focal_px).abs() < INLIER_PX {
            inliers += 1.0;
        }
    }
    if all > 0.0 { inliers / all } else { 0.0 }
}

/// Points before both cameras less points that are not, over the scored inliers.
fn cheirality(matches: &[Match], h: &Hypothesis, focal_px: f64) -> i32 {
    let essential = h.essential();
    let mut balance = 0;
    for m in scored(matches) {
        if sampson_px(&essential, m, focal_px).abs() > INLIER_PX {
            continue;
        }
        let second = h.rotation * m.second;
        // Depths along both rays where they come nearest: a first - b second = direction.
        let normal = m.first.cross(&second);
        let size = normal.norm_squared();
        if size < 1e-12 {
            continue;
        }
        let a = h.direction.cross(&second).dot(&normal) / size;
        let b = h.direction.cross(&m.first).dot(&normal) / size;
        balance += if a > 0.0 && b > 0.0 { 1 } else { -1 };
    }
    balance
}

/// The one of the four poses of an essential matrix that has the points before both cameras.
fn decompose(essential: &Matrix3<f64>, matches: &[Match], focal_px: f64) -> Option<Hypothesis> {
    let svd = essential.try_svd(true, true, 1e-12, 100)?;
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let mut best: Option<(i32, Hypothesis)> = None;
    // Singular values come in no promised order: the direction is the left singular vector of the smallest.
    let smallest = svd.singular_values.imin();
    let order = [(smallest + 1) % 3, (smallest + 2) % 3, smallest];
    let u = Matrix3::from_fn(|r, c| u[(r, order[c])]);
    let v_t = Matrix3::from_fn(|r, c| v_t[(order[r], c)]);
    for turn in [w, w.transpose()] {
        let rotation =
            UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(u * turn * v_t));
        for sign in [1.0, -1.0] {
            let h = Hypothesis {
                rotation,
                direction: u.column(2) * sign,
            };
            let balance = cheirality(matches, &h, focal_px);
            if best.is_none_or(|(most, _)| balance > most) {
                best = Some((balance, h));
            }
        }
    }
    best.map(|(_, h)| h)
}

/// Gauss-Newton with Cauchy weights; the denominator of the Sampson error counts as constant within a step.
fn refine(matches: &[Match], mut h: Hypothesis, focal_px: f64) -> Hypothesis {
    for _ in 0..REFINE_STEPS {
        let essential = h.essential();
        let (across, over) = tangents(&h.direction);
        let mut normal = SMatrix::<f64, 5, 5>::zeros();
        let mut gradient = SVector::<f64, 5>::zeros();
        for m in matches {
            let line = essential * m.second;
            let other = essential.tr_mul(&m.first);
            let size = line.x * line.x + line.y * line.y + other.x * other.x + other.y * other.y;
            let scale = focal_px / size.max(1e-24).sqrt();
            let error = m.first.dot(&line) * scale;
            let weight = 1.0 / (1.0 + (error / INLIER_PX).powi(2)).powi(2);
            let by_turn = -other.cross(&m.second) * scale;
            let by_direction = (h.rotation * m.second).cross(&m.first) * scale;
            let row = SVector::<f64, 5>::from([
                by_turn.x,
                by_turn.y,
                by_turn.z,
                by_direction.dot(&across),
                by_direction.dot(&over),
            ]);
            normal.syger(weight, &row, &row, 1.0);
            gradient.axpy(-weight * error, &row, 1.0);
        }
        for k in 0..5 {
            normal[(k, k)] += 1e-6 * normal[(k, k)] + 1e-6;
        }
        let Some(step) = normal.cholesky().map(|c| c.solve(&gradient)) else {
            break;
        };
        if !(step.norm() < 1.0) {
            break;
        }
        h.rotation *= UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        h.direction = (h.direction + across * step[3] + over * step[4]).normalize();
        if step.norm() < 1e-8 {
            break;
        }
    }
    h
}

/// Two unit vectors orthogonal to `direction` and each other.
fn tangents(direction: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let axis = if direction.x.abs() < 0.6 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let across = direction.cross(&axis).normalize();
    (across, direction.cross(&across))
}

fn judge(matches: &[Match], h: &Hypothesis, focal_px: f64) -> Option<RelativePose> {
    let essential = h.essential();
    let (mut inliers, mut parallax) = (0, 0.0);
    for m in matches {
        if sampson_px(&essential, m, focal_px).abs() < INLIER_PX {
            inliers += 1;
            let (a, b) = (m.first.normalize(), h.rotation * m.second.normalize());
            parallax += a.cross(&b).norm();
        }
    }
    if inliers < MIN_INLIERS {
        return None;
    }
    let has_parallax = parallax / inliers as f64 > WEAK_PARALLAX_RAD;
    let flipped = Hypothesis {
        direction: -h.direction,
        ..*h
    };
    let backwards =
        has_parallax && cheirality(matches, &flipped, focal_px) > cheirality(matches, h, focal_px);
    Some(RelativePose {
        rotation: h.rotation,
        direction: if backwards { -h.direction } else { h.direction },
        inliers,
        has_parallax,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use proptest::prelude::*;

    /// Points in a box ahead, 0.5 px of noise at 700 px, every fifth match wrong.
    fn scene(rotation: &UnitQuaternion<f64>, t: &Vector3<f64>, seed: u64) -> heapless::Vec<Match, 300> {
        let mut random = Pcg::new(seed);
        let mut unit = move || random.below(1 << 20) as f64 / f64::from(1 << 20) - 0.5;
        let mut matches = heapless::Vec::new();
        while !matches.is_full() {
            let p = Vector3::new(20.0 * unit(), 6.0 * unit(), 16.0 + 20.0 * unit());
            let q = rotation.inverse() * (p - t);
            let mut noisy =
                |v: Vector3<f64>| Vector3::new(v.x / v.z + 2.4e-3 * unit(), v.y / v.z + 2.4e-3 * unit(), 1.0);
            let (first, mut second) = (noisy(p), noisy(q));
            if matches.len() % 5 == 0 {
                second += Vector3::new(0.1 * unit(), 0.1 * unit(), 0.0);
            }
            matches.push(Match { first, second }).unwrap();
        }
        matches
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn motion_is_recovered_from_a_useless_prior(turn in prop::array::uniform3(-0.1..0.1f64), step in prop::array::uniform3(-1.0..1.0f64), seed in 0u64..1000) {
            let t = Vector3::from(step);
            prop_assume!(t.norm() > 0.5);
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
            let matches = scene(&rotation, &t, seed);
            let found = relative_pose(&matches, &Pose::translation(0.0, 0.0, -1.0), 700.0, &mut Pcg::new(seed)).unwrap();
            prop_assert!(found.rotation.angle_to(&rotation) < 0.02, "{}", found.rotation.angle_to(&rotation));
            prop_assert!(found.direction.angle(&t) < 0.2, "{}", found.direction.angle(&t));
            prop_assert!(found.has_parallax);
        }
    }

    #[test]
    fn pure_rotation_has_no_parallax() {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.05, 0.0));
        let matches = scene(&rotation, &Vector3::zeros(), 3);
        let found = relative_pose(&matches, &Pose::identity(), 700.0, &mut Pcg::new(1)).unwrap();
        assert!(!found.has_parallax);
        assert!(found.rotation.angle_to(&rotation) < 0.003);
    }
}
