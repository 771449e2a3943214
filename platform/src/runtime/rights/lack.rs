//! A right that was refused, why, and what would grant it.

use std::fmt;
use std::io;

use serde::ser::{Serialize, SerializeStruct, Serializer};

use super::ThreadRole;

/// What the runtime asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Right {
    /// A real-time policy and its priority.
    Priority,
    /// The CPUs that a thread is bound to.
    Affinity,
    /// Timers that are not held back.
    TimerSlack,
    /// The whole of the configured stack.
    Stack,
    /// Memory that is never paged out.
    MemoryLock,
    /// Freed memory that stays with the process.
    Allocator,
}

/// A right that was refused; the run goes on without it, marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lack {
    /// The right.
    pub right: Right,
    /// The thread that lacks it; none where it is the process.
    pub thread: Option<ThreadRole>,
    /// The kernel's reason.
    pub errno: i32,
}

/// What one thread lacks: at most one of each right.
pub type Lacks = heapless::Vec<Lack, 6>;

impl Lack {
    pub(super) const fn of_thread(right: Right, role: ThreadRole, errno: i32) -> Self {
        Self {
            right,
            thread: Some(role),
            errno,
        }
    }

    pub(super) const fn of_process(right: Right, errno: i32) -> Self {
        Self {
            right,
            thread: None,
            errno,
        }
    }

    /// What would grant it.
    #[must_use]
    pub const fn fix(&self) -> &'static str {
        match self.right {
            Right::Priority => {
                "give the program CAP_SYS_NICE (setcap cap_sys_nice,cap_ipc_lock+ep on its file), or run it under \
                 config/freespace.service, or raise `ulimit -r`; in a container add the capability SYS_NICE"
            }
            Right::Affinity => {
                "name CPUs that are online and allowed in `cpus` of the thread's table in [runtime]; see \
                 Cpus_allowed_list in /proc/self/status"
            }
            Right::TimerSlack => "allow prctl(PR_SET_TIMERSLACK): a seccomp filter refuses it",
            Right::Stack => {
                "start the thread with at least `stack_kib` of its table in [runtime], or lower that"
            }
            Right::MemoryLock => {
                "give the program CAP_IPC_LOCK (setcap cap_sys_nice,cap_ipc_lock+ep on its file), or run it under \
                 config/freespace.service, or raise `ulimit -l` above the memory plan; in a container add the capability \
                 IPC_LOCK"
            }
            Right::Allocator => "run with the GNU C library's own malloc (no LD_PRELOAD of another)",
        }
    }

    /// What the run does without it.
    const fn consequence(&self) -> &'static str {
        match self.right {
            Right::Priority => "it competes with every other program for the processor",
            Right::Affinity => "it runs on any CPU",
            Right::TimerSlack => "its timers may be 50 us late",
            Right::Stack => "its first deep call may meet a page fault",
            Right::MemoryLock => "pages may be taken away and faulted in again",
            Right::Allocator => "freed memory may leave and fault in again",
        }
    }

    const fn what(&self) -> &'static str {
        match self.right {
            Right::Priority => "real-time priority refused",
            Right::Affinity => "CPU affinity refused",
            Right::TimerSlack => "timer slack refused",
            Right::Stack => "stack smaller than configured",
            Right::MemoryLock => "memory lock refused",
            Right::Allocator => "allocator settings refused",
        }
    }
}

impl fmt::Display for Lack {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(role) = self.thread {
            write!(formatter, "{}: ", role.name())?;
        }
        write!(formatter, "{}", self.what())?;
        if self.errno != 0 {
            write!(formatter, " ({})", io::Error::from_raw_os_error(self.errno))?;
        }
        write!(formatter, ": {}", self.consequence())
    }
}

impl Serialize for Lack {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct("Lack", 4)?;
        fields.serialize_field("right", &self.right)?;
        fields.serialize_field("thread", &self.thread)?;
        fields.serialize_field("seen", &self.to_string())?;
        fields.serialize_field("fix", self.fix())?;
        fields.end()
    }
}
