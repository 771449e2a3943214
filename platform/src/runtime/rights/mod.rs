//! Real-time set-up: what each thread, and the process, asks of the kernel before the first frame.
//!
//! In: a [`RealTimeConfig`]. Out: an [`Entered`] for each thread, saying how it is scheduled, and every [`Lack`]: a right that
//! was refused, why, and its fix. Order of calls: [`settle_allocator`] first in `main`; [`thread_builder`] for each thread and
//! [`enter`] on the thread itself; [`adopt_new_threads`] around what starts threads inside a library; [`lock_memory`] when
//! all is constructed. Invariant: nothing here is needed to run; a refused right leaves a working thread and a value that
//! says so. Cost: a few system calls a thread, once. Source: sched(7), mlockall(2), mallopt(3).

mod lack;
mod process;
mod schedule;
mod stack;

pub use lack::{Lack, Lacks, Right};
pub use process::{lock_memory, settle_allocator, unlock_memory};
pub use schedule::{Scheduling, adopt_new_threads};

use std::num::NonZeroU64;
use std::thread::Builder;

use rustix::thread::{CpuSet, sched_setaffinity, set_current_timer_slack};

/// The threads of a live run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ThreadRole {
    /// Waits for frames of the camera.
    Camera,
    /// Takes in and sends CAN frames.
    Can,
    /// Tracks every frame.
    Frame,
    /// Maps, cuts and grids every key frame.
    KeyFrame,
    /// Runs the network.
    Network,
    /// Publishes by the deadline.
    Publisher,
    /// Hands messages to the readers of shared memory.
    Sharing,
    /// Watches, records and tells; never real-time.
    Monitor,
}

impl ThreadRole {
    /// All roles, in the order of the pipeline.
    pub const ALL: [Self; 8] = [
        Self::Camera,
        Self::Can,
        Self::Frame,
        Self::KeyFrame,
        Self::Network,
        Self::Publisher,
        Self::Sharing,
        Self::Monitor,
    ];

    /// The threads that must keep time, started with the run; *sharing* starts before, with its service.
    pub const REAL_TIME: [Self; 6] = [
        Self::Camera,
        Self::Can,
        Self::Frame,
        Self::KeyFrame,
        Self::Network,
        Self::Publisher,
    ];

    /// Name of the thread, and of its table in the configuration with `-` for `_`; the kernel keeps 15 bytes.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Can => "can",
            Self::Frame => "frame",
            Self::KeyFrame => "key-frame",
            Self::Network => "network",
            Self::Publisher => "publisher",
            Self::Sharing => "sharing",
            Self::Monitor => "monitor",
        }
    }

    /// What a thread of this role is given where the configuration says nothing.
    ///
    /// Priorities stay under 50, that of the kernel's interrupt threads on a `PREEMPT_RT` kernel, for camera and CAN must get
    /// through. The publisher's work is short and must never wait; the network yields to the key frame that awaits it.
    #[must_use]
    pub const fn default_settings(self) -> ThreadSettings {
        let (policy, stack_kib) = match self {
            Self::Camera => (Policy::Fifo(46), 512),
            Self::Can => (Policy::Fifo(47), 256),
            Self::Frame => (Policy::Fifo(45), 1024),
            Self::KeyFrame => (Policy::Fifo(40), 1024),
            Self::Network => (Policy::Fifo(38), 512),
            Self::Publisher => (Policy::Fifo(48), 256),
            // What readers do may cost it time: no thread with a deadline may wait for it.
            Self::Sharing => (Policy::Fifo(42), 512),
            Self::Monitor => (Policy::Normal, 1024),
        };
        ThreadSettings {
            policy,
            cpus: Cpus(0),
            stack_kib,
        }
    }
}

/// How the kernel schedules a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// Runs until it waits: `SCHED_FIFO` at a priority of 1 to 99.
    Fifo(u8),
    /// The same, in turns with threads of its own priority: `SCHED_RR`.
    RoundRobin(u8),
    /// A fair share: `SCHED_OTHER`.
    Normal,
}

/// A set of CPUs, bit n for CPU n; empty for any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cpus(pub u64);

impl Cpus {
    /// CPUs a set can name.
    pub const LIMIT: u32 = u64::BITS;

    /// Whether a CPU is in the set.
    #[must_use]
    pub const fn has(self, cpu: u32) -> bool {
        cpu < Self::LIMIT && self.0 >> cpu & 1 == 1
    }
}

/// What one thread is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ThreadSettings {
    /// Policy and priority.
    pub policy: Policy,
    /// CPUs it may run on.
    pub cpus: Cpus,
    /// Size of its stack, all of it touched before the first frame.
    pub stack_kib: u32,
}

/// What the runtime asks of the kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RealTimeConfig {
    /// Whether all memory is locked in RAM.
    pub lock_memory: bool,
    /// What each thread is given, by [`ThreadRole`] in the order of [`ThreadRole::ALL`].
    pub threads: [ThreadSettings; ThreadRole::ALL.len()],
}

impl Default for RealTimeConfig {
    fn default() -> Self {
        Self {
            lock_memory: true,
            threads: ThreadRole::ALL.map(ThreadRole::default_settings),
        }
    }
}

impl RealTimeConfig {
    /// What a thread of a role is given.
    #[must_use]
    pub const fn of(&self, role: ThreadRole) -> &ThreadSettings {
        &self.threads[role as usize]
    }
}

/// What became of a thread's set-up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entered {
    /// The thread.
    pub role: ThreadRole,
    /// How it is scheduled now.
    pub scheduling: Scheduling,
    /// What was refused; empty where all was granted.
    pub lacks: Lacks,
}

impl Entered {
    /// Whether all that was asked for was granted.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.lacks.is_empty()
    }
}

/// Timers of a normal thread may be this late to share a wake-up; 50 000 ns is the kernel's own value.
const TIMER_SLACK_NS: u64 = 1_000;

/// A builder with the name and the stack of a role; its thread then calls [`enter`].
pub fn thread_builder(role: ThreadRole, config: &RealTimeConfig) -> Builder {
    Builder::new()
        .name(role.name().to_owned())
        .stack_size(config.of(role).stack_kib as usize * 1024)
}

/// Sets the calling thread up for its role: CPUs, policy, timer slack, touched stack.
///
/// The name is set by [`thread_builder`]. It may allocate, so it comes before a `RealTimeScope`.
#[must_use = "what was refused must be told"]
pub fn enter(role: ThreadRole, config: &RealTimeConfig) -> Entered {
    let settings = config.of(role);
    let mut lacks = Lacks::new();
    let mut note = |lack: Lack| {
        // There is room for one lack of each right.
        let _ = lacks.push(lack);
    };
    if settings.cpus != Cpus::default()
        && let Err(error) = sched_setaffinity(None, &cpu_set(settings.cpus))
    {
        note(Lack::of_thread(Right::Affinity, role, error.raw_os_error()));
    }
    let (scheduling, refused) = schedule::apply(0, role, settings.policy);
    if let Some(errno) = refused {
        note(Lack::of_thread(Right::Priority, role, errno));
    }
    // The monitor's timers may as well be shared.
    if role != ThreadRole::Monitor
        && let Err(error) = set_current_timer_slack(NonZeroU64::new(TIMER_SLACK_NS))
    {
        note(Lack::of_thread(Right::TimerSlack, role, error.raw_os_error()));
    }
    if let Err(errno) = stack::touch(settings.stack_kib as usize * 1024) {
        note(Lack::of_thread(Right::Stack, role, errno));
    }
    Entered {
        role,
        scheduling,
        lacks,
    }
}

fn cpu_set(cpus: Cpus) -> CpuSet {
    let mut set = CpuSet::new();
    for cpu in (0..Cpus::LIMIT).filter(|cpu| cpus.has(*cpu)) {
        set.set(cpu as usize);
    }
    set
}

#[cfg(test)]
mod tests;
