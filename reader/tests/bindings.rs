//! The committed bindings are those of the Rust type, and C and C++ agree with it on every byte.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;
use std::process::Command;

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
