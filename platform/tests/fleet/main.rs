//! A fleet of small drives, evaluated by several processes of the real program and joined.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod inputs;
mod jobs;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use inputs::fleet;

pub(crate) fn freespace(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_freespace"));
    command.env("NO_COLOR", "1").args(arguments);
    command
}

/// An empty folder for one test.
pub(crate) fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("fleet_results")
        .join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Standard output of a process that must succeed.
pub(crate) fn said(output: &Output) -> String {
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{complaint}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Standard error of a process that must refuse its input.
fn refused(output: &Output) -> String {
    let complaint = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{complaint}");
    complaint
}

/// Evaluates all shards at once, each in a process of its own; gives the parts' files.
fn shards(of: usize, results: &Path) -> Vec<PathBuf> {
    let parts: Vec<PathBuf> = (0..of)
        .map(|shard| results.join(format!("{shard}.json")))
        .collect();
    let children: Vec<_> = (parts.iter().enumerate())
        .map(|(shard, part)| {
            let shard = format!("{shard}/{of}");
            let arguments = [
                "eval",
                "drives",
                text(fleet()),
                "--shard",
                &shard,
                "--out",
                text(part),
            ];
            let mut command = freespace(&arguments);
            command
                .stdout(std::process::Stdio::piped())
                .stderr(std::process::Stdio::piped());
            command.spawn().unwrap()
        })
        .collect();
    for child in children {
        said(&child.wait_with_output().unwrap());
    }
    parts
}

#[test]
fn any_number_of_shards_gives_the_bytes_of_one() {
    let mut whole: Option<(Vec<u8>, String)> = None;
    // Five: more shards than drives.
    for of in [1, 2, 5] {
        let results = folder(&format!("same_{of}"));
        shards(of, &results);
        let left: Vec<_> = fs::read_dir(&results)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        assert_eq!(left.len(), of, "nothing but parts is left: {left:?}");
        let out = folder(&format!("same_{of}_fleet")).join("fleet.json");
        let arguments = ["eval", "merge", text(&results), "--out", text(&out)];
        let table = said(&freespace(&arguments).output().unwrap());
        let json = fs::read(&out).unwrap();
        match &whole {
            None => whole = Some((json, table)),
            Some((wanted, wanted_table)) => {
                assert!(json == *wanted, "{of} shards");
                assert_eq!(table, *wanted_table, "{of} shards");
            }
        }
    }
    let (json, table) = whole.unwrap();
    let fleet_json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    let names: Vec<_> = (fleet_json["drives"].as_array().unwrap().iter())
        .map(|drive| drive["name"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(names, ["a/monday", "a/tuesday", "b/wednesday.mcap"]);
    assert!(
        table.contains("b/wednesday.mcap") && table.contains("deadlines met"),
        "{table}"
    );
    // When answers left is a fact of the recorded drive, whatever its replay does.
    let driven = fs::read(fleet().join("../wednesday/report.json")).unwrap();
    let driven: serde_json::Value = serde_json::from_slice(&driven).unwrap();
    for key in ["levels", "misses_by_stage", "capture_to_publish"] {
        assert_eq!(fleet_json["drives"][2]["counts"][key], driven[key], "{key}");
    }
    // Every drive has its truth, the replayed one too.
    for drive in fleet_json["drives"].as_array().unwrap() {
        assert!(drive["counts"]["grid"]["grids"].as_u64().unwrap() > 0, "{drive}");
        assert!(drive["counts"]["road"]["masks"].as_u64().unwrap() > 0, "{drive}");
        assert!(drive["trajectory"]["ate_se3_m"].is_number(), "{drive}");
        assert!(drive["counts"]["driven_mm"].as_u64().unwrap() > 1000, "{drive}");
    }
}

#[test]
fn a_drive_alone_has_the_ratios_of_its_report() {
    let results = folder("alone");
    let list = results.join("list.txt");
    fs::write(
        &list,
        format!("# one drive\n\n{}\n", fleet().join("a/monday").display()),
    )
    .unwrap();
    let part = results.join("part.json");
    said(
        &freespace(&["eval", "drives", text(&list), "--out", text(&part)])
            .output()
            .unwrap(),
    );
    let merged = said(
        &freespace(&["eval", "merge", text(&part), "--json"])
            .output()
            .unwrap(),
    );
    let fleet_json: serde_json::Value = serde_json::from_str(&merged).unwrap();
    let report = fs::read(fleet().join("a/monday/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let (totals, truth) = (&fleet_json["totals"], &report["truth"]);
    assert_eq!(totals["ratios"]["free_space_iou"], truth["free_space_iou"]);
    assert_eq!(totals["ratios"]["road_f"], truth["road"]["f"]);
    assert_eq!(totals["ratios"]["road_precision"], truth["road"]["precision"]);
    assert_eq!(totals["capture_to_publish_ms"], report["capture_to_publish_ms"]);
    assert_eq!(totals["counts"]["key_frames"], report["key_frames"]);
    assert_eq!(totals["counts"]["levels"], report["levels"]);
    assert_eq!(
        fleet_json["drives"][0]["trajectory"]["ate_se3_m"],
        truth["ate_se3_m"]
    );
}

#[test]
fn parts_that_make_no_whole_are_refused_by_name() {
    let results = folder("refused");
    let parts = shards(2, &results);
    let other = results.join("third.json");
    let third = [
        "eval",
        "drives",
        text(fleet()),
        "--shard",
        "2/3",
        "--out",
        text(&other),
    ];
    said(&freespace(&third).output().unwrap());
    let merge = |parts: &[&Path]| {
        let mut arguments = vec!["eval", "merge"];
        arguments.extend(parts.iter().map(|part| text(part)));
        refused(&freespace(&arguments).output().unwrap())
    };
    let missing = merge(&[&parts[0]]);
    assert!(
        missing.contains("1 of 2 shards are missing: 1/2") && missing.contains("--shard 1/2"),
        "{missing}"
    );
    let twice = merge(&[&parts[0], &parts[1], &parts[1]]);
    assert!(
        twice.contains("1.json: is shard 1/2, and so is") && twice.contains("once"),
        "{twice}"
    );
    let mixed = merge(&[&parts[0], &other]);
    assert!(
        mixed.contains("third.json: is shard 2/3, but") && mixed.contains("again"),
        "{mixed}"
    );
}

#[test]
fn a_finished_part_is_kept_and_another_one_is_not_overwritten() {
    let results = folder("kept");
    let part = results.join("part.json");
    let drives = |more: &[&str]| {
        let mut arguments = vec!["eval", "drives", text(fleet()), "--out", text(&part)];
        arguments.extend(more);
        freespace(&arguments).output().unwrap()
    };
    said(&drives(&["--shard", "0/3"]));
    let (first, made) = (
        fs::read(&part).unwrap(),
        part.metadata().unwrap().modified().unwrap(),
    );
    let kept = said(&drives(&["--shard", "0/3"]));
    assert!(kept.contains("is finished already"), "{kept}");
    assert_eq!(part.metadata().unwrap().modified().unwrap(), made);
    let complaint = refused(&drives(&["--shard", "1/3"]));
    assert!(
        complaint.contains("is shard 0/3, not 1/3") && complaint.contains("--force"),
        "{complaint}"
    );
    assert!(fs::read(&part).unwrap() == first);
    said(&drives(&["--shard", "1/3", "--force"]));
    assert!(fs::read(&part).unwrap() != first);
}

#[test]
fn a_drive_that_cannot_be_read_ends_the_shard_or_is_noted() {
    let results = folder("broken");
    let broken = results.join("broken.mcap");
    fs::write(&broken, b"no recording").unwrap();
    let list = results.join("list.txt");
    fs::write(
        &list,
        format!("broken.mcap\n{}\n", fleet().join("a/monday").display()),
    )
    .unwrap();
    let part = results.join("part.json");
    let drives = ["eval", "drives", text(&list), "--out", text(&part)];
    let complaint = refused(&freespace(&drives).output().unwrap());
    assert!(
        complaint.contains("broken.mcap") && complaint.contains("--keep-going"),
        "{complaint}"
    );
    assert!(!part.exists());
    said(
        &freespace(&[&drives[..], &["--keep-going"]].concat())
            .output()
            .unwrap(),
    );
    // Asked again, it tries that drive again, and that one alone; the same once more where it is no better.
    let again = freespace(&[&drives[..], &["--keep-going"]].concat())
        .output()
        .unwrap();
    said(&again);
    let told = String::from_utf8_lossy(&again.stderr);
    assert!(
        told.contains("1 drives were not evaluated, and are tried again")
            && told.contains("1 of 1: broken.mcap"),
        "{told}"
    );
    let table = said(&freespace(&["eval", "merge", text(&part)]).output().unwrap());
    assert!(
        table.contains("1 of 2") && table.contains("not evaluated") && table.contains("broken.mcap"),
        "{table}"
    );
}
