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
