#![allow(clippy::unwrap_used, reason = "tests")]

use std::fs;
use std::path::Path;

use super::*;
use crate::config::Sharing;
use crate::runtime::rights::{Cpus, RealTimeConfig, ThreadRole};
use crate::sink::shared_memory::SharingConfig;

/// A computer of these files.
fn computer(files: &[(&str, &str)]) -> (tempfile::TempDir, System) {
    let folder = tempfile::tempdir().unwrap();
    for (file, text) in files {
        let path = folder.path().join(file);
        fs::create_dir_all(path.parent().unwrap_or(Path::new(""))).unwrap();
        fs::write(path, text).unwrap();
    }
    let system = System::at(folder.path());
    (folder, system)
}

fn verdict(check: &Check) -> (State, &str) {
    assert_eq!(check.fix.is_none(), check.state == State::Ok, "{check:?}");
    (check.state, &check.seen)
}

#[test]
fn the_kernels_preemption_is_read() {
    let of = |version| {
        let (_folder, system) = computer(&[
            ("proc/sys/kernel/osrelease", "6.12.5\n"),
            ("proc/sys/kernel/version", version),
        ]);
        kernel(&system)
    };
    let check = of("#1 SMP PREEMPT_RT Debian 6.12.5-1");
    assert_eq!(verdict(&check), (State::Ok, "Linux 6.12.5, PREEMPT_RT"));
    assert_eq!(of("#1 SMP PREEMPT_DYNAMIC").state, State::Ok);
    assert_eq!(of("#1 SMP").state, State::Warning);
}

#[test]
fn the_share_of_real_time_threads_is_told() {
    let of = |runtime| {
        let (_folder, system) = computer(&[
            ("proc/sys/kernel/sched_rt_runtime_us", runtime),
            ("proc/sys/kernel/sched_rt_period_us", "1000000\n"),
        ]);
        throttling(&system)
    };
    let check = of("950000\n");
    let (state, seen) = verdict(&check);
    assert_eq!(state, State::Ok);
    assert!(
        seen.starts_with("95 % of a core") && seen.contains("stopped for 50 ms"),
        "{seen}"
    );
    assert_eq!(of("-1").state, State::Ok);
    assert_eq!(of("500000").state, State::Warning);
    assert_eq!(of("0").state, State::Fails);
}

#[test]
fn pages_that_may_move_are_told() {
    let of = |modes| {
        let (_folder, system) = computer(&[("sys/kernel/mm/transparent_hugepage/enabled", modes)]);
        huge_pages(&system)
    };
    assert_eq!(of("[always] madvise never").state, State::Warning);
    let check = of("always [madvise] never");
    assert_eq!(verdict(&check), (State::Ok, "transparent huge pages: madvise"));
    let (_folder, system) = computer(&[(
        "proc/swaps",
        "Filename Type Size Used Priority\n/dev/sda3 partition 976 0 -2\n",
    )]);
    assert_eq!(swap(&system, true).state, State::Ok);
    assert!(verdict(&swap(&system, false)).1.contains("/dev/sda3"));
    assert_eq!(swap(&System::at(Path::new("/nowhere")), false).state, State::Ok);
}

#[test]
fn a_slow_clock_is_told() {
    let cpu = "sys/devices/system/cpu/cpu0/cpufreq";
    let of = |governor_name| {
        let (_folder, system) = computer(&[
            (&format!("{cpu}/scaling_governor"), governor_name),
            (&format!("{cpu}/scaling_cur_freq"), "800000\n"),
            (&format!("{cpu}/cpuinfo_max_freq"), "3200000\n"),
        ]);
        governor(&system)
    };
    let check = of("powersave\n");
    let (state, seen) = verdict(&check);
    assert_eq!(state, State::Warning);
    assert!(seen.starts_with("governor powersave, 800 of 3200 MHz"), "{seen}");
    assert_eq!(of("performance\n").state, State::Ok);
    let (_folder, system) = computer(&[("proc/cpuinfo", "processor : 0\ncpu MHz\t\t: 2000.0\n")]);
    assert_eq!(
        verdict(&governor(&system)),
        (State::Ok, "2000.0 MHz, not scaled by this kernel")
    );
}

#[test]
fn cores_that_are_shared_or_missing_are_told() {
    let cpus = "sys/devices/system/cpu";
    let (_folder, system) = computer(&[
        (&format!("{cpus}/online"), "0-3\n"),
        (&format!("{cpus}/isolated"), "2-3\n"),
    ]);
    let of = |set| {
        let mut config = RealTimeConfig::default();
        config.threads[ThreadRole::Frame as usize].cpus = Cpus(set);
        interrupts(&system, &config)
    };
    assert_eq!(of(0).state, State::Ok);
    assert_eq!(of(0b1100).state, State::Ok);
    let check = of(0b0110);
    assert_eq!(check.state, State::Warning);
    assert!(check.fix.unwrap().contains("isolcpus=1,2"));
    let check = of(1 << 6);
    assert_eq!(
        verdict(&check),
        (State::Fails, "0-3 online, but threads are bound to 6")
    );
}

#[test]
fn a_short_can_queue_is_told() {
    let of = |name: &str, length: &str, flags: &str| {
        let net = format!("sys/class/net/{name}");
        let (_folder, system) = computer(&[
            ("sys/class/net/lo/type", "772\n"),
            (&format!("{net}/type"), "280\n"),
            (&format!("{net}/tx_queue_len"), length),
            (&format!("{net}/flags"), flags),
        ]);
        can(&system, |name| (name == "can0").then_some(500_000))
    };
    let check = of("can0", "10\n", "0x40081\n");
    assert_eq!(
        verdict(&check),
        (State::Warning, "can0 up, 500 kbit/s, transmit queue 10 frames")
    );
    assert!(check.fix.unwrap().contains("ip link set can0 txqueuelen 1000"));
    assert_eq!(of("can0", "1000\n", "0x40081\n").state, State::Ok);
    let check = of("vcan0", "1000\n", "0x80\n");
    assert_eq!(
        verdict(&check),
        (State::Warning, "vcan0 down, virtual, transmit queue 1000 frames")
    );
    let (_folder, none) = computer(&[("sys/class/net/lo/type", "772\n")]);
    assert_eq!(
        verdict(&can(&none, |_| None)),
        (State::Warning, "no CAN interface")
    );
}

#[test]
fn a_camera_that_stamps_by_the_wrong_clock_is_told() {
    let of = |clock: &str, node: &str| {
        let (_folder, system) = computer(&[
            ("sys/class/video4linux/video0/name", "HD Camera\n"),
            ("sys/module/uvcvideo/parameters/clock", clock),
            (node, ""),
        ]);
        camera(&system)
    };
    assert_eq!(of("CLOCK_MONOTONIC\n", "dev/video0").state, State::Ok);
    assert_eq!(of("CLOCK_REALTIME\n", "dev/video0").state, State::Warning);
    let check = of("CLOCK_MONOTONIC\n", "dev/null");
    assert_eq!(
        verdict(&check),
        (
            State::Warning,
            "/dev/video0 HD Camera; /dev/video0 cannot be seen from here"
        )
    );
    let (_folder, none) = computer(&[]);
    assert_eq!(camera(&none).state, State::Warning);
    assert_eq!(shared_memory(&none, &sharing(1)).state, State::Warning);
    let (_folder, room) = computer(&[("dev/shm/freespace", "")]);
    assert_eq!(shared_memory(&room, &sharing(1)).state, State::Ok);
    // More readers than any computer has room for.
    let check = shared_memory(&room, &sharing(usize::MAX >> 24));
    assert!(check.fix.unwrap().contains("max_readers"));
    assert_eq!(shared_memory(&none, &Sharing::Off).state, State::Ok);
}

fn sharing(max_readers: usize) -> Sharing {
    Sharing::Wanted(SharingConfig {
        max_readers,
        ..SharingConfig::default()
    })
}
