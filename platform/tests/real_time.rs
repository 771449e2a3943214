//! What touches the whole process: the memory lock against its plan, threads that a library started, and signals.
//! Each runs in a process of its own.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Barrier, mpsc};
use std::thread;
use std::time::Duration;

use freespace_platform::runtime::allocation::CountingAllocator;
use freespace_platform::runtime::memory::{MemoryPlan, PageFaults, ProcessMemory, locked_bytes};
use freespace_platform::runtime::rights::{
    self, RealTimeConfig, Right, ThreadRole, adopt_new_threads, enter, thread_builder,
};
use freespace_platform::runtime::supervision::stop_on_signals;
use rustix::process::{Pid, Signal, kill_process};
use rustix::thread::{CapabilitySet, capabilities, set_capabilities};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn has(right: CapabilitySet) -> bool {
    let has = capabilities(None).unwrap().effective.contains(right);
    if !has {
        println!("SKIPPED: what needs {right:?}, which this user lacks");
    }
    has
}

/// Priority and policy of a thread as `/proc` has them.
fn scheduling(tid: i32) -> (String, String) {
    let stat = std::fs::read_to_string(format!("/proc/self/task/{tid}/stat")).unwrap();
    let (_, fields) = stat.rsplit_once(')').unwrap();
    let fields: Vec<&str> = fields.split_whitespace().collect();
    (fields[37].to_owned(), fields[38].to_owned())
}

/// In a process of its own, whose threads share one heap from the first on, as the program's do.
#[test]
fn the_process_is_set_up_as_it_says() {
    if std::env::var_os(CHILD).is_some() {
        rights::settle_allocator().unwrap();
        a_refused_lock_is_a_value();
        the_locked_memory_is_the_plan();
        a_librarys_threads_are_adopted();
        return;
    }
    let output = child("the_process_is_set_up_as_it_says")
        .env("GLIBC_TUNABLES", "glibc.malloc.arena_max=1")
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    (text.lines().filter(|line| line.starts_with("SKIPPED"))).for_each(|line| println!("{line}"));
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{text}\n{complaint}");
}

/// Set for a process that a test starts.
const CHILD: &str = "FREESPACE_TEST_CHILD";

/// This program again, to run one test.
fn child(test: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", test, "--nocapture"]).env(CHILD, "1");
    command
}

fn a_refused_lock_is_a_value() {
    let refused = thread::spawn(|| {
        let mut sets = capabilities(None).unwrap();
        sets.effective.remove(CapabilitySet::IPC_LOCK);
        sets.permitted.remove(CapabilitySet::IPC_LOCK);
        set_capabilities(None, sets).unwrap();
        let limit = rustix::process::getrlimit(rustix::process::Resource::Memlock).current;
        if limit.is_none_or(|limit| limit > ProcessMemory::now().mapped_bytes) {
            println!("SKIPPED: a refused memory lock, for `ulimit -l` permits it");
            return;
        }
        let lack = rights::lock_memory().unwrap_err();
        assert_eq!((lack.right, lack.thread), (Right::MemoryLock, None));
        assert!(lack.to_string().starts_with("memory lock refused ("), "{lack}");
        assert!(lack.fix().contains("CAP_IPC_LOCK"));
    });
    refused.join().unwrap();
}

fn the_locked_memory_is_the_plan() {
    if !has(CapabilitySet::IPC_LOCK) {
        return;
    }
    let config = RealTimeConfig::default();
    let mut plan = MemoryPlan::new();
    let small: Vec<Vec<u8>> = plan.measure("small blocks", || (0..20_000).map(|_| vec![1; 500]).collect());
    let big = plan.measure("a big block", || vec![1_u8; 30 << 20]);
    let roles = [ThreadRole::Frame, ThreadRole::KeyFrame, ThreadRole::Publisher];
    // Freed before the lock: it must not count.
    drop(vec![1_u8; 50 << 20]);
    plan.stacks(&config, &roles);
    rights::lock_memory().unwrap();
    plan.complete();
    let end = Barrier::new(roles.len() + 1);
    let (locked, faults) = thread::scope(|scope| {
        let (tell, told) = mpsc::channel();
        for role in roles {
            let (tell, config, end) = (tell.clone(), &config, &end);
            thread_builder(role, config)
                .spawn_scoped(scope, move || {
                    let _ = enter(role, config);
                    let before = PageFaults::of_this_thread();
                    // Within what is kept spare, for all threads together.
                    let mut block = vec![0_u8; 1 << 17];
                    block.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
                    std::hint::black_box(&block);
                    tell.send(PageFaults::of_this_thread().since(&before)).unwrap();
                    end.wait();
                })
                .unwrap();
        }
        let faults: Vec<PageFaults> = roles.iter().map(|_| told.recv().unwrap()).collect();
        let locked = locked_bytes();
        end.wait();
        (locked, faults)
    });
    assert!(
        plan.agrees_with(locked),
        "locked {locked}, planned {}\n{plan}",
        plan.total_bytes()
    );
    // Memory that is locked is there when it is given.
    assert!(faults.iter().all(|faults| faults.total() == 0), "{faults:?}");
    rights::unlock_memory().unwrap();
    drop((small, big));
}

fn a_librarys_threads_are_adopted() {
    if !has(CapabilitySet::SYS_NICE) {
        return;
    }
    let config = RealTimeConfig::default();
    let ((keep, tid, worker), lacks) = adopt_new_threads(ThreadRole::Network, &config, || {
        let (tell, told) = mpsc::channel();
        let (keep, kept) = mpsc::channel::<()>();
        let worker = thread::spawn(move || {
            tell.send(rustix::thread::gettid().as_raw_nonzero().get())
                .unwrap();
            let _ = kept.recv();
        });
        (keep, told.recv().unwrap(), worker)
    });
    let seen = scheduling(tid);
    drop(keep);
    worker.join().unwrap();
    assert!(lacks.is_empty());
    assert_eq!(seen, ("38".to_owned(), libc::SCHED_FIFO.to_string()));
}

#[test]
fn the_first_signal_asks_and_the_second_ends() {
    if std::env::var_os(CHILD).is_some() {
        let stop = Arc::new(AtomicBool::new(false));
        stop_on_signals(&stop).unwrap();
        println!("waits");
        while !stop.load(Ordering::Relaxed) {
            thread::yield_now();
        }
        println!("asked");
        loop {
            thread::park();
        }
    }
    for (signal, code) in [(Signal::TERM, 143), (Signal::INT, 130)] {
        let mut child = child("the_first_signal_asks_and_the_second_ends")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let pid = Pid::from_child(&child);
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        for word in ["waits", "asked"] {
            assert!(lines.any(|line| line.unwrap().ends_with(word)), "{word}");
            // Signals at one time are one.
            thread::sleep(Duration::from_millis(300));
            kill_process(pid, signal).unwrap();
        }
        assert_eq!(child.wait().unwrap().code(), Some(code));
    }
}
