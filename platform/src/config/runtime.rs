//! `[runtime]`: what the process and each thread ask of the kernel. What is not written keeps the role's default.

use serde::Deserialize;

use super::{Config, Invalid, within};
use crate::runtime::rights::{Cpus, Policy, RealTimeConfig, ThreadRole, ThreadSettings};

/// `[runtime]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RuntimeSection {
    /// Whether all memory is locked in RAM.
    pub lock_memory: bool,
    /// Camera thread.
    pub camera: ThreadSection,
    /// CAN thread.
    pub can: ThreadSection,
    /// Frame thread.
    pub frame: ThreadSection,
    /// Key-frame thread.
    pub key_frame: ThreadSection,
    /// Network's threads.
    pub network: ThreadSection,
    /// Publisher.
    pub publisher: ThreadSection,
    /// Thread that hands messages to the readers of shared memory.
    pub sharing: ThreadSection,
    /// Monitor.
    pub monitor: ThreadSection,
}

impl Default for RuntimeSection {
    fn default() -> Self {
        let thread = ThreadSection::default;
        Self {
            lock_memory: true,
            camera: thread(),
            can: thread(),
            frame: thread(),
            key_frame: thread(),
            network: thread(),
            publisher: thread(),
            sharing: thread(),
            monitor: thread(),
        }
    }
}

/// One thread's table in `[runtime]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThreadSection {
    /// Scheduling policy.
    pub policy: Option<PolicyName>,
    /// Priority of `fifo` and `rr`.
    pub priority: Option<i64>,
    /// CPUs it may run on; any where empty.
    pub cpus: Vec<i64>,
    /// Size of its stack.
    pub stack_kib: Option<i64>,
}

/// Name of a scheduling policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyName {
    /// `SCHED_FIFO`.
    Fifo,
    /// `SCHED_RR`.
    Rr,
    /// `SCHED_OTHER`.
    Normal,
}

/// Keys of one thread's table, for errors.
struct Keys {
    priority: &'static str,
    cpus: &'static str,
    stack_kib: &'static str,
}

macro_rules! keys {
    ($table:literal) => {
        Keys {
            priority: concat!("runtime.", $table, ".priority"),
            cpus: concat!("runtime.", $table, ".cpus"),
            stack_kib: concat!("runtime.", $table, ".stack_kib"),
        }
    };
}

const fn keys(role: ThreadRole) -> Keys {
    match role {
        ThreadRole::Camera => keys!("camera"),
        ThreadRole::Can => keys!("can"),
        ThreadRole::Frame => keys!("frame"),
        ThreadRole::KeyFrame => keys!("key_frame"),
        ThreadRole::Network => keys!("network"),
        ThreadRole::Publisher => keys!("publisher"),
        ThreadRole::Sharing => keys!("sharing"),
        ThreadRole::Monitor => keys!("monitor"),
    }
}

impl RuntimeSection {
    const fn of(&self, role: ThreadRole) -> &ThreadSection {
        match role {
            ThreadRole::Camera => &self.camera,
            ThreadRole::Can => &self.can,
            ThreadRole::Frame => &self.frame,
            ThreadRole::KeyFrame => &self.key_frame,
            ThreadRole::Network => &self.network,
            ThreadRole::Publisher => &self.publisher,
            ThreadRole::Sharing => &self.sharing,
            ThreadRole::Monitor => &self.monitor,
        }
    }

    pub(super) fn check(&self) -> Result<(), Invalid> {
        for role in ThreadRole::ALL {
            self.of(role).check(role)?;
        }
        Ok(())
    }
}

impl ThreadSection {
    #[expect(clippy::cast_precision_loss, reason = "compared with small bounds only")]
    fn check(&self, role: ThreadRole) -> Result<(), Invalid> {
        let keys = keys(role);
        if let Some(priority) = self.priority {
            within(keys.priority, priority as f64, 1.0..=99.0, "(higher runs first)")?;
            if self.policy_name(role) == PolicyName::Normal {
                return Err(Invalid::new(
                    keys.priority,
                    format!("`{}` is set, but the policy is normal", keys.priority),
                    "set policy = \"fifo\" or \"rr\" beside it, or remove the priority",
                ));
            }
        }
        if role == ThreadRole::Monitor && self.policy_name(role) != PolicyName::Normal {
            return Err(Invalid::new(
                "runtime.monitor.policy",
                "the monitor writes files and allocates: it may not be real-time",
                "remove `policy` from [runtime.monitor]",
            ));
        }
        for cpu in &self.cpus {
            within(
                keys.cpus,
                *cpu as f64,
                0.0..=f64::from(Cpus::LIMIT - 1),
                "(numbers of CPUs)",
            )?;
        }
        match self.stack_kib {
            Some(stack) => within(keys.stack_kib, stack as f64, 256.0..=65_536.0, "KiB"),
            None => Ok(()),
        }
    }

    fn policy_name(&self, role: ThreadRole) -> PolicyName {
        self.policy.unwrap_or(match role.default_settings().policy {
            Policy::Fifo(_) => PolicyName::Fifo,
            Policy::RoundRobin(_) => PolicyName::Rr,
            Policy::Normal => PolicyName::Normal,
        })
    }

    fn settings(&self, role: ThreadRole) -> ThreadSettings {
        let default = role.default_settings();
        let default_priority = match default.policy {
            Policy::Fifo(priority) | Policy::RoundRobin(priority) => priority,
            Policy::Normal => 1,
        };
        // In range: checked when the configuration was read.
        let priority = self
            .priority
            .and_then(|priority| u8::try_from(priority).ok())
            .unwrap_or(default_priority);
        let mut cpus = Cpus::default();
        for cpu in self.cpus.iter().filter_map(|cpu| u32::try_from(*cpu).ok()) {
            cpus.0 |= 1_u64.checked_shl(cpu).unwrap_or(0);
        }
        ThreadSettings {
            policy: match self.policy_name(role) {
                PolicyName::Fifo => Policy::Fifo(priority),
                PolicyName::Rr => Policy::RoundRobin(priority),
                PolicyName::Normal => Policy::Normal,
            },
            cpus,
            stack_kib: self
                .stack_kib
                .and_then(|stack| u32::try_from(stack).ok())
                .unwrap_or(default.stack_kib),
        }
    }
}

impl Config {
    /// What the runtime asks of the kernel.
    #[must_use]
    pub fn real_time(&self) -> RealTimeConfig {
        RealTimeConfig {
            lock_memory: self.runtime.lock_memory,
            threads: ThreadRole::ALL.map(|role| self.runtime.of(role).settings(role)),
        }
    }
}
