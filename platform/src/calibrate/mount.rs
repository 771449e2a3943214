//! The camera's place on the car, from a recording of straight driving.
//!
//! In: a way to survey the recording under a mount. Out: [`MountEstimate`]: pitch and yaw from the direction of travel in camera
//! space (a car drives where its wheels point), height from the road's plane at the wheels' scale; the roll against that plane is told.
//! Method: medians over straight stretches; the pipeline expects a mount itself, so the survey is repeated with the one found
//! until it stays, at most `ROUNDS` times; one that does not stay is told as such.

use freespace::health::ScaleState;
use freespace::priors::PlaneConfig;
use freespace::space::Mount;
use serde::Serialize;

use super::robust::{Robust, robust};
use super::survey::{Stretch, Survey};

/// Surveys at most.
pub const ROUNDS: usize = 5;
/// A change by less ends the rounds.
const STILL_RAD: f64 = 0.001;
const STILL_SHARE: f64 = 0.004;
/// A stretch shorter than this says more of the springs than of the mount.
const SHORTEST_M: f64 = 1.0;
/// A path bent more than this is a curve: a radius of 250 m.
const STRAIGHT_PER_M: f64 = 0.004;
/// So many straight stretches are enough: ten seconds.
const ENOUGH: usize = 15;
/// So many views of the road's plane are: their median is judged by its spread besides.
const ENOUGH_PLANES: usize = 10;
/// Less travel than this is no drive.
const LEAST_TRAVEL_M: f64 = 20.0;
/// A median that is known no better than this is not given.
const VAGUE_ROLL_RAD: f64 = 0.01;
const VAGUE_HEIGHT_SHARE: f64 = 0.03;

/// The mount, each value with its spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MountEstimate {
    /// Pitch, positive down, from the direction of travel.
    pub pitch_rad: Robust,
    /// Yaw, positive left, from the direction of travel.
    pub yaw_rad: Robust,
    /// Roll against the road's plane, positive clockwise; none where too little of it was seen. Crown and verges of the road are in it
    /// (0.03 rad on KITTI 03), so it is told and not taken over.
    pub roll_rad: Option<Robust>,
    /// Pitch against the road's plane: a check of the first.
    pub plane_pitch_rad: Option<Robust>,
    /// Height over the road; none without wheels, or where the plane was seen too seldom.
    pub height_m: Option<Robust>,
    /// Straight stretches used.
    pub stretches: usize,
    /// Stretches left out: curves, and too short.
    pub left_out: usize,
    /// Surveys made.
    pub rounds: usize,
    /// Whether the last survey found the mount that it was made under; else these values are on their way.
    pub is_still: bool,
}

/// Why a recording gives no mount.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MountError {
    /// It hardly moves.
    #[error("the car travels {0:.0} m in it: it stands, or the recording is too short")]
    Standing(f64),
    /// Too few stretches at all.
    #[error(
        "it has {0} stretches of tracked travel, {ENOUGH} are wanted: it is too short, or tracking fails"
    )]
    TooShort(usize),
    /// It moves, in curves.
    #[error("{straight} of its {all} stretches are straight, {ENOUGH} are wanted: it is too curved")]
    Curved {
        /// Straight ones.
        straight: usize,
        /// All.
        all: usize,
    },
}

impl MountError {
    /// What to do about it.
    #[must_use]
    pub const fn fix(&self) -> &'static str {
        match self {
            Self::Standing(_) => "record a drive of 20 s or more at 20 km/h or more on a straight, flat road",
            Self::TooShort(_) => {
                "record 20 s or more by daylight, with something to see beside the road; check the lens first"
            }
            Self::Curved { .. } => {
                "record on a straight road: curves turn the camera across the direction of travel"
            }
        }
    }
}

/// The plane's search while the mount is not known: it looks far around the mount, and leans little on it.
#[must_use]
pub fn open_minded(config: &PlaneConfig, round: usize) -> PlaneConfig {
    // The first round must find a mount that is off by half a metre or 5 degrees; later ones be precise.
    let doubt = if round == 0 { 1.0 } else { 0.5 };
    PlaneConfig {
        distance_range_m: config.distance_range_m.max(0.8 * doubt),
        distance_sigma_m: config.distance_sigma_m.max(0.5 * doubt),
        pitch_range_rad: config.pitch_range_rad.max(0.12 * doubt),
        pitch_sigma_rad: config.pitch_sigma_rad.max(0.05 * doubt),
        roll_sigma_rad: config.roll_sigma_rad.max(0.04 * doubt),
        ..*config
    }
}

/// Finds the mount; `survey` surveys the recording under a mount, in a round counted from zero.
///
/// # Errors
/// [`MountError`], where the recording is unfit.
pub fn calibrate(
    first: &Mount,
    survey: &mut dyn FnMut(&Mount, usize) -> Survey,
) -> Result<MountEstimate, MountError> {
    let mut mount = *first;
    let mut rounds = 0;
    loop {
        let mut estimate = estimate(&survey(&mount, rounds), &mount)?;
        rounds += 1;
        estimate.rounds = rounds;
        let next = estimate.applied(&mount);
        let is_still = (next.pitch_rad - mount.pitch_rad).abs() < STILL_RAD
            && (next.yaw_rad - mount.yaw_rad).abs() < STILL_RAD
            && (next.height_m / mount.height_m - 1.0).abs() < STILL_SHARE;
        estimate.is_still = is_still;
        mount = next;
        if is_still || rounds == ROUNDS {
            return Ok(estimate);
        }
    }
}

impl MountEstimate {
    /// A mount with what was found in place of what it said; its roll stays, for the road's own roll is in the one found.
    #[must_use]
    pub fn applied(&self, mount: &Mount) -> Mount {
        Mount {
            height_m: self.height_m.map_or(mount.height_m, |height| height.value),
            pitch_rad: self.pitch_rad.value,
            yaw_rad: self.yaw_rad.value,
            ..*mount
        }
    }
}

/// Whether a stretch is long and straight enough.
#[must_use]
pub fn is_straight(stretch: &Stretch) -> bool {
    let length_m = stretch.travel.norm();
    length_m >= SHORTEST_M && stretch.travel.z > 0.0 && stretch.turn_rad.abs() < STRAIGHT_PER_M * length_m
}

/// The straight stretches of a survey.
///
/// # Errors
/// [`MountError`] where they are too few.
pub fn straight_stretches(survey: &Survey) -> Result<Vec<Stretch>, MountError> {
    let moving = survey
        .stretches
        .iter()
        .filter(|stretch| stretch.travel.norm() >= SHORTEST_M)
        .count();
    let straight: Vec<Stretch> = survey
        .stretches
        .iter()
        .filter(|s| is_straight(s))
        .copied()
        .collect();
    let travelled_m = survey.travelled_m();
    if travelled_m < LEAST_TRAVEL_M {
        Err(MountError::Standing(travelled_m))
    } else if moving < ENOUGH {
        Err(MountError::TooShort(moving))
    } else if straight.len() < ENOUGH {
        Err(MountError::Curved {
            straight: straight.len(),
            all: moving,
        })
    } else {
        Ok(straight)
    }
}

fn estimate(survey: &Survey, mount: &Mount) -> Result<MountEstimate, MountError> {
    let straight = straight_stretches(survey)?;
    let too_short = MountError::TooShort(straight.len());
    let planes = || straight.iter().filter_map(|stretch| stretch.plane);
    let roll = robust(planes().map(|plane| (-plane.normal.x).atan2(-plane.normal.y)))
        .filter(|roll| roll.count >= ENOUGH_PLANES && roll.sigma < VAGUE_ROLL_RAD);
    let angles = |stretch: &Stretch| travel_angles(stretch, mount.roll_rad, mount.ahead_m);
    let pitch_rad = robust(straight.iter().map(|stretch| angles(stretch).0)).ok_or(too_short)?;
    let yaw_rad = robust(straight.iter().map(|stretch| angles(stretch).1)).ok_or(too_short)?;
    let metric = straight
        .iter()
        .filter(|stretch| stretch.scale == ScaleState::Wheels);
    let height_m = robust(
        metric
            .filter_map(|stretch| stretch.plane)
            .map(|plane| plane.offset_m),
    )
    .filter(|height| height.count >= ENOUGH_PLANES && height.sigma < VAGUE_HEIGHT_SHARE * height.value);
    Ok(MountEstimate {
        pitch_rad,
        yaw_rad,
        roll_rad: roll,
        plane_pitch_rad: robust(planes().map(|plane| -plane.normal.z.clamp(-1.0, 1.0).asin())),
        height_m,
        stretches: straight.len(),
        left_out: survey.stretches.len() - straight.len(),
        rounds: 0,
        is_still: false,
    })
}

/// Pitch and yaw of a camera of that roll that travels as in `stretch`, `ahead_m` ahead of the axle that follows the wheels.
///
/// With `vehicle_from_camera = yaw * pitch * roll * level` the direction of travel is the vehicle's x axis.
fn travel_angles(stretch: &Stretch, roll_rad: f64, ahead_m: f64) -> (f64, f64) {
    let direction = stretch.travel.normalize();
    // In a vehicle's axes: x ahead, y left, z up.
    let (ahead, left, up) = (direction.z, -direction.x, -direction.y);
    let (sin, cos) = roll_rad.sin_cos();
    let (left, up) = (cos * left - sin * up, sin * left + cos * up);
    // A camera ahead of the axle swings out in a bend: to the right where the turn is to the right.
    let swing_rad = ahead_m * stretch.turn_rad / stretch.travel.norm();
    (up.atan2(ahead), (-left).asin() - swing_rad)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_precision_loss, reason = "tests")]
    use freespace::space::Micros;
    use nalgebra::Vector3;

    use super::*;

    const TRUTH: Mount = Mount {
        height_m: 1.4,
        ahead_m: 1.6,
        left_m: 0.0,
        pitch_rad: 0.05,
        yaw_rad: -0.03,
        roll_rad: 0.02,
    };

    /// A car that drives so many straight and curved stretches, seen by a perfect tracker.
    fn drive(straight: usize, curved: usize, length_m: f64) -> Survey {
        let camera_from_vehicle = TRUTH.vehicle_from_camera().rotation.inverse();
        let stretch = |turn_rad: f64| Stretch {
            stamps: (Micros(0), Micros(0)),
            travel: camera_from_vehicle * Vector3::x() * length_m,
            turn_rad,
            wheel_m: Some(length_m),
            plane: Some(TRUTH.plane_in_camera()),
            scale: ScaleState::Wheels,
        };
        let mut stretches = vec![stretch(0.0); straight];
        stretches.extend(vec![stretch(0.2); curved]);
        Survey {
            stretches,
            ..Survey::default()
        }
    }

    #[test]
    fn the_angles_are_those_of_the_mount() {
        let wrong = Mount {
            pitch_rad: 0.0,
            yaw_rad: 0.0,
            height_m: 1.2,
            ..TRUTH
        };
        let found = calibrate(&wrong, &mut |_, _| drive(30, 5, 4.0)).unwrap();
        let mount = found.applied(&wrong);
        assert!((mount.pitch_rad - TRUTH.pitch_rad).abs() < 1e-9, "{found:?}");
        assert!((mount.yaw_rad - TRUTH.yaw_rad).abs() < 1e-9, "{found:?}");
        assert!(
            (found.roll_rad.unwrap().value - TRUTH.roll_rad).abs() < 1e-9,
            "{found:?}"
        );
        assert!((mount.height_m - TRUTH.height_m).abs() < 1e-9);
        assert!((found.plane_pitch_rad.unwrap().value - TRUTH.pitch_rad).abs() < 1e-9);
        assert_eq!((found.stretches, found.left_out, found.rounds), (30, 5, 2));
        assert!(found.is_still);
    }

    #[test]
    fn a_mount_that_does_not_settle_is_told() {
        let found = calibrate(&TRUTH, &mut |_, round| {
            let mut survey = drive(30, 0, 4.0);
            // The camera sags a little more each time it is looked at.
            for stretch in &mut survey.stretches {
                stretch.travel.y += 0.02 * (1 + round) as f64;
            }
            survey
        });
        let found = found.unwrap();
        assert_eq!((found.rounds, found.is_still), (ROUNDS, false));
    }

    #[test]
    fn unfit_recordings_are_refused_with_what_to_do() {
        for (survey, wanted) in [
            (drive(30, 0, 0.1), "it stands"),
            (drive(8, 0, 4.0), "too short"),
            (drive(8, 40, 4.0), "8 of its 48 stretches are straight"),
        ] {
            let error = calibrate(&TRUTH, &mut |_, _| survey.clone()).unwrap_err();
            assert!(error.to_string().contains(wanted), "{error}");
            assert!(error.fix().contains("record"));
        }
    }

    #[test]
    fn without_wheels_there_is_no_height() {
        let mut survey = drive(30, 0, 4.0);
        for stretch in &mut survey.stretches {
            stretch.scale = ScaleState::CameraHeight;
        }
        let found = calibrate(&TRUTH, &mut |_, _| survey.clone()).unwrap();
        assert!(found.height_m.is_none() && found.roll_rad.is_some());
    }
}
