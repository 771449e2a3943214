//! The shipped systemd units keep what the runtime is built on, and are started with the computer.
#![allow(clippy::unwrap_used, reason = "tests")]

use freespace::budget::{DEADLINE_MICROS, HANG_MICROS};

use crate::runtime::live::LAST_WORD;
use crate::runtime::rights::{Policy, ThreadRole};

const UNIT: &str = include_str!("../../../../config/freespace.service");
const MONITOR_UNIT: &str = include_str!("../../../../config/freespace-monitor.service");

/// The values of a key, in their order.
fn all(key: &str) -> Vec<&'static str> {
    UNIT.lines()
        .filter_map(|line| line.split_once('='))
        .filter(|(name, _)| *name == key)
        .map(|(_, value)| value)
        .collect()
}

fn one(key: &str) -> &'static str {
    let values = all(key);
    assert_eq!(values.len(), 1, "{key}: {values:?}");
    values[0]
}

#[test]
fn it_has_the_two_rights_that_the_runtime_asks_for_and_no_other() {
    assert_eq!(one("AmbientCapabilities"), "CAP_SYS_NICE CAP_IPC_LOCK");
    assert_eq!(one("CapabilityBoundingSet"), one("AmbientCapabilities"));
    for (key, value) in [
        ("NoNewPrivileges", "yes"),
        ("ProtectSystem", "strict"),
        ("PrivateTmp", "yes"),
        ("DevicePolicy", "closed"),
        ("RestrictAddressFamilies", "AF_UNIX AF_CAN"),
    ] {
        assert_eq!(one(key), value, "{key}");
    }
    // Either would take the rights away again.
    assert!(all("RestrictRealtime").is_empty() && all("PrivateUsers").is_empty());
}

#[test]
fn what_it_runs_is_what_its_recipe_installs() {
    let environment = all("Environment").join("\n");
    for path in [
        "/etc/freespace/car.toml",
        "/usr/share/freespace/libonnxruntime.so",
    ] {
        assert!(environment.contains(path), "{path}");
    }
    for installed in [
        "/usr/bin/freespace",
        "/etc/freespace config/car.toml config/wheels_counters.dbc",
        "/usr/share/freespace/libonnxruntime.so",
        "/usr/share/freespace/models models/road.toml models/road.onnx",
    ] {
        assert!(UNIT.contains(installed), "{installed}");
    }
    assert_eq!(one("RestartPreventExitStatus"), "2");
}

#[test]
fn both_units_can_be_enabled_and_are_started_with_the_computer() {
    for unit in [UNIT, MONITOR_UNIT] {
        let recipe = "systemctl daemon-reload && systemctl enable --now freespace";
        assert!(unit.contains(recipe));
        let (_, install) = unit.split_once("\n[Install]\n").unwrap();
        assert_eq!(install.trim(), "WantedBy=multi-user.target");
    }
}

#[test]
fn its_limits_leave_room_for_the_default_priorities() {
    let limit: u8 = one("LimitRTPRIO").parse().unwrap();
    for role in ThreadRole::ALL {
        if let Policy::Fifo(priority) | Policy::RoundRobin(priority) = role.default_settings().policy {
            assert!(priority <= limit, "{role:?}");
        }
    }
    assert!(!one("LimitMEMLOCK").is_empty());
}

#[test]
fn its_watchdog_waits_for_several_answers_and_it_is_started_again() {
    assert_eq!((one("Type"), one("Restart")), ("notify", "always"));
    let watchdog_s: u64 = one("WatchdogSec").parse().unwrap();
    let last_word_micros = u64::try_from(LAST_WORD.as_micros()).unwrap();
    assert!(watchdog_s * 1_000_000 > HANG_MICROS + last_word_micros + DEADLINE_MICROS);
}
