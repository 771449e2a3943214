//! A module that is killed is followed by another, and its readers read on.

#![allow(clippy::unwrap_used, reason = "tests")]

mod module;

use std::process::Command;
use std::time::Duration;

use freespace_reader::{Reader, ReaderError};
use module::Module;

const MAX_READERS: usize = 3;

/// Publishes `count` messages, 5 ms apart, none of them refused.
fn drive(module: &mut Module, count: u64) {
    for _ in 0..count {
        assert_eq!(module.publish(), Ok(()));
        std::thread::sleep(Duration::from_millis(5));
    }
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
    // What it published is nobody's word any more.
    assert_eq!(Reader::open(&name).err(), Some(ReaderError::NoModule));
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
