#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::{Arc, Mutex};
use std::time::Instant;

use super::*;
use crate::monitor::State;

/// A made-up `/sys/class`.
struct Computer(tempfile::TempDir);

impl Computer {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, path: &str, text: &str) {
        let path = self.0.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn zone(&self, number: usize, kind: &str, temp: &str) {
        self.file(
            &format!("thermal/thermal_zone{number}/type"),
            &format!("{kind}\n"),
        );
        self.file(
            &format!("thermal/thermal_zone{number}/temp"),
            &format!("{temp}\n"),
        );
    }

    fn read(&self) -> Temperatures {
        read(self.0.path(), Micros(5))
    }
}

fn shown(temperatures: &Temperatures) -> Vec<(&str, f64)> {
    let zones = temperatures.zones.iter();
    zones.map(|zone| (zone.name.as_str(), zone.celsius)).collect()
}

#[test]
fn zones_are_read_by_name_and_what_is_no_temperature_is_left_out() {
    let computer = Computer::new();
    computer.zone(0, "acpitz", "27800");
    computer.zone(1, "acpitz", "-5500");
    computer.zone(10, "x86_pkg_temp", "61000");
    computer.zone(2, "iwlwifi_1", "");
    computer.zone(3, "off", "-274000");
    computer.file("thermal/cooling_device0/type", "Processor\n");
    computer.file("thermal/thermal_zone4/temp", "40000\n");
    let found = computer.read();
    let wanted = [
        ("acpitz", 27.8),
        ("acpitz thermal_zone1", -5.5),
        ("thermal_zone4", 40.0),
        ("x86_pkg_temp", 61.0),
    ];
    assert_eq!(shown(&found), wanted);
    assert_eq!((found.unreadable, found.left_out, found.at), (2, 0, Micros(5)));
}

#[test]
fn sensors_without_a_zone_are_read_too_and_a_zone_is_not_shown_twice() {
    let computer = Computer::new();
    computer.zone(0, "acpitz", "27800");
    computer.file("hwmon/hwmon0/name", "acpitz\n");
    computer.file("hwmon/hwmon0/temp1_input", "27800\n");
    computer.file("hwmon/hwmon1/name", "k10temp\n");
    computer.file("hwmon/hwmon1/temp1_input", "54125\n");
    computer.file("hwmon/hwmon1/temp1_label", "Tctl\n");
    computer.file("hwmon/hwmon1/temp3_input", "48000\n");
    computer.file("hwmon/hwmon1/fan1_input", "900\n");
    let wanted = [
        ("acpitz", 27.8),
        ("k10temp Tctl", 54.125),
        ("k10temp temp3", 48.0),
    ];
    assert_eq!(shown(&computer.read()), wanted);
}

#[test]
fn a_computer_without_sensors_and_one_with_too_many_have_a_bound() {
    let computer = Computer::new();
    assert_eq!(
        computer.read(),
        Temperatures {
            at: Micros(5),
            ..Temperatures::default()
        }
    );
    for number in 0..MOST + 5 {
        computer.zone(number, &format!("zone {}", "x".repeat(200 + number)), "1000");
    }
    let found = computer.read();
    assert_eq!((found.zones.len(), found.left_out), (MOST, 5));
    // Names cut to the same text stay apart.
    let of_length = |zone: &Zone| zone.name.chars().count();
    assert!(found.zones.iter().all(|zone| of_length(zone) == LONGEST_NAME));
}

#[test]
fn a_sensor_keeps_its_name_while_another_of_its_type_cannot_be_read() {
    let computer = Computer::new();
    computer.zone(0, "acpitz", "27800");
    computer.zone(1, "acpitz", "31000");
    let both = [("acpitz", 27.8), ("acpitz thermal_zone1", 31.0)];
    assert_eq!(shown(&computer.read()), both);
    computer.zone(0, "acpitz", "");
    assert_eq!(shown(&computer.read()), both[1..]);
}

#[test]
fn the_thread_reads_at_once_and_ends_when_dropped() {
    let computer = Computer::new();
    computer.zone(0, "soc", "50000");
    let state = Arc::new(Mutex::new(State::new("freespace/grid")));
    let thermometer = measure(computer.0.path(), Arc::clone(&state)).unwrap();
    let begin = Instant::now();
    while lock(&state).temperatures.is_none() && begin.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(5));
    }
    drop(thermometer);
    let read = lock(&state).temperatures.clone().unwrap();
    assert_eq!(shown(&read), [("soc", 50.0)]);
    assert_eq!(Arc::strong_count(&state), 1);
}
