#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::fs;
use std::path::PathBuf;

use proptest::prelude::*;

use super::*;
use crate::statistics::{LatencyCounts, LatencyHistogram};

fn list(drives: usize) -> ListDigest {
    ListDigest {
        drives,
        sha256: "00".to_owned(),
    }
}

/// A drive whose counts come of its place and a seed.
fn drive(index: usize, seed: u64) -> DriveScore {
    let mut state = seed ^ (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut next = |below: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let mut latency = LatencyHistogram::new();
    let key_frames = next(50);
    (0..key_frames).for_each(|_| latency.record(next(700_000)));
    let misses = next(key_frames + 1);
    let named = |name: &str, count: u64| [(name.to_owned(), count)].into_iter().collect();
    DriveScore {
        index,
        name: format!("car/{index}"),
        network_sha256: (!index.is_multiple_of(3)).then(|| "aa".to_owned()),
        counts: Tally {
            cut_drives: next(2),
            key_frames,
            timed_key_frames: key_frames,
            deadline_misses: misses,
            misses_by_stage: named(["map", "crf", "camera"][index % 3], misses),
            levels: named(["full", "moved"][index % 2], key_frames),
            capture_to_publish: LatencyCounts::of(&latency),
            frames: next(900),
            tracked_frames: next(900),
            dropped_frames: next(9),
            driven_micros: next(1 << 31),
            driven_mm: next(1 << 30),
            road: RoadTally {
                masks: next(9),
                unanswered: next(3),
                hits: next(1 << 30),
                false_alarms: next(1 << 20),
                misses: next(1 << 20),
                rejections: next(1 << 30),
            },
            grid: GridTally {
                grids: next(9),
                free: next(1 << 20),
                falsely_free: next(1 << 10),
                falsely_not_free: next(1 << 10),
                not_free: next(1 << 20),
                ..GridTally::default()
            },
            path: PathTally {
                drives: 1,
                true_mm: 1 + next(1 << 30),
                estimated_mm: next(1 << 30),
            },
        },
        trajectory: index.is_multiple_of(2).then(|| TrajectoryRow {
            poses: next(900),
            ate_se3_m: 1.0 / (1.0 + next(1 << 20) as f64),
            ate_sim3_m: Some(next(1 << 20) as f64 / 3e5),
            scale_error: None,
            segment_translation_percent: None,
            segment_rotation_deg_per_m: None,
        }),
    }
}

/// The parts of `drives` drives in `of` shards, written and read again.
fn parts(drives: usize, of: usize, seed: u64) -> Vec<(PathBuf, Part)> {
    let folder = tempfile::tempdir().unwrap();
    (0..of)
        .map(|index| {
            let shard = Shard { index, of };
            let mut part = Part::new(shard, list(drives), Settings::new(None, None));
            part.drives = (0..drives)
                .filter(|i| shard.takes(*i) && i % 7 != 6)
                .map(|i| drive(i, seed))
                .collect();
            part.failed = (0..drives)
                .filter(|i| shard.takes(*i) && i % 7 == 6)
                .map(|index| FailedDrive {
                    index,
                    name: format!("car/{index}"),
                    cause: "is no recorded drive".to_owned(),
                })
                .collect();
            let path = folder.path().join(format!("{index}.json"));
            part.write(&path).unwrap();
            let read = Part::read(&path).unwrap();
            assert_eq!(read, part);
            (PathBuf::from(format!("{index}.json")), read)
        })
        .collect()
}

fn json(fleet: &Fleet) -> String {
    serde_json::to_string(fleet).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_shards_in_any_order_give_the_bytes_of_one(
        drives in 1..24usize, of in 1..30usize, turn in 0..30usize, seed in any::<u64>(),
    ) {
        let whole = merge(parts(drives, 1, seed)).unwrap();
        let mut shards = parts(drives, of, seed);
        shards.rotate_left(turn % of);
        if turn % 2 == 1 {
            shards.reverse();
        }
        prop_assert_eq!(json(&merge(shards).unwrap()), json(&whole));
    }
}

#[test]
fn ratios_come_of_the_sums() {
    let fleet = merge(parts(5, 2, 1)).unwrap();
    let counts = &fleet.totals.counts;
    let sum = |of: fn(&Tally) -> u64| fleet.drives.iter().map(|drive| of(&drive.counts)).sum::<u64>();
    assert_eq!(counts.key_frames, sum(|tally| tally.key_frames));
    let (hits, alarms) = (sum(|tally| tally.road.hits), sum(|tally| tally.road.false_alarms));
    assert_eq!((counts.road.hits, counts.road.false_alarms), (hits, alarms));
    let precision = hits as f64 / (hits + alarms) as f64;
    assert_eq!(fleet.totals.ratios.road_precision, Some(precision));
    assert_eq!(Ratios::of(&Tally::default()), Ratios::default());
}

#[test]
fn parts_that_make_no_whole_are_refused() {
    type Spoil = fn(&mut Vec<(PathBuf, Part)>);
    let cases: [(Spoil, &str); 8] = [
        (|parts| parts.clear(), "no part is given"),
        (|parts| drop(parts.remove(1)), "1 of 4 shards are missing: 1/4"),
        (
            |parts| parts.push(parts[2].clone()),
            "2.json: is shard 2/4, and so is 2.json",
        ),
        (
            |parts| parts[3].1.list.drives = 9,
            "3.json: was made of another list of drives than 0.json",
        ),
        (
            |parts| parts[3].1.settings.program.push('x'),
            "3.json: was made by another version",
        ),
        (
            |parts| parts[2].1.settings.network_sha256 = Some("bb".to_owned()),
            "2.json: was made by another version or with another --config or network than 0.json",
        ),
        (
            |parts| parts[2].1.drives[0].network_sha256 = Some("bb".to_owned()),
            "2.json: its drive car/2 was replayed with the network bb, but drive car/4 of 0.json with aa",
        ),
        (
            |parts| parts[1].1.shard.of = 5,
            "1.json: is shard 1/5, but 0.json is shard 0/4",
        ),
    ];
    for (spoil, wanted) in cases {
        let mut parts = parts(10, 4, 3);
        spoil(&mut parts);
        let error = merge(parts).unwrap_err();
        assert!(error.message().contains(wanted), "{wanted}: {error}");
        assert!(!error.fix().is_empty());
    }
}

#[test]
fn a_sum_that_does_not_fit_is_refused() {
    let mut parts = parts(4, 2, 3);
    parts[0].1.drives[0].counts.frames = u64::MAX;
    let error = merge(parts).unwrap_err();
    assert!(error.message().contains("exceed 64 bits"), "{error}");
}

#[test]
fn a_part_that_is_damaged_or_overlaps_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part.json");
    let (_, part) = parts(10, 4, 3).remove(1);
    let mut foreign = part.clone();
    foreign.drives.push(drive(2, 3));
    foreign.write(&path).unwrap();
    let refused = |wanted: &str| {
        let error = Part::read(&path).unwrap_err();
        assert!(
            error.message().contains("part.json") && error.message().contains(wanted),
            "{error}"
        );
        assert!(error.fix().contains("--force"));
    };
    refused("overlaps another: it holds drive 2, which is not of shard 1/4");
    let mut twice = part.clone();
    twice.drives.push(twice.drives[0].clone());
    twice.write(&path).unwrap();
    refused("holds drive 1 twice");
    let mut short = part.clone();
    short.drives.pop();
    short.write(&path).unwrap();
    refused("lacks drive");
    let text = serde_json::to_string(&part).unwrap();
    fs::write(&path, &text[..text.len() / 2]).unwrap();
    refused("is no finished part");
}

#[test]
fn shards_are_read_as_they_are_written_and_nonsense_is_told() {
    for (index, of) in [(0, 1), (3, 8), (99_999, 100_000)] {
        let shard = Shard { index, of };
        assert_eq!(shard.to_string().parse(), Ok(shard));
    }
    for text in ["", "3", "8/8", "-1/2", "0/0", "1/2/3", "0/100001"] {
        assert!(text.parse::<Shard>().is_err(), "{text}");
    }
    for drive in 0..20 {
        assert_eq!(
            (0..3)
                .filter(|&index| Shard { index, of: 3 }.takes(drive))
                .count(),
            1
        );
    }
}

/// A folder of two runs, a recording in two parts, and what is no drive.
fn fleet() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "").unwrap();
    };
    for name in [
        "b/run/report.json",
        "b/run/truth/poses.txt",
        "a/2/report.json",
        "a/drive.mcap",
        "c/night.mcap",
        "c/night.001.mcap",
        "c/night.truth/poses.txt",
        "c/notes.txt",
        ".hidden/report.json",
    ] {
        file(name);
    }
    folder
}

#[test]
fn drives_are_found_sorted_and_by_their_place_below_the_folder() {
    let folder = fleet();
    let list = DriveList::open(folder.path()).unwrap();
    let found: Vec<_> = list
        .drives
        .iter()
        .map(|drive| (drive.name.as_str(), drive.kind))
        .collect();
    // Below a recording's folder nothing is searched.
    let wanted = [
        ("a", DriveKind::Recorded),
        ("b/run", DriveKind::Run),
        ("c/night.mcap", DriveKind::Recorded),
    ];
    assert_eq!(found, wanted);
    let truth = |name: &str| Some(folder.path().join(name));
    assert_eq!(list.drives[0].truth(None), None);
    assert_eq!(list.drives[1].truth(None), truth("b/run/truth"));
    assert_eq!(list.drives[2].truth(None), truth("c/night.truth"));
    fs::create_dir_all(folder.path().join("apart/c/night")).unwrap();
    let apart = folder.path().join("apart");
    assert_eq!(list.drives[2].truth(Some(&apart)), truth("apart/c/night"));
    let alone = DriveList::open(&folder.path().join("b/run")).unwrap();
    assert_eq!((alone.drives.len(), alone.drives[0].name.as_str()), (1, "run"));
}

#[test]
fn a_list_names_the_line_at_fault_and_is_the_folder_by_another_word() {
    let folder = fleet();
    let path = folder.path().join("list.txt");
    let open = |text: &str| {
        fs::write(&path, text).unwrap();
        DriveList::open(&path)
    };
    let listed = open("# three\nc/night.mcap\n\n./b/run/\n  a\n").unwrap();
    assert_eq!(listed.digest(), DriveList::open(folder.path()).unwrap().digest());
    for (text, wanted) in [
        ("b/run\nb/none\n", "list.txt:2: "),
        ("b/run\n./b/run\n", "list.txt:2: b/run is named twice"),
        ("c/night.001.mcap\n", "is no drive"),
        ("# nothing\n", "names no drive"),
    ] {
        let error = open(text).unwrap_err();
        assert!(error.message().contains(wanted), "{error}");
    }
    let empty = tempfile::tempdir().unwrap();
    assert!(
        DriveList::open(empty.path())
            .unwrap_err()
            .message()
            .contains("holds no drive")
    );
}

#[test]
fn a_run_of_another_version_is_told_by_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let score = |report: &str| {
        fs::write(folder.path().join("report.json"), report).unwrap();
        score_run(0, "run", folder.path(), None)
    };
    let error = score("{\n\"key_frames\": 1}").unwrap_err();
    assert!(
        error.message().contains("report.json:2: missing field"),
        "{error}"
    );
    let report = r#"{"key_frames": 2, "deadline_misses": 0, "misses_by_stage": {}, "levels": {"full": 2}, "is_source_cut": false, "is_timed": true, "frames": 3,
        "tracked_frames": 3, "dropped_frames": 0, "capture_to_publish": {"max_micros": 7, "bins": {"7": 1}}}"#;
    let error = score(report).unwrap_err();
    assert!(error.message().contains("do not fit together"), "{error}");
    fs::write(folder.path().join("trajectory.kitti"), "").unwrap();
    fs::write(folder.path().join("trajectory.tum"), "# none\n").unwrap();
    let without_times = report.replace(r#"7, "bins": {"7": 1}"#, r#"0, "bins": {}"#);
    score(&without_times).unwrap_err();
    let untimed = score(&without_times.replace("true", "false")).unwrap();
    assert_eq!(
        (untimed.counts.key_frames, untimed.counts.timed_key_frames),
        (2, 0)
    );
    let score = score(&report.replace(r#""7": 1"#, r#""7": 2"#)).unwrap();
    assert_eq!((score.counts.driven_mm, score.counts.driven_micros), (0, 0));
    assert_eq!(score.counts.timed_key_frames, 2);
    fs::write(
        folder.path().join("trajectory.tum"),
        "# t\n1.500000 0 0\n62.000001 0 0\n",
    )
    .unwrap();
    let again = score_run(0, "run", folder.path(), None).unwrap();
    assert_eq!(again.counts.driven_micros, 60_500_001);
}
