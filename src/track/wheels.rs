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
mod tests {
    #![allow(
        clippy::unwrap_used,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "tests"
    )]
    use super::*;
    use proptest::prelude::*;

    const PER_COUNT: f64 = 0.02;

    fn config() -> WheelConfig {
        WheelConfig {
            metres_per_count: PER_COUNT,
            modulus: 256,
            track_m: 1.5,
            timeout_micros: 200_000,
        }
    }

    /// Counters as an encoder gives them, of wheels that have rolled so far; up-only ones count the absolute way.
    fn counts(stamp: u64, rolled_m: [f64; 4], direction: i8) -> WheelReading {
        WheelReading::Counts {
            stamp: Micros(stamp),
            counts: rolled_m.map(|m| ((m / PER_COUNT).floor() as i64).rem_euclid(256) as u32),
            direction: [direction; 4],
        }
    }

    proptest! {
        /// Whatever the speed profile, the error stays below two counts: no drift through rounding or wrapping.
        #[test]
        fn rounding_never_accumulates(speeds in prop::collection::vec(0.0..40.0f64, 20..200)) {
            let mut odometer = WheelOdometer::new(config());
            let mut rolled = 3.333;
            odometer.push(counts(0, [rolled; 4], 1));
            let mut stamp = 0;
            for speed in speeds {
                for _ in 0..5 {
                    stamp += 20_000;
                    rolled += speed * 0.02;
                    odometer.push(counts(stamp, [rolled; 4], 1));
                }
            }
            let travel = odometer.travel_at(Micros(stamp)).unwrap();
            prop_assert!((travel.distance_m - (rolled - 3.333)).abs() <= 2.0 * PER_COUNT);
            prop_assert!(travel.heading_rad.abs() < 1e-9);
            prop_assert_eq!(odometer.rejected(), 0);
        }

        /// Bytes at random neither panic nor move the car faster than a car can.
        #[test]
        fn garbage_is_survived(raw in prop::collection::vec((any::<u64>(), any::<[u32; 4]>(), any::<[i8; 4]>()), 1..60)) {
            let mut odometer = WheelOdometer::new(config());
            for (stamp, counts, direction) in raw {
                odometer.push(WheelReading::Counts { stamp: Micros(stamp % 10_000_000), counts, direction });
            }
            if let Some(travel) = odometer.newest().and_then(|s| odometer.travel_at(s)) {
                prop_assert!(travel.distance_m.abs() <= MAX_MPS * 10.0);
                prop_assert!(travel.heading_rad.is_finite());
            }
        }
    }

    #[test]
    fn rolling_back_subtracts_with_either_kind_of_counter() {
        for up_only in [true, false] {
            let mut odometer = WheelOdometer::new(config());
            let (mut rolled, mut counter) = (0.0, 0.0);
            for i in 0..300 {
                let back = i >= 150;
                let step = 0.101;
                rolled += if back { -step } else { step };
                counter += if back && !up_only { -step } else { step };
                odometer.push(counts(i * 20_000, [counter; 4], if back { -1 } else { 1 }));
            }
            let end = odometer.travel_at(Micros(299 * 20_000)).unwrap();
            // The first reading is the origin.
            assert!(
                (end.distance_m - (rolled - 0.101)).abs() < 0.1,
                "{up_only}: {}",
                end.distance_m
            );
        }
    }

    /// 30 m/s and messages lost for 0.15 s: 225 counts, more than half a turn of the counter.
    #[test]
    fn a_gap_at_speed_is_unwrapped_with_the_last_speed() {
        let mut odometer = WheelOdometer::new(config());
        for i in 0..50u64 {
            odometer.push(counts(i * 20_000, [i as f64 * 0.6; 4], 1));
        }
        odometer.push(counts(49 * 20_000 + 150_000, [49.0 * 0.6 + 4.5; 4], 1));
        let end = odometer.travel_at(odometer.newest().unwrap()).unwrap();
        assert!((end.distance_m - (49.0 * 0.6 + 4.5)).abs() < 0.05);
    }

    #[test]
    fn one_dead_or_mad_wheel_does_not_matter() {
        for wheel in 0..4 {
            for mad in [false, true] {
                let mut odometer = WheelOdometer::new(config());
                let mut random = 12345u64;
                for i in 0..500u64 {
                    // A left turn: the right wheels roll further.
                    let mut rolled = [0.97, 1.03, 0.95, 1.05].map(|share| share * i as f64 * 0.2);
                    random = random
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1_442_695_040_888_963_407);
                    rolled[wheel] = if mad { (random >> 52) as f64 * 0.01 } else { 0.0 };
                    odometer.push(counts(i * 20_000, rolled, 1));
                }
                let end = odometer.travel_at(Micros(499 * 20_000)).unwrap();
                assert!(
                    (end.distance_m - 99.8).abs() < 2.5,
                    "wheel {wheel} mad {mad}: {}",
                    end.distance_m
                );
                assert!(odometer.wheel_faults() > 300);
            }
        }
    }

    #[test]
    fn speeds_integrate_by_trapezoid_and_turn() {
        let mut odometer = WheelOdometer::new(config());
        for i in 0..=100u64 {
            let v = 0.1 * i as f64;
            odometer.push(WheelReading::Speeds {
                stamp: Micros(i * 20_000),
                mps: [v - 0.15, v + 0.15, v - 0.15, v + 0.15],
            });
        }
        let end = odometer.travel_at(Micros(2_000_000)).unwrap();
        assert!((end.distance_m - 10.0).abs() < 1e-9);
        assert!((end.heading_rad - 0.3 * 2.0 / 1.5).abs() < 1e-9);
        let half = odometer.travel_at(Micros(1_010_000)).unwrap();
        assert!((half.distance_m - 0.5 * 5.0 * 1.01 * 1.01).abs() < 1e-3);
    }

    #[test]
    fn silence_and_disorder() {
        let mut odometer = WheelOdometer::new(config());
        assert_eq!(odometer.travel_at(Micros(5)), None);
        let speeds = |stamp, v: f64| WheelReading::Speeds {
            stamp: Micros(stamp),
            mps: [v; 4],
        };
        odometer.push(speeds(0, f64::NAN));
        odometer.push(speeds(10_000, 10.0));
        odometer.push(speeds(20_000, 10.0));
        odometer.push(speeds(20_000, 10.0));
        odometer.push(speeds(15_000, 10.0));
        odometer.push(speeds(30_000, f64::INFINITY));
        odometer.push(counts(40_000, [1.0; 4], 1));
        assert_eq!(odometer.rejected(), 5);
        // Extrapolated at 10 m/s, then unknown; before the first reading unknown too.
        let soon = odometer.travel_at(Micros(120_000)).unwrap();
        assert!((soon.distance_m - 1.1).abs() < 1e-9);
        assert_eq!(odometer.travel_at(Micros(220_001)), None);
        assert_eq!(odometer.travel_at(Micros(9_999)), None);
    }

    /// Two seconds at 50 Hz and 10 m/s; `rolled` says what the rear left wheel's counter shows of the true travel.
    fn doubt_of(rolled: impl Fn(u64, f64) -> f64) -> bool {
        let mut odometer = WheelOdometer::new(config());
        for k in 0..100 {
            let truth = 0.2 * k as f64;
            odometer.push(counts(k * 20_000, [truth, truth, rolled(k, truth), truth], 1));
        }
        odometer.take_doubt()
    }

    #[test]
    fn a_wheel_that_sticks_or_slips_is_doubted_and_a_garbled_reading_is_not() {
        assert!(!doubt_of(|_, truth| truth));
        assert!(
            doubt_of(|_, truth| truth.min(10.0)),
            "stuck from the first second on"
        );
        assert!(
            doubt_of(|_, truth| truth + (truth - 10.0).clamp(0.0, 6.0)),
            "spinning"
        );
        assert!(!doubt_of(|k, truth| if k == 50 { truth + 1.5 } else { truth }));
    }

    #[test]
    fn stamps_of_another_clock_are_apart() {
        let mut odometer = WheelOdometer::new(config());
        assert!(!odometer.is_apart(Micros(0)));
        for k in 100..110 {
            odometer.push(counts(k * 20_000, [0.0; 4], 1));
        }
        for (stamp, is_apart) in [
            (1_700_000, true),
            (1_900_000, false),
            (2_300_000, false),
            (2_400_000, true),
        ] {
            assert_eq!(odometer.is_apart(Micros(stamp)), is_apart, "{stamp}");
        }
    }
}
