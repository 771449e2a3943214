//! The CAN interfaces of a configuration: each there, up, at its bit rate, with a queue, stamps and CAN FD as configured.
//!
//! In: `/sys/class/net`, what `ip` tells of the controller, the configuration. Out: a [`Check`] an interface.

use super::devices::{CAN_DEVICE, is_up};
use super::{Check, State, System};
use crate::config::{Config, Wheels};

const NAME: &str = "CAN interface";
/// Maximum transfer unit of an interface that takes CAN FD frames: CANFD_MTU of linux/can.h.
const FD_MTU: i64 = 72;
/// Shortest transmit queue that a paced publication fits into beside the frames of another sender.
const QUEUE_FRAMES: i64 = 10;

/// What the configuration asks of an interface.
struct Wanted {
    name: String,
    is_sent_to: bool,
    fd: bool,
    bit_rate: u32,
}

/// A check for each configured interface; none where the configuration names none. `bitrate` asks for that of an interface,
/// `stamps` whether its adapter stamps frames.
#[must_use]
pub fn can_interfaces(
    system: &System,
    config: &Config,
    bitrate: impl Fn(&str) -> Option<u64>,
    stamps: impl Fn(&str) -> Option<bool>,
) -> Vec<Check> {
    (wanted(config).iter())
        .map(|wanted| check(system, wanted, bitrate(&wanted.name), stamps(&wanted.name)))
        .collect()
}

fn wanted(config: &Config) -> Vec<Wanted> {
    let out = config.can_out();
    let bit_rate = out.as_ref().map_or(0, |out| out.rates.nominal);
    let of = |name: String, is_sent_to| Wanted {
        name,
        is_sent_to,
        fd: config.can.fd,
        bit_rate,
    };
    let mut all: Vec<Wanted> = (out.and_then(|out| out.interface).into_iter())
        .map(|name| of(name, true))
        .collect();
    if let Wheels::Can(wheels) = config.wheels()
        && let Some(name) = wheels.interface
        && all.iter().all(|other| other.name != name)
    {
        all.push(of(name, false));
    }
    all
}

fn check(system: &System, wanted: &Wanted, bit_rate: Option<u64>, stamps: Option<bool>) -> Check {
    let name = &wanted.name;
    let number = |file: &str| system.number(&format!("sys/class/net/{name}/{file}"));
    match number("type") {
        Some(CAN_DEVICE) => {}
        Some(_) => {
            return Check::fails(
                NAME,
                format!("{name} is no CAN interface"),
                "name one that `ip link show type can` lists, in [can] or [wheels]",
            );
        }
        None => {
            return Check::fails(
                NAME,
                format!("{name} is not there"),
                format!(
                    "plug the adapter in and load its driver; for a trial: \
                     modprobe vcan && ip link add {name} type vcan && ip link set {name} up"
                ),
            );
        }
    }
    let mut seen = vec![name.clone()];
    let mut fixes = Vec::new();
    let mut state = State::Ok;
    let rate = bit_rate.map_or_else(
        || "bit rate not told".to_owned(),
        |rate| format!("{} kbit/s", rate / 1000),
    );
    if is_up(system, name) {
        seen.push(format!("up, {rate}"));
    } else {
        state = State::Fails;
        seen.push("down".to_owned());
        let kind = if name.starts_with('v') {
            String::new()
        } else {
            format!(" type can bitrate {} restart-ms 100", wanted.bit_rate)
        };
        fixes.push(format!("ip link set {name} up{kind}"));
    }
    if let Some(rate) = bit_rate.filter(|rate| *rate != u64::from(wanted.bit_rate)) {
        state = state.max(State::Warning);
        seen.push(format!("[can] bit_rate says {} kbit/s", wanted.bit_rate / 1000));
        fixes.push(format!("set bit_rate = {rate} in [can], or the interface's"));
    }
    if wanted.is_sent_to {
        let length = number("tx_queue_len").unwrap_or(0);
        seen.push(format!("transmit queue {length} frames"));
        if length < QUEUE_FRAMES {
            state = state.max(State::Warning);
            fixes.push(format!("ip link set {name} txqueuelen 100"));
        }
    }
    if wanted.fd {
        let mtu = number("mtu").unwrap_or(0);
        let takes_fd = mtu >= FD_MTU;
        seen.push(if takes_fd { "CAN FD" } else { "classic CAN only" }.to_owned());
        if !takes_fd {
            state = state.max(State::Fails);
            // Before the one that brings it up.
            fixes.insert(
                0,
                format!("ip link set {name} down, then mtu 72 (vcan) or type can fd on dbitrate N; or fd = false in [can]"),
            );
        }
    }
    // Kernel stamps are good to the interrupt's delay: no more than told.
    seen.push(match stamps {
        Some(true) => "stamped by the adapter".to_owned(),
        Some(false) => "stamped by the kernel".to_owned(),
        None => "stamps not told".to_owned(),
    });
    Check {
        name: NAME,
        state,
        seen: seen.join(", "),
        fix: (!fixes.is_empty()).then(|| fixes.join("; ")),
    }
}

/// Whether an interface's adapter stamps the frames it receives; none where it cannot be asked.
#[must_use]
pub fn can_stamps(interface: &str) -> Option<bool> {
    use socketcan::Socket as _;
    let socket = socketcan::CanSocket::open(interface).ok()?;
    Some(socket.has_hw_timestamps())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use std::fs;
    use std::path::Path;

    use super::*;

    fn checks(files: &[(&str, &str)], can: &str, rate: Option<u64>) -> Vec<Check> {
        let folder = tempfile::tempdir().unwrap();
        for (file, text) in files {
            let path = folder.path().join("sys/class/net").join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        let text = format!("{}\n{can}\n", include_str!("../../../config/demo.toml"));
        let config = Config::parse(Path::new("car.toml"), &text).unwrap();
        let system = System::at(folder.path());
        can_interfaces(&system, &config, |_| rate, |_| Some(false))
    }

    const GOOD: [(&str, &str); 4] = [
        ("can0/type", "280\n"),
        ("can0/flags", "0x40081\n"),
        ("can0/tx_queue_len", "10\n"),
        ("can0/mtu", "72\n"),
    ];

    #[test]
    fn a_good_interface_is_told_and_nothing_where_none_is_configured() {
        assert!(checks(&[], "", None).is_empty());
        let found = checks(&GOOD, "[can]\ninterface = \"can0\"\nfd = true", Some(500_000));
        assert_eq!(found[0].state, State::Ok, "{found:?}");
        assert_eq!(
            found[0].seen,
            "can0, up, 500 kbit/s, transmit queue 10 frames, CAN FD, stamped by the kernel"
        );
    }

    #[test]
    fn each_fault_of_an_interface_has_its_fix() {
        let with = |file: &str, text: &'static str| {
            GOOD.map(|(name, good)| (name, if name == file { text } else { good }))
        };
        let can = "[can]\ninterface = \"can0\"\nfd = true";
        for (files, rate, state, fix) in [
            (
                with("can0/flags", "0x40080\n"),
                None,
                State::Fails,
                "ip link set can0 up type can bitrate 500000",
            ),
            (
                with("can0/type", "1\n"),
                None,
                State::Fails,
                "ip link show type can",
            ),
            (
                with("can0/tx_queue_len", "2\n"),
                None,
                State::Warning,
                "txqueuelen",
            ),
            (with("can0/mtu", "16\n"), None, State::Fails, "mtu 72"),
            (GOOD, Some(250_000), State::Warning, "bit_rate = 250000"),
        ] {
            let found = checks(&files, can, rate);
            assert_eq!(found[0].state, state, "{found:?}");
            assert!(found[0].fix.as_ref().unwrap().contains(fix), "{found:?}");
        }
        let absent = checks(&[], can, None);
        assert!(absent[0].seen.contains("not there") && absent[0].state == State::Fails);
    }
}
