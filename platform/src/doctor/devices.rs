//! Devices: CAN interfaces, cameras, shared memory.

use std::process::Command;

use super::{Check, System};
use crate::config::Sharing;

/// `ARPHRD_CAN` of linux/if_arp.h.
pub(super) const CAN_DEVICE: i64 = 280;

/// Frames that must fit into a transmit queue: all of one publication, of several in a row.
const QUEUE_FRAMES: i64 = 256;

/// CAN interfaces, a check for all of them. `bitrate` asks for that of an interface.
#[must_use]
pub fn can(system: &System, bitrate: impl Fn(&str) -> Option<u64>) -> Check {
    const NAME: &str = "CAN";
    let net = "sys/class/net";
    let interfaces: Vec<String> = (system.list(net).into_iter())
        .filter(|name| system.number(&format!("{net}/{name}/type")) == Some(CAN_DEVICE))
        .collect();
    if interfaces.is_empty() {
        return Check::warning(
            NAME,
            "no CAN interface",
            "plug the adapter in and load its driver; for a trial: \
             modprobe vcan && ip link add vcan0 type vcan && ip link set vcan0 up",
        );
    }
    let mut seen = Vec::new();
    let mut fixes = Vec::new();
    for name in &interfaces {
        let length = system.number(&format!("{net}/{name}/tx_queue_len")).unwrap_or(0);
        let is_up = is_up(system, name);
        let is_virtual = name.starts_with('v');
        let rate = bitrate(name);
        let rate_text = match rate {
            Some(rate) => format!("{} kbit/s", rate / 1000),
            None if is_virtual => "virtual".to_owned(),
            None => "bit rate unknown".to_owned(),
        };
        let up = if is_up { "up" } else { "down" };
        seen.push(format!(
            "{name} {up}, {rate_text}, transmit queue {length} frames"
        ));
        if !is_up {
            let rate = if is_virtual {
                ""
            } else {
                " type can bitrate 500000"
            };
            fixes.push(format!("ip link set {name} up{rate}"));
        }
        if length < QUEUE_FRAMES {
            fixes.push(format!(
                "ip link set {name} txqueuelen 1000 (a short queue answers ENOBUFS)"
            ));
        }
    }
    match fixes.as_slice() {
        [] => Check::ok(NAME, seen.join("; ")),
        fixes => Check::warning(NAME, seen.join("; "), fixes.join("; ")),
    }
}

/// IFF_UP of linux/if.h; vcan never reports more than "unknown" as its operational state.
pub(super) fn is_up(system: &System, interface: &str) -> bool {
    (system.read(&format!("sys/class/net/{interface}/flags")))
        .and_then(|flags| u32::from_str_radix(flags.trim().trim_start_matches("0x"), 16).ok())
        .is_some_and(|flags| flags & 1 == 1)
}

/// The bit rate of an interface, by the program `ip`; none where it is not installed or the interface has none.
#[must_use]
pub fn bitrate_by_ip(interface: &str) -> Option<u64> {
    let output = (Command::new("ip").args(["-json", "-details", "link", "show", "dev", interface]))
        .output()
        .ok()?;
    let links: serde_json::Value = serde_json::from_slice(&output.stdout).ok()?;
    links.pointer("/0/linkinfo/info_data/bittiming/bitrate")?.as_u64()
}

/// Cameras.
#[must_use]
pub fn camera(system: &System) -> Check {
    const NAME: &str = "camera";
    let class = "sys/class/video4linux";
    let devices = system.list(class);
    if devices.is_empty() {
        return Check::warning(
            NAME,
            "no camera device (/dev/video*)",
            "plug the camera in and load its driver; recordings and the demo need none",
        );
    }
    let seen: Vec<String> = (devices.iter())
        .map(|device| {
            let name = system.read(&format!("{class}/{device}/name")).unwrap_or_default();
            format!("/dev/{device} {name}").trim_end().to_owned()
        })
        .collect();
    let seen = seen.join("; ");
    let hidden: Vec<String> = (devices.iter())
        .filter(|device| !system.path(&format!("dev/{device}")).exists())
        .map(|device| format!("/dev/{device}"))
        .collect();
    if !hidden.is_empty() {
        return Check::warning(
            NAME,
            format!("{seen}; {} cannot be seen from here", hidden.join(", ")),
            "let the unit or the container have it: DeviceAllow=char-video4linux rw, or --device",
        );
    }
    // The USB driver alone lets its clock be chosen; the others stamp by CLOCK_MONOTONIC.
    match system.read("sys/module/uvcvideo/parameters/clock") {
        Some(clock) if !clock.contains("MONOTONIC") => Check::warning(
            NAME,
            format!("{seen}; USB cameras stamp by {clock}"),
            "echo CLOCK_MONOTONIC > /sys/module/uvcvideo/parameters/clock (module option uvcvideo clock=CLOCK_MONOTONIC)",
        ),
        Some(_) => Check::ok(NAME, format!("{seen}; stamps by CLOCK_MONOTONIC")),
        None => Check::ok(NAME, seen),
    }
}

/// Room for shared memory that readers map.
#[must_use]
pub fn shared_memory(system: &System, sharing: &Sharing) -> Check {
    const NAME: &str = "shared memory";
    let wanted_mb = match sharing {
        Sharing::Off => return Check::ok(NAME, "switched off"),
        Sharing::Wanted(config) | Sharing::Required(config) => config.bytes().div_ceil(1_000_000),
    };
    let Ok(room) = rustix::fs::statvfs(system.path("dev/shm").as_path()) else {
        return Check::warning(
            NAME,
            "no /dev/shm: the grid cannot be shared with readers",
            "mount -t tmpfs -o size=64m tmpfs /dev/shm",
        );
    };
    let free_mb = room.f_bavail.saturating_mul(room.f_frsize) / 1_000_000;
    let seen = format!("{free_mb} MB free in /dev/shm, a run takes {wanted_mb} MB");
    if free_mb >= wanted_mb {
        return Check::ok(NAME, seen);
    }
    Check::warning(
        NAME,
        seen,
        "mount -o remount,size=64m /dev/shm (docker: --shm-size=64m), or lower max_readers in [shared_memory]",
    )
}
