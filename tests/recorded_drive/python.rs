//! The recording as a user's tools read it: Python's `mcap` with the schemas that stand in the file.

use std::process::Command;

use freespace_platform::runtime::run_in_lockstep;
use freespace_platform::sink::mcap::{DriveRecorder, Split};

use crate::rig;
use crate::simulated::{self, Triangle};

#[test]
fn pythons_packages_read_every_message() {
    let python = std::env::var("FREESPACE_CHECKS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let packages = Command::new(&python)
        .args(["-c", "import mcap, mcap_protobuf, lz4"])
        .output();
    if !packages.is_ok_and(|output| output.status.success()) {
        eprintln!(
            "SKIPPED: {python} has not the packages of hil/checks/requirements.txt; FREESPACE_CHECKS_PYTHON=$(hil/checks/venv) has"
        );
        return;
    }
    let path = rig::path("python");
    let (camera, frames, wheels) = simulated::devices(2.0);
    let setup = simulated::setup(camera, frames, Some(wheels), Triangle::new(0..0));
    let mut recorder = DriveRecorder::open(rig::plan(&path, &setup, Split::default())).unwrap();
    let setup = rig::recorded(setup, &mut recorder);
    run_in_lockstep(setup, &mut recorder.noted(&mut Nobody));
    recorder.finish();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/hil/checks/recorded_drive.py");
    let checked = Command::new(&python)
        .args([script, "--whole"])
        .arg(&path)
        .output()
        .unwrap();
    let (text, fault) = (
        String::from_utf8_lossy(&checked.stdout),
        String::from_utf8_lossy(&checked.stderr),
    );
    assert!(checked.status.success(), "{text}{fault}");
    for topic in [
        "/camera/image 20",
        "/freespace/grid 4",
        "/freespace/key_frame 4",
        "/can/out 4",
    ] {
        assert!(text.contains(topic), "{text}");
    }
}

struct Nobody;

impl freespace_platform::runtime::Observer for Nobody {
    fn frame(&mut self, _: &freespace_platform::runtime::FrameReport) {}
    fn key_frame(&mut self, _: &freespace_platform::runtime::KeyFrameReport<'_>) {}
}
