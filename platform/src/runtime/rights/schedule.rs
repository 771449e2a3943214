//! Policies: what a thread is given, and what stands in where that is refused.
//!
//! A thread that is refused a real-time policy falls to `SCHED_OTHER` with a raised share (nice) where that is permitted, and
//! with a short slice, which is permitted to all: the fair scheduler of kernels since 6.12 picks the earliest virtual
//! deadline first, and a short slice is an early deadline, so that the thread is served soon after it wakes.
//! Source: sched_setattr(2); Documentation/scheduler/sched-eevdf.rst.

use std::fs;
use std::io;

use super::lack::{Lack, Lacks, Right};
use super::{Policy, RealTimeConfig, ThreadRole};

/// Shortest slice that the kernel takes.
const SHORT_SLICE_NS: u64 = 100_000;

/// Share of a thread that was to be real-time: about nine times that of an ordinary one.
const RAISED_NICE: i32 = -10;

/// How a thread is scheduled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case", tag = "policy")]
pub enum Scheduling {
    /// `SCHED_FIFO`.
    Fifo {
        /// 1 to 99.
        priority: u8,
    },
    /// `SCHED_RR`.
    RoundRobin {
        /// 1 to 99.
        priority: u8,
    },
    /// `SCHED_OTHER`.
    Normal {
        /// -20 (most) to 19 (least).
        nice: i32,
        /// Own slice; zero where it is the kernel's.
        slice_ns: u64,
    },
}

impl std::fmt::Display for Scheduling {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Fifo { priority } => write!(formatter, "SCHED_FIFO {priority}"),
            Self::RoundRobin { priority } => write!(formatter, "SCHED_RR {priority}"),
            Self::Normal { nice, slice_ns: 0 } => write!(formatter, "SCHED_OTHER nice {nice}"),
            Self::Normal { nice, slice_ns } => {
                write!(formatter, "SCHED_OTHER nice {nice} slice {} us", slice_ns / 1000)
            }
        }
    }
}

/// Gives thread `tid` (0: the calling one) its policy, or the best that is permitted; with the error that refused it.
pub(super) fn apply(tid: libc::pid_t, role: ThreadRole, policy: Policy) -> (Scheduling, Option<i32>) {
    let real_time = |number: libc::c_int, priority: u8| {
        let mut attributes = attributes(number);
        attributes.sched_priority = u32::from(priority);
        set(tid, &attributes).err()
    };
    let refused = match policy {
        Policy::Fifo(priority) => real_time(libc::SCHED_FIFO, priority),
        Policy::RoundRobin(priority) => real_time(libc::SCHED_RR, priority),
        Policy::Normal => None,
    };
    match policy {
        Policy::Fifo(priority) if refused.is_none() => (Scheduling::Fifo { priority }, None),
        Policy::RoundRobin(priority) if refused.is_none() => (Scheduling::RoundRobin { priority }, None),
        _ => {
            // A thread may have inherited a policy from the one that started it: `normal` is set, not assumed.
            let now = read(tid).unwrap_or(attributes(libc::SCHED_OTHER));
            let (nice, slice_ns) = match role {
                ThreadRole::Monitor => (now.sched_nice, 0),
                _ => (now.sched_nice.min(RAISED_NICE), SHORT_SLICE_NS),
            };
            // A share may always be kept as it is, never raised without the right.
            let granted = normal(tid, nice, slice_ns).or_else(|_| normal(tid, now.sched_nice, slice_ns));
            let scheduling = granted.unwrap_or(Scheduling::Normal {
                nice: now.sched_nice,
                slice_ns: 0,
            });
            (scheduling, refused)
        }
    }
}

fn normal(tid: libc::pid_t, nice: i32, slice_ns: u64) -> Result<Scheduling, i32> {
    let mut attributes = attributes(libc::SCHED_OTHER);
    attributes.sched_nice = nice;
    attributes.sched_runtime = slice_ns;
    set(tid, &attributes)?;
    Ok(Scheduling::Normal { nice, slice_ns })
}

/// Runs `start`, which starts threads that are not ours (a network engine's), and gives those threads the role's policy,
/// CPUs and stack size.
///
/// Threads inherit the policy of the one that starts them, and engines start theirs where their session is made, on a normal
/// thread: without this the network's helpers would be normal ones, and its thread would wait for them. Other threads that
/// start meanwhile are taken for the engine's, so call it before the runtime starts its own.
pub fn adopt_new_threads<T>(
    role: ThreadRole,
    config: &RealTimeConfig,
    start: impl FnOnce() -> T,
) -> (T, Lacks) {
    let before = threads();
    let settings = config.of(role);
    let started = super::stack::with_default_size(settings.stack_kib as usize * 1024, start);
    let mut lacks = Lacks::new();
    for tid in threads() {
        if before.contains(&tid) {
            continue;
        }
        if let (_, Some(errno)) = apply(tid, role, settings.policy)
            && lacks.is_empty()
        {
            // One lack stands for all of them; there is room for it.
            let _ = lacks.push(Lack::of_thread(Right::Priority, role, errno));
        }
        let thread = rustix::thread::Pid::from_raw(tid);
        if settings.cpus.0 != 0
            && let Err(error) = rustix::thread::sched_setaffinity(thread, &super::cpu_set(settings.cpus))
            && lacks.iter().all(|lack| lack.right != Right::Affinity)
        {
            // As above.
            let _ = lacks.push(Lack::of_thread(Right::Affinity, role, error.raw_os_error()));
        }
    }
    (started, lacks)
}

/// Ids of the process's threads.
fn threads() -> Vec<libc::pid_t> {
    let Ok(folder) = fs::read_dir("/proc/self/task") else {
        return Vec::new();
    };
    folder
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .collect()
}

const fn attributes(policy: libc::c_int) -> libc::sched_attr {
    libc::sched_attr {
        // The first published form of the structure.
        size: 48,
        sched_policy: policy.unsigned_abs(),
        sched_flags: 0,
        sched_nice: 0,
        sched_priority: 0,
        sched_runtime: 0,
        sched_deadline: 0,
        sched_period: 0,
    }
}

fn set(tid: libc::pid_t, attributes: &libc::sched_attr) -> Result<(), i32> {
    // SAFETY: the kernel reads `size` bytes of the structure, which is that long and lives through the call; it writes nothing.
    let result = unsafe { libc::syscall(libc::SYS_sched_setattr, tid, std::ptr::from_ref(attributes), 0) };
    if result == 0 {
        return Ok(());
    }
    Err(io::Error::last_os_error().raw_os_error().unwrap_or(0))
}

/// Policy, priority, share and slice of a thread (0: the calling one), as the kernel has them.
pub(super) fn read(tid: libc::pid_t) -> Option<libc::sched_attr> {
    let mut attributes = attributes(0);
    // SAFETY: the kernel writes at most the 48 bytes that the third argument allows, the length of the structure.
    let result = unsafe {
        libc::syscall(
            libc::SYS_sched_getattr,
            tid,
            std::ptr::from_mut(&mut attributes),
            attributes.size,
            0,
        )
    };
    (result == 0).then_some(attributes)
}
