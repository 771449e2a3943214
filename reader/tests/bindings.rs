//! The committed bindings are those of the Rust type, and C and C++ agree with it on every byte.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use freespace::emit::SharedMessage;
use freespace_reader::bindings;

fn include() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../include")
}

#[test]
fn the_bindings_are_those_of_the_rust_type() {
    for (file, wanted) in [
        ("freespace.h", bindings::c_header()),
        ("freespace.py", bindings::python_module()),
    ] {
        let committed = std::fs::read_to_string(include().join(file)).unwrap_or_default();
        assert!(
            committed == wanted,
            "include/{file} is stale: cargo run -p freespace-reader --example write_bindings"
        );
    }
}

#[test]
fn c_and_cpp_agree_on_size_and_every_offset() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("layout.c");
    std::fs::write(&source, bindings::c_layout_check()).unwrap();
    for (compiler, language, standard) in [("cc", "c", "-std=c11"), ("c++", "c++", "-std=c++11")] {
        let compiled = Command::new(compiler)
            .args([
                standard,
                "-Wall",
                "-Wextra",
                "-Wpedantic",
                "-Werror",
                "-fsyntax-only",
                "-x",
                language,
                "-I",
            ])
            .arg(include())
            .arg(&source)
            .output();
        let Ok(compiled) = compiled else {
            eprintln!("SKIPPED: the layout in {language}, for there is no {compiler}");
            continue;
        };
        let complaint = String::from_utf8_lossy(&compiled.stderr);
        assert!(compiled.status.success(), "{compiler}: {complaint}");
    }
}

/// Reads a message's numbers from each line, and prints how far it is free ahead.
const FREE_AHEAD: &str = "
import sys, freespace
for line in sys.stdin:
    level, first, width, half, *free = map(float, line.split())
    message = freespace.Message(level=int(level), sector_first_rad=first, sector_rad=width)
    message.free_m[:] = free
    print(message.free_ahead_m(half))
";

/// Messages of all kinds, the half angle that is asked for with each.
fn messages() -> Vec<(Box<SharedMessage>, f32)> {
    let mut state = 1_u32;
    let mut number = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 16_777_216.0
    };
    let strange = [f32::NAN, -1.0, f32::INFINITY, f32::NEG_INFINITY, 0.0];
    (0..400_u16)
        .map(|k| {
            let mut message = Box::new(SharedMessage::EMPTY);
            message.level = [0, 0, 0, 3, 4, 5][usize::from(k % 6)];
            message.sector_first_rad = -1.2 + 0.9 * number();
            message.sector_rad = if k % 17 == 0 { 0.0 } else { 0.1 * number() };
            message.free_m = std::array::from_fn(|_| 60.0 * number());
            if k % 3 == 0 {
                message.free_m[usize::from(k % 32)] = strange[usize::from(k % 5)];
            }
            (message, 0.5 * number())
        })
        .collect()
}

#[test]
fn python_finds_the_same_way_free_as_rust() {
    let python = Command::new("python3")
        .args(["-c", FREE_AHEAD])
        .env("PYTHONPATH", include())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let Ok(mut python) = python else {
        eprintln!("SKIPPED: Python's way ahead, for there is no python3");
        return;
    };
    let messages = messages();
    let mut lines = String::new();
    for (message, half_rad) in &messages {
        let (first, width) = (message.sector_first_rad, message.sector_rad);
        write!(lines, "{} {first} {width} {half_rad}", message.level).unwrap();
        for free_m in message.free_m {
            write!(lines, " {free_m}").unwrap();
        }
        lines.push('\n');
    }
    python.stdin.take().unwrap().write_all(lines.as_bytes()).unwrap();
    let printed = String::from_utf8(python.wait_with_output().unwrap().stdout).unwrap();
    let found: Vec<f32> = printed.lines().map(|line| line.parse().unwrap()).collect();
    assert_eq!(found.len(), messages.len());
    let wanted = messages
        .iter()
        .map(|(message, half_rad)| message.free_ahead_m(*half_rad));
    let mut free = 0;
    for (k, (found, wanted)) in found.iter().zip(wanted).enumerate() {
        assert!(
            (found - wanted).abs() < 1e-4,
            "message {k}: {found} in Python, {wanted} in Rust"
        );
        free += u32::from(wanted > 0.0);
    }
    assert!((100..390).contains(&free), "{free} of them free");
}
