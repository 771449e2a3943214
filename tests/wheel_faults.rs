//! Wheels that slip or stick, in a short simulated drive on one thread: the messages say so while it lasts.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod simulated;

use std::ops::Range;

use freespace::health::{Faults, QualityLevel};
use freespace::port::WheelPort;
use freespace::space::Micros;
use freespace::track::WheelReading;
use freespace_platform::runtime::{FrameReport, KeyFrameReport, Observer, run_in_lockstep};
use simulated::Triangle;

const SECONDS: f64 = 8.0;
const FAULT: Range<u64> = 4_000_000..6_000_000;

/// Wheels whose counters gain or lose a share of what they count.
struct Tampered {
    inner: Box<dyn WheelPort + Send>,
    wheels: Range<usize>,
    share: f64,
    last: Option<[u32; 4]>,
    extra: [f64; 4],
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a counter of 8 bits"
)]
impl Tampered {
    fn tamper(&mut self, stamp: Micros, counts: &mut [u32; 4]) {
        let last = self.last.replace(*counts).unwrap_or(*counts);
        for wheel in 0..4 {
            let counted = (counts[wheel] + 256 - last[wheel]) % 256;
            if FAULT.contains(&stamp.0) && self.wheels.contains(&wheel) {
                self.extra[wheel] += self.share * f64::from(counted);
            }
            let shown = f64::from(counts[wheel]) + self.extra[wheel].round();
            counts[wheel] = shown.rem_euclid(256.0) as u32;
        }
    }
}

impl WheelPort for Tampered {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        let mut readings = Vec::new();
        self.inner
            .readings_until(until, &mut |reading| readings.push(reading));
        for mut reading in readings {
            if let WheelReading::Counts { stamp, counts, .. } = &mut reading {
                self.tamper(*stamp, counts);
            }
            take(reading);
        }
    }
}

/// Stamp, level and faults of every message.
#[derive(Default)]
struct Log(Vec<(Micros, QualityLevel, Faults)>);

impl Log {
    fn says(&self, faults: Faults, within: Range<u64>) -> bool {
        let mut said = self.0.iter().filter(|(stamp, ..)| within.contains(&stamp.0));
        said.any(|(.., said)| said.contains(faults))
    }
}

impl Observer for Log {
    fn frame(&mut self, _report: &FrameReport) {}

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        let output = report.output;
        self.0.push((output.stamp, output.level, output.faults));
    }
}

fn drive(wheels: Range<usize>, share: f64) -> Log {
    let (camera, frames, inner) = simulated::devices(SECONDS);
    let tampered = Tampered {
        inner,
        wheels,
        share,
        last: None,
        extra: [0.0; 4],
    };
    let setup = simulated::setup(camera, frames, Some(Box::new(tampered)), Triangle::new(0..0));
    let mut log = Log::default();
    run_in_lockstep(setup, &mut log);
    log
}

#[test]
fn sound_wheels_are_not_said_to_slip() {
    let log = drive(0..0, 0.0);
    assert!(!log.says(Faults::WHEELS_SLIP, 0..u64::MAX), "{:?}", log.0);
}

#[test]
fn one_stuck_wheel_is_told_by_the_other_three() {
    let log = drive(2..3, -1.0);
    assert!(log.says(Faults::WHEELS_SLIP, FAULT), "{:?}", log.0);
    assert!(!log.says(Faults::WHEELS_SLIP, 0..FAULT.start), "{:?}", log.0);
    assert!(
        !log.says(Faults::WHEELS_SLIP, FAULT.end + 1_500_000..u64::MAX),
        "{:?}",
        log.0
    );
}

#[test]
fn wheels_that_slip_together_are_told_by_the_picture() {
    let log = drive(0..4, 0.35);
    assert!(
        log.says(Faults::WHEELS_SLIP | Faults::SCALE_HELD, FAULT),
        "{:?}",
        log.0
    );
    assert!(!log.says(Faults::WHEELS_SLIP, 0..FAULT.start), "{:?}", log.0);
    let is_honest = |(_, level, faults): &(Micros, QualityLevel, Faults)| {
        *level != QualityLevel::Full || faults.is_empty()
    };
    assert!(log.0.iter().all(is_honest), "{:?}", log.0);
}
