//! The kernel: how soon it lets a thread run, and what it may take away.

use super::{Check, System};

/// Version and preemption model.
#[must_use]
pub fn kernel(system: &System) -> Check {
    const NAME: &str = "kernel";
    let release = system.read("proc/sys/kernel/osrelease").unwrap_or_default();
    let version = system.read("proc/sys/kernel/version").unwrap_or_default();
    let is_real_time =
        version.contains("PREEMPT_RT") || system.read("sys/kernel/realtime").as_deref() == Some("1");
    if is_real_time {
        return Check::ok(NAME, format!("Linux {release}, PREEMPT_RT"));
    }
    if version.contains("PREEMPT") {
        return Check::ok(NAME, format!("Linux {release}, preemptible, not PREEMPT_RT"));
    }
    Check::warning(
        NAME,
        format!("Linux {release}, not preemptible: a long system call of any program delays the loop"),
        "boot a kernel built with PREEMPT_RT (Debian: linux-image-rt-amd64) or PREEMPT",
    )
}

/// How much of a core real-time threads may use.
#[must_use]
pub fn throttling(system: &System) -> Check {
    const NAME: &str = "real-time share";
    const RUNTIME: &str = "kernel.sched_rt_runtime_us";
    let runtime = system.number("proc/sys/kernel/sched_rt_runtime_us");
    let period = system.number("proc/sys/kernel/sched_rt_period_us");
    let (Some(runtime), Some(period)) = (runtime, period.filter(|period| *period > 0)) else {
        return Check::warning(
            NAME,
            "the kernel does not say how much of a core real-time threads may use",
            "mount /proc, or use a kernel with CONFIG_SYSCTL",
        );
    };
    if runtime < 0 {
        return Check::ok(
            NAME,
            "100 % of a core: a real-time thread that never waits takes its core for good",
        );
    }
    let percent = 100 * runtime / period;
    let stop_ms = (period - runtime) / 1000;
    let seen = format!(
        "{percent} % of a core: a real-time thread that uses more is stopped for {stop_ms} ms in each {} ms",
        period / 1000
    );
    let fix = format!(
        "sysctl -w {RUNTIME}={}; the loop itself uses far less",
        period * 95 / 100
    );
    match percent {
        0 => Check::fails(NAME, seen, fix),
        1..90 => Check::warning(NAME, seen, fix),
        _ => Check::ok(NAME, seen),
    }
}

/// Whether the kernel makes huge pages of its own accord.
#[must_use]
pub fn huge_pages(system: &System) -> Check {
    const NAME: &str = "huge pages";
    let Some(modes) = system.read("sys/kernel/mm/transparent_hugepage/enabled") else {
        return Check::ok(NAME, "the kernel makes none of its own accord");
    };
    if modes.contains("[always]") {
        return Check::warning(
            NAME,
            "transparent huge pages: always; merging pages stops the threads that use them",
            "echo madvise > /sys/kernel/mm/transparent_hugepage/enabled (boot option transparent_hugepage=madvise)",
        );
    }
    let mode = modes
        .split_once('[')
        .and_then(|(_, rest)| rest.split_once(']'))
        .map_or(modes.as_str(), |(mode, _)| mode);
    Check::ok(NAME, format!("transparent huge pages: {mode}"))
}

/// Whether memory may be paged out.
#[must_use]
pub fn swap(system: &System, is_memory_locked: bool) -> Check {
    const NAME: &str = "swap";
    let text = system.read("proc/swaps").unwrap_or_default();
    let areas: Vec<&str> = (text.lines().skip(1))
        .filter_map(|line| line.split_whitespace().next())
        .collect();
    let seen = match areas.as_slice() {
        [] => return Check::ok(NAME, "none"),
        areas => areas.join(", "),
    };
    if is_memory_locked {
        return Check::ok(NAME, format!("{seen}; locked memory stays out of it"));
    }
    Check::warning(
        NAME,
        format!("{seen}, and the memory is not locked: pages of the loop may go there"),
        "swapoff -a, or let the program lock its memory",
    )
}
