//! Readers that hang and readers that are killed cost the module nothing; a module that is killed is followed by another.

#![allow(clippy::unwrap_used, reason = "tests")]

mod module;

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use freespace_platform::runtime::memory::ProcessMemory;
use freespace_reader::{Reader, ReaderError};
use module::Module;
use rustix::process::{Pid, Signal, kill_process};

const READERS: u32 = 100;
const MAX_READERS: usize = 3;
/// Messages after which the last dead reader must have been cleared away: it is looked for every two seconds.
const SETTLING: u32 = 3000;
/// What may stay of a hundred readers: the allocator's habits.
const GROWTH_BYTES: i64 = 4 << 20;

/// xorshift64; the same readers every time.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }
}

fn example() -> PathBuf {
    let program = std::env::current_exe().unwrap();
    program.ancestors().nth(2).unwrap().join("examples/read")
}

fn reader(name: &str) -> Child {
    let mut command = Command::new(example());
    command.arg(name).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().unwrap()
}

fn signal(child: &Child, signal: Signal) {
    // One that has ended by itself, for want of room, is no longer there.
    let _ = kill_process(Pid::from_child(child), signal);
}

/// Open files, and entries of `/dev/shm` and below.
fn held() -> (usize, usize) {
    let files = std::fs::read_dir("/proc/self/fd").unwrap().count();
    (files, entries("/dev/shm".into()))
}

fn entries(folder: PathBuf) -> usize {
    let Ok(listing) = std::fs::read_dir(folder) else {
        return 0;
    };
    listing
        .filter_map(Result::ok)
        .map(|entry| {
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            1 + if is_folder { entries(entry.path()) } else { 0 }
        })
        .sum()
}

/// Publishes `count` messages, 5 ms apart, none of them refused.
fn drive(module: &mut Module, count: u64) {
    for _ in 0..count {
        assert_eq!(module.publish(), Ok(()));
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_hundred_readers_that_hang_or_are_killed_leave_nothing_behind() {
    let name = module::name("killed");
    let mut random = Random(2018);
    let mut module = Module::open(&name, MAX_READERS).unwrap();
    drive(&mut module, 10);
    // The first reader makes the library set up what it keeps.
    let mut first = reader(&name);
    drive(&mut module, 40);
    first.kill().unwrap();
    first.wait().unwrap();
    settle(&mut module, None);
    let (before, memory) = (held(), ProcessMemory::now());
    let mut hanging: Option<Child> = None;
    for _ in 0..READERS {
        let mut child = reader(&name);
        drive(&mut module, random.below(16));
        if random.below(3) == 0 {
            signal(&child, Signal::STOP);
            if let Some(mut earlier) = hanging.replace(child) {
                earlier.kill().unwrap();
                earlier.wait().unwrap();
            }
        } else {
            signal(&child, Signal::KILL);
            child.wait().unwrap();
        }
        drive(&mut module, random.below(4));
    }
    if let Some(mut last) = hanging {
        last.kill().unwrap();
        last.wait().unwrap();
    }
    settle(&mut module, Some(before));
    let grown = ProcessMemory::now().resident_growth_since(&memory);
    println!(
        "after {READERS} readers: {:?} where there were {before:?}, {grown} bytes more",
        held()
    );
    assert!(grown < GROWTH_BYTES, "{grown} bytes more are resident");
    // There is room for as many as at the start.
    let readers: Vec<Reader> = (0..MAX_READERS).map(|_| Reader::open(&name).unwrap()).collect();
    drop(readers);
}

/// Publishes on until no more is held than was `before`, or for as long as it takes to find dead readers.
fn settle(module: &mut Module, before: Option<(usize, usize)>) {
    for _ in 0..SETTLING {
        drive(module, 1);
        let now = held();
        let is_settled = before.is_some_and(|before| now.0 <= before.0 && now.1 <= before.1);
        if is_settled || (before.is_none() && module.sequence > 600) {
            return;
        }
    }
    let now = held();
    assert!(before.is_none(), "{now:?} files and entries, {before:?} before");
}

/// Set for a process that a test starts.
const CHILD: &str = "FREESPACE_TEST_MODULE";

#[test]
fn a_module_takes_over_from_one_that_was_killed() {
    if let Ok(name) = std::env::var(CHILD) {
        let mut module = Module::open(&name, MAX_READERS).unwrap();
        loop {
            drive(&mut module, 1);
        }
    }
    let name = module::name("taken");
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "a_module_takes_over_from_one_that_was_killed",
            "--nocapture",
        ])
        .env(CHILD, &name)
        .spawn()
        .unwrap();
    let mut reader = loop {
        match Reader::open(&name) {
            Err(ReaderError::NoModule) => std::thread::sleep(Duration::from_millis(20)),
            opened => break opened.unwrap(),
        }
    };
    let first = loop {
        if let Some(message) = reader.next(Duration::from_secs(1)).unwrap() {
            break message.sequence;
        }
    };
    child.kill().unwrap();
    child.wait().unwrap();
    while reader.next(Duration::ZERO).unwrap().is_some() {}
    let mut module = Module::open(&name, MAX_READERS).unwrap();
    // Far from what the first one counted.
    module.sequence = first + 1_000_000;
    let wanted = module.sequence;
    drive(&mut module, 2);
    let mut seen = 0;
    for _ in 0..100 {
        if let Some(message) = reader.next(Duration::from_millis(20)).unwrap() {
            seen = message.sequence;
            break;
        }
        drive(&mut module, 1);
    }
    assert!(seen >= wanted, "{seen} where {wanted} was published");
}
