//! The recording as a user's tools read it: Python's `mcap` with the schemas that stand in the file, and Rerun.

use std::path::PathBuf;
use std::process::Command;

use freespace_platform::runtime::run_in_lockstep;
use freespace_platform::sink::mcap::{DriveRecorder, Split};

use crate::rig;
use crate::simulated::{self, Triangle};

/// The interpreter that has these modules; says so where there is none.
fn python_with(modules: &str) -> Option<String> {
    let python = std::env::var("FREESPACE_CHECKS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let import = format!("import {modules}");
    let found = Command::new(&python).args(["-c", &import]).output();
    if !found.is_ok_and(|output| output.status.success()) {
        eprintln!(
            "SKIPPED: {python} has not {modules} (hil/checks/readers.txt); FREESPACE_CHECKS_PYTHON=$(hil/checks/venv readers) has"
        );
        return None;
    }
    Some(python)
}

/// A short drive, recorded.
fn drive(name: &str) -> PathBuf {
    let path = rig::path(name);
    let (camera, frames, wheels) = simulated::devices(2.0);
    let setup = simulated::setup(camera, frames, Some(wheels), Triangle::new(0..0));
    let mut recorder = DriveRecorder::open(rig::plan(&path, &setup, Split::default())).unwrap();
    let setup = rig::recorded(setup, &mut recorder);
    run_in_lockstep(setup, &mut recorder.noted(&mut Nobody));
    recorder.finish();
    path
}

/// What a script of `hil/checks` prints, which must succeed.
fn checked(python: &str, script: &str, arguments: &[&str]) -> String {
    let script = format!("{}/hil/checks/{script}", env!("CARGO_MANIFEST_DIR"));
    let checked = Command::new(python).arg(script).args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&checked.stdout).into_owned();
    let fault = String::from_utf8_lossy(&checked.stderr);
    assert!(checked.status.success(), "{text}{fault}");
    text
}

#[test]
fn pythons_packages_read_every_message() {
    let Some(python) = python_with("mcap, mcap_protobuf, lz4") else {
        return;
    };
    let path = drive("python");
    let text = checked(&python, "recorded_drive.py", &["--whole", path.to_str().unwrap()]);
    for topic in [
        "/camera/image 20",
        "/freespace/grid 4",
        "/freespace/landmarks ",
        "/freespace/key_frame 4",
        "/can/out 4",
    ] {
        assert!(text.contains(topic), "{text}");
    }
}

#[test]
fn rerun_shows_pictures_poses_and_landmarks() {
    let Some(python) = python_with("rerun") else {
        return;
    };
    let path = drive("rerun");
    let text = checked(&python, "rerun_opens.py", &[path.to_str().unwrap()]);
    assert!(text.contains("/camera/image 20 as Image:buffer"), "{text}");
}

struct Nobody;

impl freespace_platform::runtime::Observer for Nobody {
    fn frame(&mut self, _: &freespace_platform::runtime::FrameReport) {}
    fn key_frame(&mut self, _: &freespace_platform::runtime::KeyFrameReport<'_>) {}
}
