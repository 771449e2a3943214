#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::thread;

use rustix::thread::{CapabilitySet, capabilities, current_timer_slack, sched_getaffinity, set_capabilities};

use super::*;

/// Runs `work` on a thread of a role; without the right to real-time priorities where `may_be_real_time` is false.
fn on_thread<T: Send>(
    role: ThreadRole,
    config: &RealTimeConfig,
    may_be_real_time: bool,
    work: impl FnOnce() -> T + Send,
) -> T {
    thread::scope(|scope| {
        thread_builder(role, config)
            .spawn_scoped(scope, move || {
                if !may_be_real_time {
                    let mut sets = capabilities(None).unwrap();
                    sets.effective.remove(CapabilitySet::SYS_NICE);
                    sets.permitted.remove(CapabilitySet::SYS_NICE);
                    set_capabilities(None, sets).unwrap();
                }
                work()
            })
            .unwrap()
            .join()
            .unwrap()
    })
}

fn may_be_real_time() -> bool {
    let sets = capabilities(None).unwrap();
    let limit = rustix::process::getrlimit(rustix::process::Resource::Rtprio).current;
    let may = sets.effective.contains(CapabilitySet::SYS_NICE) || limit.is_none_or(|limit| limit >= 48);
    if !may {
        println!("SKIPPED: real-time priorities, which this user may not have");
    }
    may
}

#[test]
fn a_thread_gets_the_policy_of_its_role() {
    if !may_be_real_time() {
        return;
    }
    let mut config = RealTimeConfig::default();
    config.threads[ThreadRole::Network as usize].policy = Policy::RoundRobin(7);
    for (role, policy, priority) in [
        (ThreadRole::Publisher, libc::SCHED_FIFO, 48),
        (ThreadRole::Network, libc::SCHED_RR, 7),
        (ThreadRole::Monitor, libc::SCHED_OTHER, 0),
    ] {
        let (entered, attributes) = on_thread(role, &config, true, || {
            (enter(role, &config), schedule::read(0).unwrap())
        });
        assert!(entered.is_complete(), "{entered:?}");
        assert_eq!(attributes.sched_policy, policy.unsigned_abs(), "{role:?}");
        assert_eq!(attributes.sched_priority, priority, "{role:?}");
    }
}

#[test]
fn a_thread_that_is_refused_runs_on_and_says_what_it_lacks() {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Rtprio).current;
    if limit.is_none_or(|limit| limit > 0) {
        println!("SKIPPED: refused priorities, for `ulimit -r` permits them");
        return;
    }
    let config = RealTimeConfig::default();
    let role = ThreadRole::Publisher;
    let (entered, attributes) = on_thread(role, &config, false, || {
        (enter(role, &config), schedule::read(0).unwrap())
    });
    let [lack] = entered.lacks.as_slice() else {
        panic!("one lack is expected: {entered:?}");
    };
    assert_eq!(
        (lack.right, lack.thread, lack.errno),
        (Right::Priority, Some(role), libc::EPERM)
    );
    let text = lack.to_string();
    assert!(
        text.starts_with("publisher: real-time priority refused (Operation not permitted"),
        "{text}"
    );
    assert!(lack.fix().contains("CAP_SYS_NICE"));
    assert_eq!(attributes.sched_policy, libc::SCHED_OTHER.unsigned_abs());
    // The short slice needs no right. Kernels before 6.12 report none.
    if let Scheduling::Normal { slice_ns, .. } = entered.scheduling {
        assert_eq!(slice_ns, 100_000);
        assert!([0, slice_ns].contains(&attributes.sched_runtime));
    }
}

#[test]
fn a_cpu_that_is_not_there_is_a_lack_and_one_that_is_binds() {
    let mut config = RealTimeConfig::default();
    let role = ThreadRole::Monitor;
    config.threads[role as usize].cpus = Cpus(1 << 63);
    let entered = on_thread(role, &config, true, || enter(role, &config));
    if thread::available_parallelism().unwrap().get() < 64 {
        assert_eq!(
            entered.lacks.first().map(|lack| lack.right),
            Some(Right::Affinity)
        );
    }
    let allowed = sched_getaffinity(None).unwrap();
    let first = (0..64).find(|cpu| allowed.is_set(*cpu)).unwrap();
    config.threads[role as usize].cpus = Cpus(1 << first);
    let bound = on_thread(role, &config, true, || {
        assert!(enter(role, &config).is_complete());
        sched_getaffinity(None).unwrap()
    });
    assert!(bound.count() == 1 && bound.is_set(first));
}

#[test]
fn the_stack_is_touched_and_a_small_one_is_told() {
    use crate::runtime::memory::PageFaults;
    #[inline(never)]
    fn deep(bytes: usize) {
        let page = std::hint::black_box([1_u8; 4096]);
        if bytes > 8192 {
            deep(bytes - 4096);
        }
        std::hint::black_box(&page);
    }
    let config = RealTimeConfig::default();
    let role = ThreadRole::Monitor;
    let (entered, cold, warm) = on_thread(role, &config, true, || {
        let entered = enter(role, &config);
        let before = PageFaults::of_this_thread();
        deep(700 * 1024);
        let warm = PageFaults::of_this_thread().since(&before);
        let cold = thread::Builder::new()
            .stack_size(1 << 20)
            .spawn(|| {
                let before = PageFaults::of_this_thread();
                deep(700 * 1024);
                PageFaults::of_this_thread().since(&before)
            })
            .unwrap()
            .join()
            .unwrap();
        (entered, cold, warm)
    });
    assert!(entered.is_complete(), "{entered:?}");
    assert_eq!(warm.total(), 0, "a deep call faults on a touched stack");
    // Huge pages may serve many pages with one fault.
    assert!(cold.total() > 0);
    // The C library hands ended threads' stacks out again: only an uncommonly big one is sure to be missing.
    let mut config = config;
    config.threads[role as usize].stack_kib = 60 * 1024;
    let lacks = thread::Builder::new()
        .stack_size(256 * 1024)
        .spawn(move || enter(role, &config).lacks)
        .unwrap()
        .join()
        .unwrap();
    assert_eq!(lacks.first().map(|lack| lack.right), Some(Right::Stack));
}

#[test]
fn timers_of_a_working_thread_are_not_held_back() {
    let config = RealTimeConfig {
        threads: ThreadRole::ALL.map(|role| ThreadSettings {
            policy: Policy::Normal,
            ..role.default_settings()
        }),
        ..RealTimeConfig::default()
    };
    let slack = on_thread(ThreadRole::Frame, &config, true, || {
        let _ = enter(ThreadRole::Frame, &config);
        current_timer_slack().unwrap()
    });
    assert_eq!(slack, 1_000);
}
