//! Wheel odometry: counter values or speeds of four wheels in, distance and heading at any stamp out.
//!
//! In: [`WheelReading`]s in the order of their stamps. Out: [`Travel`] at a stamp. Counters wrap; the increment between two
//! readings is the one nearest to what the last speed foretells, which is the smallest one at any usual message rate.
//! Counters that only count up take their sign from the direction, counters that also count down bring their own.
//! Between readings the travel is interpolated, after the last one it is extrapolated for at most
//! [`WheelConfig::timeout_micros`]; older stamps than the history holds have no answer.
//!
//! Invariant: increments of whole counts are summed, so rounding never accumulates. A wheel that disagrees with the median of
//! the four, now or over the last half second, is left out until it agrees again. Cost: constant for a reading, at most
//! [`WHEEL_HISTORY`] comparisons for a query. A full history forgets its oldest reading.

use heapless::Deque;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::budget::WHEEL_HISTORY;
use crate::space::Micros;

/// No road vehicle's wheel is faster.
const MAX_MPS: f64 = 100.0;
/// How far a wheel may be off the median of the four: inner and outer wheels of the tightest turn differ by 30 %.
const DISAGREEMENT: f64 = 0.4;
/// Counts by which four wheels may differ through rounding alone.
const QUANTISATION_COUNTS: f64 = 3.0;
/// Noise of a wheel speed near standing, where many sensors read zero.
const SPEED_NOISE_MPS: f64 = 0.5;
/// Time over which a wheel must agree with the others.
const AGREEMENT_S: f64 = 0.5;
/// Travel over this long tells the speed for extrapolation: at 50 Hz one interval alone would be a few counts.
const SPEED_WINDOW_MICROS: u64 = 100_000;

/// Share of readings at odds that is more than chance.
const DOUBTFUL_SHARE: f64 = 0.25;

const REAR_LEFT: usize = 2;
const REAR_RIGHT: usize = 3;

/// One message of the wheel encoders, in the order front left, front right, rear left, rear right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WheelReading {
    /// Raw counters and the direction of travel: 1 ahead, -1 back, 0 unknown or standing.
    Counts {
        /// Receive stamp.
        stamp: Micros,
        /// Counter values, each below the configured modulus.
        counts: [u32; 4],
        /// Sign of travel of each wheel.
        direction: [i8; 4],
    },
    /// Wheel speeds in metres a second, negative when rolling back.
    Speeds {
        /// Receive stamp.
        stamp: Micros,
        /// Speed of each wheel.
        mps: [f64; 4],
    },
}

impl WheelReading {
    /// Receive stamp.
    #[must_use]
    pub const fn stamp(&self) -> Micros {
        match self {
            Self::Counts { stamp, .. } | Self::Speeds { stamp, .. } => *stamp,
        }
    }
}

/// What the odometer must know of the encoders.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(deny_unknown_fields))]
pub struct WheelConfig {
    /// Metres a raw count; unused for speeds.
    #[cfg_attr(feature = "serde", serde(default))]
    pub metres_per_count: f64,
    /// Counter modulus (256 for 8 bits); unused for speeds.
    #[cfg_attr(feature = "serde", serde(default))]
    pub modulus: u32,
    /// Distance between the wheels of an axle.
    pub track_m: f64,
    /// Silence after which the travel is unknown.
    pub timeout_micros: u64,
}

/// Distance and heading since the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Travel {
    /// Signed distance of the rear axle's centre along its path.
    pub distance_m: f64,
    /// Heading from the rear wheels' difference, positive left.
    pub heading_rad: f64,
}

/// Integrates wheel readings.
#[derive(Clone, Debug)]
pub struct WheelOdometer {
    config: WheelConfig,
    last: Option<WheelReading>,
    /// Median speed as the raw values have it, for unwrapping: counters that only count up never go negative.
    raw_mps: f64,
    /// Last known sign of each wheel's travel.
    sign: [f64; 4],
    /// Each wheel's travel, forgotten over [`AGREEMENT_S`].
    recent_m: [f64; 4],
    travel: Travel,
    history: Deque<(Micros, Travel), WHEEL_HISTORY>,
    rejected: u64,
    wheel_faults: u64,
    /// Readings since the doubt was last taken, and those of them that left a wheel out.
    readings: u32,
    doubtful: u32,
}

impl WheelOdometer {
    /// An odometer that has seen nothing.
    #[must_use]
    pub const fn new(config: WheelConfig) -> Self {
        Self {
            config,
            last: None,
            raw_mps: 0.0,
            sign: [1.0; 4],
            recent_m: [0.0; 4],
            travel: Travel {
                distance_m: 0.0,
                heading_rad: 0.0,
            },
            history: Deque::new(),
            rejected: 0,
            wheel_faults: 0,
            readings: 0,
            doubtful: 0,
        }
    }

    /// Readings refused as a whole: out of order, of another kind than before, or implausible on two wheels or more.
    #[must_use]
    pub const fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Single wheels left out of a reading because the other wheels contradicted them.
    #[must_use]
    pub const fn wheel_faults(&self) -> u64 {
        self.wheel_faults
    }

    /// Whether one wheel was at odds with the others in more than a share of the readings since the last call: it slips, is
    /// locked, or its encoder is stuck. A single garbled reading is none of these.
    pub fn take_doubt(&mut self) -> bool {
        let is_doubtful = f64::from(self.doubtful) > DOUBTFUL_SHARE * f64::from(self.readings);
        (self.readings, self.doubtful) = (0, 0);
        is_doubtful
    }

    /// Whether all that is known lies further from a stamp than the time-out: the stamps come from clocks that disagree.
    #[must_use]
    pub fn is_apart(&self, stamp: Micros) -> bool {
        let timeout = self.config.timeout_micros;
        let (oldest, newest) = (self.history.front(), self.history.back());
        oldest.is_some_and(|(oldest, _)| oldest.since(stamp) > timeout)
            || newest.is_some_and(|(newest, _)| stamp.since(*newest) > timeout)
    }

    /// Stamp of the newest reading taken.
    #[must_use]
    pub fn newest(&self) -> Option<Micros> {
        self.history.back().map(|(stamp, _)| *stamp)
    }

    /// Takes a reading.
    pub fn push(&mut self, reading: WheelReading) {
        let Some(last) = self.last else {
            if self.plausible_alone(&reading) {
                self.last = Some(reading);
                self.remember(reading.stamp());
            } else {
                self.rejected += 1;
            }
            return;
        };
        let dt_s = reading.stamp().seconds_since(last.stamp());
        if dt_s <= 0.0 || !self.advance(&last, &reading, dt_s) {
            self.rejected += 1;
            return;
        }
        self.last = Some(reading);
        self.remember(reading.stamp());
    }

    /// Distance and heading since the first reading, at a stamp; none where no reading is near enough.
    #[must_use]
    pub fn travel_at(&self, stamp: Micros) -> Option<Travel> {
        let (newest, travel) = *self.history.back()?;
        if stamp >= newest {
            let ahead = stamp.since(newest);
            if ahead > self.config.timeout_micros {
                return None;
            }
            return Some(self.extrapolated(newest, &travel, stamp));
        }
        let mut later = (newest, travel);
        for earlier in self.history.iter().rev().skip(1) {
            if earlier.0 <= stamp {
                let share = stamp.seconds_since(earlier.0) / later.0.seconds_since(earlier.0);
                return Some(between(&earlier.1, &later.1, share));
            }
            later = *earlier;
        }
        None
    }

    fn extrapolated(&self, newest: Micros, travel: &Travel, stamp: Micros) -> Travel {
        let reference = self
            .history
            .iter()
            .rev()
            .find(|(s, _)| newest.since(*s) >= SPEED_WINDOW_MICROS)
            .or_else(|| self.history.front());
        match reference {
            Some((s, from))
                if *s < newest && newest.since(*s) <= self.config.timeout_micros.max(SPEED_WINDOW_MICROS) =>
            {
                between(from, travel, stamp.seconds_since(*s) / newest.seconds_since(*s))
            }
            _ => *travel,
        }
    }

    fn remember(&mut self, stamp: Micros) {
        if self.history.is_full() {
            self.history.pop_front();
        }
        // Just made room: nothing comes back.
        let _ = self.history.push_back((stamp, self.travel));
    }

    fn plausible_alone(&self, reading: &WheelReading) -> bool {
        match reading {
            WheelReading::Counts { .. } => self.config.modulus > 1 && self.config.metres_per_count > 0.0,
            WheelReading::Speeds { mps, .. } => mps.iter().filter(|v| v.abs() <= MAX_MPS).count() >= 3,
        }
    }

    /// Adds the travel between two readings; false where they make no sense together.
    fn advance(&mut self, last: &WheelReading, reading: &WheelReading, dt_s: f64) -> bool {
        let (increments_m, noise_m, noise_recent_m) = match (last, reading) {
            (
                WheelReading::Counts { counts: old, .. },
                WheelReading::Counts {
                    counts, direction, ..
                },
            ) => {
                let noise = QUANTISATION_COUNTS * self.config.metres_per_count;
                (self.counted(old, counts, direction, dt_s), noise, noise)
            }
            (WheelReading::Speeds { mps: old, .. }, WheelReading::Speeds { mps, .. }) => {
                let mut metres = [f64::NAN; 4];
                for wheel in 0..4 {
                    if mps[wheel].abs() <= MAX_MPS {
                        // A garbage value before this one is not a reason to lose this interval.
                        let before = if old[wheel].abs() <= MAX_MPS {
                            old[wheel]
                        } else {
                            mps[wheel]
                        };
                        metres[wheel] = 0.5 * (before + mps[wheel]) * dt_s;
                    }
                }
                (metres, SPEED_NOISE_MPS * dt_s, SPEED_NOISE_MPS * AGREEMENT_S)
            }
            _ => return false,
        };
        let plausible = |m: &f64| m.is_finite() && m.abs() <= MAX_MPS * dt_s;
        if increments_m.iter().filter(|m| plausible(m)).count() < 3 {
            return false;
        }
        let keep = (-dt_s / AGREEMENT_S).exp();
        let median_m = median(&increments_m);
        for wheel in 0..4 {
            let increment = if plausible(&increments_m[wheel]) {
                increments_m[wheel]
            } else {
                median_m
            };
            self.recent_m[wheel] = keep * self.recent_m[wheel] + increment;
        }
        let median_recent_m = median(&self.recent_m);
        let mut sound = [false; 4];
        for wheel in 0..4 {
            let agrees =
                |value: f64, of: f64, noise: f64| (value - of).abs() <= DISAGREEMENT * of.abs() + noise;
            sound[wheel] = plausible(&increments_m[wheel])
                && agrees(increments_m[wheel], median_m, noise_m)
                && agrees(self.recent_m[wheel], median_recent_m, noise_recent_m);
            self.wheel_faults += u64::from(!sound[wheel]);
        }
        self.readings = self.readings.saturating_add(1);
        self.doubtful = self.doubtful.saturating_add(u32::from(sound.contains(&false)));
        self.add(&increments_m, &sound, median_m);
        true
    }

    /// Travel of the rear axle's centre: the mean of its wheels, or one wheel and the turn seen by the front pair.
    fn add(&mut self, metres: &[f64; 4], sound: &[bool; 4], median_m: f64) {
        let turn = |left: usize, right: usize| (metres[right] - metres[left]) / self.config.track_m;
        let turn_rad = if sound[REAR_LEFT] && sound[REAR_RIGHT] {
            turn(REAR_LEFT, REAR_RIGHT)
        } else if sound[0] && sound[1] {
            turn(0, 1)
        } else {
            0.0
        };
        let half_m = 0.5 * turn_rad * self.config.track_m;
        let distance_m = match (sound[REAR_LEFT], sound[REAR_RIGHT]) {
            (true, true) => 0.5 * (metres[REAR_LEFT] + metres[REAR_RIGHT]),
            (true, false) => metres[REAR_LEFT] + half_m,
            (false, true) => metres[REAR_RIGHT] - half_m,
            (false, false) => median_m,
        };
        self.travel.distance_m += distance_m;
        if self.config.track_m > 0.0 {
            self.travel.heading_rad += turn_rad;
        }
    }

    /// Signed metres of each wheel from its counters.
    fn counted(&mut self, old: &[u32; 4], new: &[u32; 4], direction: &[i8; 4], dt_s: f64) -> [f64; 4] {
        let per_count = self.config.metres_per_count;
        let modulus = f64::from(self.config.modulus);
        let expected = (self.raw_mps * dt_s / per_count).round();
        let mut metres = [f64::NAN; 4];
        let mut raw_m = [f64::NAN; 4];
        for wheel in 0..4 {
            if new[wheel] >= self.config.modulus || old[wheel] >= self.config.modulus {
                continue;
            }
            let difference = f64::from(new[wheel]) - f64::from(old[wheel]);
            let raw = difference - ((difference - expected) / modulus).round() * modulus;
            raw_m[wheel] = raw * per_count;
            if direction[wheel] != 0 {
                self.sign[wheel] = f64::from(direction[wheel].signum());
            }
            // A counter that went down brings its own sign.
            metres[wheel] = if raw < 0.0 {
                raw_m[wheel]
            } else {
                raw_m[wheel] * self.sign[wheel]
            };
        }
        let raw_mps = median(&raw_m) / dt_s;
        if raw_mps.abs() <= MAX_MPS {
            self.raw_mps = raw_mps;
        }
        metres
    }
}

fn between(from: &Travel, to: &Travel, share: f64) -> Travel {
    Travel {
        distance_m: from.distance_m + share * (to.distance_m - from.distance_m),
        heading_rad: from.heading_rad + share * (to.heading_rad - from.heading_rad),
    }
}

/// Median of the finite values, the mean of the middle two where they are even in number; zero of none.
fn median(values: &[f64; 4]) -> f64 {
    let mut sorted = *values;
    // NaN sorts last.
    sorted.sort_unstable_by(|a, b| a.is_nan().cmp(&b.is_nan()).then(a.total_cmp(b)));
    match sorted.iter().filter(|v| v.is_finite()).count() {
        0 => 0.0,
        n if n % 2 == 1 => sorted[n / 2],
        n => 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]),
    }
}

#[cfg(test)]
#[path = "wheels_tests.rs"]
mod tests;
