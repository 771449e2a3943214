//! Rights, found out by asking for them.

use std::io;

use rustix::process::{Resource, getrlimit};

use super::Check;
use crate::runtime::memory::{MemoryPlan, PartKind, locked_bytes};
use crate::runtime::rights::{
    Entered, Lack, Policy, RealTimeConfig, ThreadRole, enter, lock_memory, thread_builder,
};

/// Sets a thread up for each role, and tells what was granted.
///
/// # Errors
/// A thread could not be started.
pub fn priorities(config: &RealTimeConfig) -> io::Result<Check> {
    const NAME: &str = "priorities";
    let mut entered = Vec::new();
    for role in ThreadRole::ALL {
        let config = *config;
        let thread = thread_builder(role, &config).spawn(move || enter(role, &config))?;
        // A thread that only makes system calls has nothing to panic of.
        entered.extend(thread.join());
    }
    let wants_none = (ThreadRole::ALL.iter()).all(|role| config.of(*role).policy == Policy::Normal);
    Ok(judge_priorities(NAME, &entered, wants_none))
}

fn judge_priorities(name: &'static str, entered: &[Entered], wants_none: bool) -> Check {
    let lacks: Vec<&Lack> = entered.iter().flat_map(|thread| &thread.lacks).collect();
    let granted: Vec<String> = (entered.iter())
        .map(|thread| format!("{} {}", thread.role.name(), thread.scheduling))
        .collect();
    let Some(first) = lacks.first() else {
        let seen = granted.join(", ");
        if wants_none {
            return Check::warning(
                name,
                format!("{seen}: [runtime] asks for no real-time priority"),
                "remove policy = \"normal\" from the threads' tables",
            );
        }
        return Check::ok(name, seen);
    };
    // One refusal is like the others: the first is told, with the number of threads.
    let more = match lacks.len() {
        1 => String::new(),
        count => format!(" (and {} more)", count - 1),
    };
    Check::fails(name, format!("{first}{more}"), first.fix())
}

/// Locks the memory, as a run would, and compares what is locked with the plan; it stays locked.
#[must_use]
pub fn memory_lock(config: &RealTimeConfig, plan: &mut MemoryPlan) -> Check {
    const NAME: &str = "memory lock";
    if !config.lock_memory {
        plan.complete();
        return Check::warning(
            NAME,
            "switched off: pages of the loop may be taken away and faulted in again",
            "set lock_memory = true in [runtime]",
        );
    }
    let locked = lock_memory();
    plan.complete();
    match locked {
        Ok(()) => judge_lock(NAME, plan, locked_bytes()),
        Err(lack) => refused_lock(NAME, plan, lack),
    }
}

#[expect(clippy::cast_precision_loss, reason = "megabytes")]
fn mb(bytes: u64) -> f64 {
    bytes as f64 * 1e-6
}

fn judge_lock(name: &'static str, plan: &MemoryPlan, locked: u64) -> Check {
    // The threads of the pipeline are not running.
    let with_stacks = locked + plan.bytes_of(PartKind::Stack);
    let seen = format!(
        "granted; {:.0} MB with all threads, {:.0} MB planned",
        mb(with_stacks),
        mb(plan.total_bytes())
    );
    if plan.agrees_with(with_stacks) {
        return Check::ok(name, seen);
    }
    Check::warning(
        name,
        seen,
        "report it: a component holds memory that the plan does not show",
    )
}

fn refused_lock(name: &'static str, plan: &MemoryPlan, lack: Lack) -> Check {
    let limit = getrlimit(Resource::Memlock)
        .current
        .map_or_else(|| "none".to_owned(), |bytes| format!("{:.0} MB", mb(bytes)));
    let planned = mb(plan.total_bytes());
    Check::fails(
        name,
        format!("{lack}; limit {limit}, plan {planned:.0} MB"),
        lack.fix(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::State;
    use crate::runtime::rights::{Lacks, Right, Scheduling};

    fn entered(role: ThreadRole, errno: Option<i32>) -> Entered {
        let lack = errno.map(|errno| Lack {
            right: Right::Priority,
            thread: Some(role),
            errno,
        });
        Entered {
            role,
            scheduling: Scheduling::Fifo { priority: 45 },
            lacks: lack.into_iter().collect::<Lacks>(),
        }
    }

    #[test]
    fn a_refused_priority_fails_with_the_threads_name_and_the_fix() {
        let (frame, camera) = (ThreadRole::Frame, ThreadRole::Camera);
        let threads = [
            entered(frame, Some(libc::EPERM)),
            entered(camera, Some(libc::EPERM)),
        ];
        let check = judge_priorities("priorities", &threads, false);
        assert_eq!(check.state, State::Fails);
        assert!(
            check
                .seen
                .contains("frame: real-time priority refused (Operation not permitted")
        );
        assert!(check.seen.ends_with("(and 1 more)"), "{}", check.seen);
        assert!(check.fix.is_some_and(|fix| fix.contains("CAP_SYS_NICE")));
        let check = judge_priorities("priorities", &[entered(frame, None)], false);
        assert_eq!(
            (check.state, check.seen.as_str()),
            (State::Ok, "frame SCHED_FIFO 45")
        );
        let check = judge_priorities("priorities", &[entered(frame, None)], true);
        assert_eq!(check.state, State::Warning);
    }

    #[test]
    fn the_stacks_to_come_count_as_locked() {
        let mut plan = MemoryPlan::new();
        plan.stacks(&RealTimeConfig::default(), &ThreadRole::ALL);
        assert_eq!(judge_lock("memory lock", &plan, 0).state, State::Ok);
        assert_eq!(judge_lock("memory lock", &plan, 1_000_000).state, State::Warning);
    }
}
