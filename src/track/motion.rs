//! The motion model: what the last step and the wheels foretell of the next one.
//!
//! In: the last pose, the time since then, wheel [`Travel`] where there is any. Out: a [`Foretold`]: the prior of the pose, and the
//! motion itself. The turn rate is that of the last step, the distance that of the wheels; without wheels the speed goes on.
//! Cost: constant.

use nalgebra::UnitQuaternion;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::Travel;
use super::pose::Prior;
use super::rolling::Rolling;
use crate::space::{Mount, Pose};

/// Longest time over which a turn rate is carried on.
const MAX_CARRY_S: f64 = 0.5;

/// The motion of the last step.
#[derive(Clone, Debug)]
pub(crate) struct MotionModel {
    pub(crate) rolling: Rolling,
    /// Wheel travel at the last frame.
    pub(crate) travel: Option<Travel>,
    /// `previous_from_current` of the last step, its time, and the speed along the path.
    turn: UnitQuaternion<f64>,
    turn_s: f64,
    speed_mps: f64,
}

/// The motion foretold for a step.
pub(crate) struct Foretold {
    pub(crate) prior: Prior,
    pub(crate) previous_from_current: Pose,
    pub(crate) dt_s: f64,
    /// Whether the wheels say so.
    pub(crate) measured: bool,
}

impl Foretold {
    /// The pose foretold.
    pub(crate) fn pose(&self) -> Pose {
        self.prior.world_from_previous * self.previous_from_current
    }
}

impl MotionModel {
    /// A car that was not seen to move yet.
    pub(crate) fn new(mount: &Mount, speed_mps: f64) -> Self {
        Self {
            rolling: Rolling::new(mount),
            travel: None,
            turn: UnitQuaternion::identity(),
            turn_s: 0.0,
            speed_mps,
        }
    }

    /// The step of `dt_s` to a frame with this travel. Where the last turn was not seen, or is too old, the wheels tell the heading.
    pub(crate) fn foretell(
        &self,
        world_from_previous: Pose,
        dt_s: f64,
        travel: Option<Travel>,
        is_turn_seen: bool,
    ) -> Foretold {
        let rolled = self.travel.zip(travel).map(|(before, now)| Travel {
            distance_m: now.distance_m - before.distance_m,
            heading_rad: now.heading_rad - before.heading_rad,
        });
        let rolled = rolled.filter(|r| r.distance_m.is_finite() && r.heading_rad.is_finite());
        let rotation = rolled
            .filter(|_| !is_turn_seen || dt_s > MAX_CARRY_S)
            .map_or_else(
                || self.carried_turn(dt_s),
                |rolled| self.rolling.turn(rolled.heading_rad),
            );
        let distance_m = rolled.map_or(self.speed_mps * dt_s, |r| r.distance_m);
        let sigma_along_m = if rolled.is_some() {
            0.01 * distance_m.abs() + 0.005
        } else {
            // A car brakes or gains 3 m/s^2.
            0.01 * distance_m.abs() + 0.01 + 1.5 * dt_s * dt_s
        };
        let prior = Prior {
            world_from_previous,
            rotation,
            distance_m,
            // An angular acceleration of 1.5 rad/s^2: a bump, a steering wheel turned fast.
            sigma_rotation_rad: 0.004 + 1.5 * dt_s * dt_s.min(MAX_CARRY_S),
            sigma_along_m,
            sigma_across_m: 0.02 * distance_m.abs() + 0.005,
        };
        Foretold {
            prior,
            previous_from_current: self.rolling.motion(distance_m, rotation),
            dt_s,
            measured: rolled.is_some(),
        }
    }

    /// The car stood in this step.
    pub(crate) fn stood(&mut self, foretold: &Foretold) {
        self.turn = UnitQuaternion::identity();
        self.turn_s = foretold.dt_s;
        if !foretold.measured {
            // Kept as the guess for driving off would be wrong by the whole speed: start slowly, let landmarks correct.
            self.speed_mps *= 0.5;
        }
    }

    /// The car moved so in this step.
    pub(crate) fn moved(&mut self, foretold: &Foretold, previous_from_current: &Pose) {
        self.turn = previous_from_current.rotation;
        self.turn_s = foretold.dt_s;
        let moved_m = if foretold.measured {
            foretold.prior.distance_m
        } else {
            previous_from_current.translation.vector.norm()
        };
        self.speed_mps = moved_m / foretold.dt_s;
    }

    /// Lengths are multiplied by `ratio`; those of wheels are metric.
    pub(crate) fn rescale(&mut self, ratio: f64) {
        if self.travel.is_none() {
            self.speed_mps *= ratio;
        }
    }

    fn carried_turn(&self, dt_s: f64) -> UnitQuaternion<f64> {
        if self.turn_s > 0.0 {
            self.turn.powf(dt_s.min(MAX_CARRY_S) / self.turn_s)
        } else {
            UnitQuaternion::identity()
        }
    }
}
