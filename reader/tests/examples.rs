//! The examples, in Rust, C and Python, read what a module publishes.

#![allow(clippy::unwrap_used, reason = "tests")]

mod module;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use freespace_reader::service::ICEORYX2;
use module::Module;

const MESSAGES: usize = 3;

/// The folder of what was built: `target/debug` or the like.
fn built() -> PathBuf {
    let program = std::env::current_exe().unwrap();
    program.ancestors().nth(2).unwrap().to_owned()
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Publishes until the reader has had its messages; what it printed.
fn served(name: &str, command: &mut Command) -> String {
    let mut module = Module::open(name, 2).unwrap();
    module.publish().unwrap();
    let mut reader: Child = command
        .args([name, &MESSAGES.to_string()])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    // A reader that finds nothing waits for ever.
    let mut left = 1200;
    while left > 0 && reader.try_wait().unwrap().is_none() {
        module.publish().unwrap();
        std::thread::sleep(Duration::from_millis(50));
        left -= 1;
    }
    if left == 0 {
        reader.kill().unwrap();
    }
    let output = reader.wait_with_output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

fn check(printed: &str) {
    let lines: Vec<&str> = printed
        .lines()
        .filter(|line| line.contains("free ahead"))
        .collect();
    assert_eq!(lines.len(), MESSAGES, "{printed}");
    let sequences: Vec<u64> = lines
        .iter()
        .map(|line| line.split_whitespace().next().unwrap().parse().unwrap())
        .collect();
    assert!(sequences.is_sorted_by(|a, b| a < b), "{printed}");
    for line in lines {
        assert!(line.contains(" full "), "{line}");
        assert!(line.contains("free ahead  17.5 m"), "{line}");
        assert!(line.contains("10000 of 20000 cells unknown (not free)"), "{line}");
    }
}

#[test]
fn the_rust_example_reads() {
    check(&served(
        &module::name("rust"),
        &mut Command::new(built().join("examples/read")),
    ));
}

#[test]
fn the_c_example_compiles_links_and_reads() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("read");
    let compiled = Command::new("cc")
        .args([
            "-std=c11",
            "-Wall",
            "-Wextra",
            "-Wpedantic",
            "-Werror",
            "-O1",
            "-I",
        ])
        .arg(root().join("include"))
        .arg(root().join("reader/examples/read.c"))
        .arg(library("libfreespace_reader.a"))
        .args(["-lpthread", "-ldl", "-lm", "-o"])
        .arg(&program)
        .output();
    let Ok(compiled) = compiled else {
        eprintln!("SKIPPED: the C reader, for there is no cc");
        return;
    };
    assert!(
        compiled.status.success(),
        "{}",
        String::from_utf8_lossy(&compiled.stderr)
    );
    check(&served(&module::name("c"), &mut Command::new(program)));
}

#[test]
fn the_python_example_reads() {
    if Command::new("python3").arg("--version").output().is_err() {
        eprintln!("SKIPPED: the Python reader, for there is no python3");
        return;
    }
    let mut command = Command::new("python3");
    command
        .arg(root().join("reader/examples/read.py"))
        .env("PYTHONPATH", root().join("include"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .env("FREESPACE_READER_LIBRARY", library("libfreespace_reader.so"));
    check(&served(&module::name("python"), &mut command));
}

#[test]
fn the_python_example_reads_with_the_package_iceoryx2() {
    let python = std::env::var("FREESPACE_CHECKS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let version =
        "import importlib.metadata, sys; sys.exit(importlib.metadata.version('iceoryx2') != sys.argv[1])";
    let found = Command::new(&python).args(["-c", version, ICEORYX2]).output();
    if !found.is_ok_and(|output| output.status.success()) {
        eprintln!(
            "SKIPPED: {python} has not iceoryx2 {ICEORYX2}; FREESPACE_CHECKS_PYTHON=$(hil/checks/venv readers) has"
        );
        return;
    }
    let mut command = Command::new(python);
    command
        .arg(root().join("reader/examples/read_iceoryx2.py"))
        .env("PYTHONPATH", root().join("include"))
        .env("PYTHONDONTWRITEBYTECODE", "1");
    check(&served(&module::name("iceoryx2"), &mut command));
}

/// A library as `cargo build` leaves it, or as `cargo test` does.
fn library(file: &str) -> PathBuf {
    let beside_tests = built().join("deps").join(file);
    if beside_tests.exists() {
        return beside_tests;
    }
    built().join(file)
}
