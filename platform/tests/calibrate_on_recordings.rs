//! The program's own calibration of a recorded drive whose mount is published.
//!
//! Looks for the recordings where `FREESPACE_DATA` points, else in `../shared/data` beside the repository.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// KITTI's camera is 1.65 m over the road and rectified level; the configuration says 1.4 m and 0.02 rad.
#[test]
fn kitti_corrects_a_wrong_mount() {
    let data = std::env::var_os("FREESPACE_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let drive = data.join("kitti_odom03");
    if !drive.is_dir() {
        eprintln!(
            "SKIPPED kitti_corrects_a_wrong_mount: {} is absent",
            drive.display()
        );
        return;
    }
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config");
    let wrong = std::fs::read_to_string(shipped.join("kitti.toml"))
        .unwrap()
        .replace("height_m = 1.65", "height_m = 1.4")
        .replace("pitch_rad = 0.0 ", "pitch_rad = 0.02 ");
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("car.toml"), wrong).unwrap();
    std::fs::copy(
        shipped.join("wheels_hyundai.dbc"),
        folder.path().join("wheels_hyundai.dbc"),
    )
    .unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_freespace"))
        .current_dir(folder.path())
        .args(["calibrate", "mount", "--config", "car.toml", "--json", "--can"])
        .arg(drive.join("wheel.candump"))
        .arg(&drive)
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{error}");
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let of = |key: &str| found["mount"][key].as_f64().unwrap();
    assert!((of("height_m") / 1.65 - 1.0).abs() < 0.05, "{found}");
    assert!(of("pitch_rad").abs() < 0.005, "{found}");
}
