//! Readers that hang and readers that are killed cost the module nothing. Alone in its process, whose open files it counts.

#![allow(clippy::unwrap_used, reason = "tests")]

mod module;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use freespace_platform::runtime::memory::ProcessMemory;
use freespace_reader::Reader;
use freespace_reader::service::{MEMORY, PREFIX};
use module::Module;
use rustix::process::{Pid, Signal, kill_process};

const READERS: u32 = 100;
const MAX_READERS: usize = 3;
/// Messages after which the last dead reader must have been cleared away: it is looked for every two seconds, but what it was
/// killed over the making of only after a minute.
const SETTLING: u32 = 16_000;
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

/// What the module holds, by name.
#[derive(Clone, Debug)]
struct Held {
    files: Vec<PathBuf>,
    /// Entries of `/dev/shm`: memory, sockets and services. Nodes in the making when they were killed stay for a minute, and
    /// are not told. None while other processes have theirs there: an entry does not say whose it is.
    entries: Option<Vec<PathBuf>>,
}

fn held() -> Held {
    let files = std::fs::read_dir("/proc/self/fd").unwrap();
    Held {
        files: files
            .filter_map(|file| std::fs::read_link(file.ok()?.path()).ok())
            .collect(),
        entries: (!others_share()).then(|| entries(MEMORY.as_ref())),
    }
}

impl Held {
    /// Whether no more is held than was `before`; entries count where they were this test's alone both times.
    fn is_within(&self, before: &Self) -> bool {
        let entries = self.entries.as_ref().zip(before.entries.as_ref());
        self.files.len() <= before.files.len()
            && entries.is_none_or(|(now, before)| now.len() <= before.len())
    }
}

/// Whether a process that this test did not start has a part in a service of its own.
fn others_share() -> bool {
    let own = std::process::id().to_string();
    let is_other = |entry: &std::fs::DirEntry| {
        let stat = std::fs::read_to_string(entry.path().join("stat")).unwrap_or_default();
        // The parent is the second field after the name in parentheses.
        let parent = stat
            .rsplit_once(')')
            .and_then(|(_, fields)| fields.split_whitespace().nth(1));
        let is_process = entry.file_name().to_string_lossy().parse::<u32>().is_ok();
        is_process && entry.file_name() != *own && parent.is_some_and(|parent| parent != own)
    };
    (std::fs::read_dir("/proc").unwrap().filter_map(Result::ok))
        .filter(is_other)
        .any(|entry| {
            std::fs::read_to_string(entry.path().join("maps"))
                .is_ok_and(|maps| maps.contains(&format!("{MEMORY}/{PREFIX}")))
        })
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let listing = std::fs::read_dir(folder).into_iter().flatten();
    listing
        .filter_map(Result::ok)
        .filter(|entry| entry.file_name() != "nodes")
        .flat_map(|entry| {
            let below = if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                entries(&entry.path())
            } else {
                Vec::new()
            };
            core::iter::once(entry.path()).chain(below)
        })
        .collect()
}

/// Publishes `count` messages, 5 ms apart: a hundred times as often as a module does.
fn drive(module: &mut Module, count: u64) {
    for _ in 0..count {
        // Refused where a reader that joins holds the sharing thread for longer than that; counted, and never waited for.
        let _ = module.publish();
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Of so many messages one at most may be refused.
const ONE_REFUSED_OF: u64 = 10;

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
    if before.entries.is_none() {
        eprintln!("SKIPPED: entries of /dev/shm after killed readers: another process has a service there");
    }
    let mut hanging: Option<Child> = None;
    let mut connected = 0;
    for _ in 0..READERS {
        let mut child = reader(&name);
        drive(&mut module, random.below(16));
        connected += u32::from(held().files.len() > before.files.len());
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
    settle(&mut module, Some(&before));
    let grown = ProcessMemory::now().resident_growth_since(&memory);
    println!(
        "{READERS} readers, {connected} times at least one of them connected, {grown} bytes more; held at last: {:#?}, before: {before:#?}",
        held()
    );
    assert!(
        connected >= READERS / 4,
        "{connected} times a reader was connected"
    );
    assert!(
        module.refused * ONE_REFUSED_OF <= module.sequence,
        "{} of {} messages were refused",
        module.refused,
        module.sequence
    );
    assert!(grown < GROWTH_BYTES, "{grown} bytes more are resident");
    // There is room for as many as at the start.
    let readers: Vec<Reader> = (0..MAX_READERS).map(|_| open(&mut module, &name)).collect();
    drop(readers);
}

/// Opens a reader; the place of one that was killed is free once the module has found it dead.
fn open(module: &mut Module, name: &str) -> Reader {
    for _ in 0..SETTLING {
        if let Ok(reader) = Reader::open(name) {
            return reader;
        }
        drive(module, 1);
    }
    Reader::open(name).unwrap()
}

/// Publishes on until no more is held than was `before`, or for as long as it takes to find dead readers.
fn settle(module: &mut Module, before: Option<&Held>) {
    for _ in 0..SETTLING {
        drive(module, 1);
        let now = held();
        if before.is_some_and(|before| now.is_within(before)) {
            if before.is_some_and(|before| before.entries.is_some()) && now.entries.is_none() {
                eprintln!(
                    "SKIPPED: entries of /dev/shm after killed readers: another process has a service there"
                );
            }
            return;
        }
        if before.is_none() && module.sequence > 600 {
            return;
        }
    }
    let now = held();
    assert!(before.is_none(), "{now:#?}, before: {before:#?}");
}
