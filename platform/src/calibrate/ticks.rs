//! Metres a count of the wheel encoders: from a known distance, or from the picture's scale.
//!
//! In: wheel readings, the configured odometer, and a distance or stretches of travel at a known camera height. Out: [`Ticks`].
//! Invariant: counters wrap and miss readings as in a drive, for the drive's own odometer counts them. Cost: five odometers.

use freespace::space::Micros;
use freespace::track::{WheelConfig, WheelOdometer, WheelReading};
use serde::Serialize;

use super::robust::{Robust, robust};
use super::survey::Stretch;

/// A distance of fewer counts is rounded by more than a share of a percent.
const LEAST_COUNTS: f64 = 400.0;
/// Stretches wanted: ten seconds.
const ENOUGH: usize = 15;
/// A wheel this far from the others does not roll like them: stuck, slipping, or of another tyre.
const ODD_WHEEL: f64 = 0.03;

/// Names of the wheels in the core's order.
pub const WHEELS: [&str; 4] = ["front_left", "front_right", "rear_left", "rear_right"];

/// What the encoders were found to measure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ticks {
    /// Metres a raw count, of the rear axle's centre.
    pub metres_per_count: f64,
    /// Relative standard deviation of it.
    pub sigma: f64,
    /// The stretches' ratios of visual to configured distance; none from a known distance.
    pub stretches: Option<Robust>,
    /// Counts of each wheel over the whole log.
    pub counts: [f64; 4],
    /// Counts of the left wheels over those of the right, less one: front, rear.
    pub left_over_right: [f64; 2],
}

/// Why a log gives no metres a count.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TicksError {
    /// Too little was rolled.
    #[error("the rear wheels count {0:.0} in it, {LEAST_COUNTS:.0} are wanted")]
    TooFewCounts(f64),
    /// Too few stretches in which picture and wheels both tell a distance.
    #[error("{0} of its straight stretches have a wheel distance, {ENOUGH} are wanted")]
    TooFewStretches(usize),
}

impl TicksError {
    /// What to do about it.
    #[must_use]
    pub const fn fix(&self) -> &'static str {
        match self {
            Self::TooFewCounts(_) => {
                "drive farther, 50 m or more, and log the whole way; check message and signals with `freespace eval wheels`"
            }
            Self::TooFewStretches(_) => {
                "see that log and pictures are of the same drive: time_offset_s in [wheels] brings their clocks together"
            }
        }
    }
}

/// Distances over time as an odometer has them.
#[derive(Clone, Debug, Default)]
pub struct Travelled(Vec<(Micros, f64)>);

impl Travelled {
    /// Rolls `readings` through an odometer.
    #[must_use]
    pub fn new(readings: &[WheelReading], config: &WheelConfig) -> Self {
        let mut odometer = WheelOdometer::new(*config);
        let mut rows = Vec::with_capacity(readings.len());
        for reading in readings {
            odometer.push(*reading);
            let row = odometer
                .newest()
                .and_then(|stamp| Some((stamp, odometer.travel_at(stamp)?.distance_m)));
            rows.extend(row.filter(|(stamp, _)| rows.last().is_none_or(|(last, _)| last < stamp)));
        }
        Self(rows)
    }

    /// Distance since the first reading; none before it, after the last one, and in a gap longer than `gap_micros`.
    #[must_use]
    pub fn at(&self, stamp: Micros, gap_micros: u64) -> Option<f64> {
        let after = self.0.partition_point(|(row, _)| *row < stamp);
        let (late, late_m) = *self.0.get(after)?;
        if late == stamp {
            return Some(late_m);
        }
        let (early, early_m) = *self.0.get(after.checked_sub(1)?)?;
        let share = stamp.seconds_since(early) / late.seconds_since(early);
        (late.since(early) <= gap_micros).then_some(early_m + share * (late_m - early_m))
    }

    /// Distance of the whole log.
    #[must_use]
    pub fn total_m(&self) -> f64 {
        self.0.last().map_or(0.0, |(_, metres)| *metres)
    }
}

/// Readings as if every wheel were `wheel`.
fn alone(readings: &[WheelReading], wheel: usize) -> Vec<WheelReading> {
    (readings.iter())
        .map(|reading| match *reading {
            WheelReading::Counts {
                stamp,
                counts,
                direction,
            } => WheelReading::Counts {
                stamp,
                counts: [counts[wheel]; 4],
                direction: [direction[wheel]; 4],
            },
            WheelReading::Speeds { stamp, mps } => WheelReading::Speeds {
                stamp,
                mps: [mps[wheel]; 4],
            },
        })
        .collect()
}

/// Metres a count from a distance that is known, over the whole log.
///
/// # Errors
/// [`TicksError::TooFewCounts`].
pub fn from_distance(
    readings: &[WheelReading],
    config: &WheelConfig,
    distance_m: f64,
) -> Result<Ticks, TicksError> {
    let counts = wheel_counts(readings, config);
    let rolled = rolled(readings, config)?;
    // Rounding at both ends, and how far the rear wheels are from one another.
    let rear = [counts[2], counts[3]];
    let sigma = (0.5 / rolled).hypot(0.5 * (rear[0] - rear[1]) / (rear[0] + rear[1]));
    Ok(Ticks {
        metres_per_count: distance_m / rolled,
        sigma: if sigma.is_finite() { sigma } else { 1.0 },
        stretches: None,
        counts,
        left_over_right: left_over_right(&counts),
    })
}

/// Metres a count from stretches whose visual length is metric.
///
/// # Errors
/// [`TicksError`].
pub fn from_stretches(
    readings: &[WheelReading],
    config: &WheelConfig,
    stretches: &[Stretch],
) -> Result<Ticks, TicksError> {
    let counts = wheel_counts(readings, config);
    rolled(readings, config)?;
    let travelled = Travelled::new(readings, config);
    let ratios = robust(stretches.iter().filter_map(|stretch| {
        let gap = config.timeout_micros;
        let wheel_m = travelled.at(stretch.stamps.1, gap)? - travelled.at(stretch.stamps.0, gap)?;
        (wheel_m > 2.0 * config.metres_per_count).then(|| stretch.travel.norm() / wheel_m)
    }));
    let ratios = ratios
        .filter(|ratios| ratios.count >= ENOUGH)
        .ok_or(TicksError::TooFewStretches(
            ratios.map_or(0, |ratios| ratios.count),
        ))?;
    Ok(Ticks {
        metres_per_count: config.metres_per_count * ratios.value,
        sigma: ratios.sigma / ratios.value,
        stretches: Some(ratios),
        counts,
        left_over_right: left_over_right(&counts),
    })
}

/// Counts of the rear axle's centre.
fn rolled(readings: &[WheelReading], config: &WheelConfig) -> Result<f64, TicksError> {
    let rolled = Travelled::new(readings, config).total_m().abs() / config.metres_per_count;
    if rolled >= LEAST_COUNTS {
        Ok(rolled)
    } else {
        Err(TicksError::TooFewCounts(rolled))
    }
}

fn wheel_counts(readings: &[WheelReading], config: &WheelConfig) -> [f64; 4] {
    std::array::from_fn(|wheel| {
        Travelled::new(&alone(readings, wheel), config).total_m() / config.metres_per_count
    })
}

fn left_over_right(counts: &[f64; 4]) -> [f64; 2] {
    [counts[0] / counts[1] - 1.0, counts[2] / counts[3] - 1.0]
}

impl Ticks {
    /// Wheels that do not roll like the others.
    #[must_use]
    pub fn odd_wheels(&self) -> Vec<&'static str> {
        let Some(common) = robust(self.counts) else {
            return Vec::new();
        };
        (WHEELS.into_iter().zip(self.counts))
            .filter(|(_, counts)| !((counts / common.value - 1.0).abs() <= ODD_WHEEL))
            .map(|(name, _)| name)
            .collect()
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
    use freespace::health::ScaleState;
    use nalgebra::Vector3;

    use super::*;

    const TRUE_METRES: f64 = 0.0215;
    const CONFIG: WheelConfig = WheelConfig {
        metres_per_count: 0.019,
        modulus: 256,
        track_m: 1.54,
        timeout_micros: 200_000,
    };

    /// A minute at 10 m/s, the left wheels 1 % smaller than the right ones.
    fn readings(seconds: u64) -> Vec<WheelReading> {
        (0..seconds * 50)
            .map(|i| {
                let metres = i as f64 * 0.2;
                let count = |share: f64| ((metres * share / TRUE_METRES).floor() as u64 % 256) as u32;
                WheelReading::Counts {
                    stamp: Micros(i * 20_000),
                    counts: [count(1.005), count(0.995), count(1.005), count(0.995)],
                    direction: [1; 4],
                }
            })
            .collect()
    }

    #[test]
    fn a_known_distance_gives_the_metres_a_count_and_the_imbalance() {
        let ticks = from_distance(&readings(60), &CONFIG, 599.8).unwrap();
        assert!(
            (ticks.metres_per_count / TRUE_METRES - 1.0).abs() < 1e-3,
            "{ticks:?}"
        );
        assert!((ticks.left_over_right[1] - 0.01).abs() < 5e-4, "{ticks:?}");
        assert!(ticks.odd_wheels().is_empty());
        assert!(matches!(
            from_distance(&readings(0), &CONFIG, 10.0),
            Err(TicksError::TooFewCounts(_))
        ));
    }

    #[test]
    fn stretches_give_it_too_and_a_stuck_wheel_is_named() {
        let stretch = |i: u64| Stretch {
            stamps: (Micros(i * 500_000 + 30_000), Micros(i * 500_000 + 430_000)),
            travel: Vector3::new(0.0, 0.0, if i.is_multiple_of(5) { 7.0 } else { 4.0 }),
            turn_rad: 0.0,
            wheel_m: None,
            plane: None,
            scale: ScaleState::CameraHeight,
        };
        let stretches: Vec<Stretch> = (0..100).map(stretch).collect();
        let mut readings = readings(60);
        for reading in &mut readings {
            if let WheelReading::Counts { counts, .. } = reading {
                counts[0] = 7;
            }
        }
        let ticks = from_stretches(&readings, &CONFIG, &stretches).unwrap();
        assert!(
            (ticks.metres_per_count / TRUE_METRES - 1.0).abs() < 5e-3,
            "{ticks:?}"
        );
        assert_eq!(ticks.odd_wheels(), ["front_left"]);
        let elsewhere: Vec<Stretch> = (1000..1100).map(stretch).collect();
        assert_eq!(
            from_stretches(&readings, &CONFIG, &elsewhere),
            Err(TicksError::TooFewStretches(0))
        );
    }
}
