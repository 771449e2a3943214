//! What every wheel port keeps to.

use std::fs;
use std::sync::Arc;

use freespace::port::WheelPort;
use freespace::space::Micros;
use freespace::track::WheelReading;
use freespace_platform::can;
use freespace_platform::wheels::{CandumpOptions, CandumpWheels};
use socketcan::{CanDataFrame, CanSocket, EmbeddedFrame as _, Socket as _, StandardId};

use super::rig::{decoder, interface, plan, wait_for, wheel_bytes};

/// Order, `until` respected, nothing twice, and an end to each call.
fn conforms(name: &str, port: &mut dyn WheelPort, from: Micros, to: Micros) -> Vec<WheelReading> {
    let mut all: Vec<WheelReading> = Vec::new();
    let mut until = from;
    while until < to {
        let mut calls = 0;
        port.readings_until(until, &mut |reading| {
            calls += 1;
            assert!(reading.stamp() <= until, "{name}: a reading after {until:?}");
            all.push(reading);
        });
        assert!(calls <= 2048, "{name}: a call without an end");
        let mut twice = 0;
        port.readings_until(until, &mut |_| twice += 1);
        assert_eq!(twice, 0, "{name}: given out twice");
        until = until.plus(30_000);
    }
    assert!(!all.is_empty(), "{name}: no readings");
    assert!(all.is_sorted_by_key(WheelReading::stamp), "{name}: out of order");
    all
}

#[test]
fn wheels_of_a_log() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("wheels.candump");
    let lines: String = (0..200_u64)
        .map(|number| {
            let hex: String = wheel_bytes(number)
                .iter()
                .map(|byte| format!("{byte:02X}"))
                .collect();
            format!(
                "({:.6}) can0 387#{hex}\n",
                10.0 + 0.01 * f64::from(u32::try_from(number).unwrap())
            )
        })
        .collect();
    fs::write(&log, &lines).unwrap();
    let mut port = CandumpWheels::open(&log, &decoder(), &CandumpOptions::default()).unwrap();
    let all = conforms("candump", &mut port, Micros(9_900_000), Micros(12_100_000));
    assert_eq!(all.len(), 200);

    // The same checks as on the bus: a damaged message, one that comes twice, and a leap.
    let mut spoilt: Vec<&str> = lines.lines().collect();
    let damaged = spoilt[50].replace("387#3", "387#4");
    spoilt[50] = &damaged;
    let twice = spoilt[100];
    spoilt.insert(100, twice);
    spoilt.drain(150..157);
    fs::write(&log, spoilt.join("\n")).unwrap();
    let port = CandumpWheels::open(&log, &decoder(), &CandumpOptions::default()).unwrap();
    let summary = port.summary();
    assert_eq!(
        (summary.checksum, summary.counter_stuck, summary.counter_jumped),
        (1, 1, 1),
        "{summary:?}"
    );
}

#[test]
fn wheels_of_the_simulated_road() {
    use freespace_platform::world::{Encoders, Textures, World, WorldConfig};
    let world = Arc::new(World::new(&WorldConfig::default(), &Arc::new(Textures::new())));
    let mut port = freespace_platform::wheels::SimEncoders::new(world, &Encoders::default());
    let _ = conforms("sim", &mut port, Micros(0), Micros(3_000_000));
}

#[test]
fn wheels_of_an_interface() {
    let Some(name) = interface("wheels_of_an_interface") else {
        return;
    };
    let mut devices = can::open(plan(&name)).unwrap();
    let mut port = devices.wheels.take().unwrap();
    wait_for("opening", || devices.watch.counts().opened > 0);
    let socket = CanSocket::open(&name).unwrap();
    let begin = monotonic();
    for number in 0..300_u64 {
        let id = StandardId::new(0x387).unwrap();
        socket
            .write_frame(&CanDataFrame::new(id, &wheel_bytes(number)).unwrap())
            .unwrap();
        let other = StandardId::new(0x100).unwrap();
        socket
            .write_frame(&CanDataFrame::new(other, &[0; 8]).unwrap())
            .unwrap();
        if number % 10 == 9 {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    }
    wait_for("receipt", || devices.watch.counts().readings == 300);
    let end = monotonic();
    let all = conforms("socketcan", &mut *port, begin, end.plus(60_000));
    assert_eq!(all.len(), 300);
    assert!(all.iter().all(|reading| (begin..=end).contains(&reading.stamp())));
    let counts = devices.watch.counts();
    assert_eq!(
        counts.received, 300,
        "the kernel keeps other messages away: {counts:?}"
    );
    assert_eq!((counts.refused(), counts.allocations), (0, 0), "{counts:?}");
    assert!(
        counts.stamped_by_software + counts.stamped_by_hardware >= 290,
        "{counts:?}"
    );
}

fn monotonic() -> Micros {
    use freespace::port::Clock as _;
    freespace_platform::clock::MonotonicClock::of_devices().now()
}
