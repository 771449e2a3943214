//! The parts of all shards, joined.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::list::ListDigest;
use super::part::{FailedDrive, Part, Settings};
use super::tally::{DriveScore, Tally};
use crate::bad_input::BadInput;
use crate::statistics::Percentiles;

/// A whole fleet.
#[derive(Clone, Debug, Serialize)]
pub struct Fleet {
    /// Of which list.
    pub list: ListDigest,
    /// Evaluated with what.
    pub settings: Settings,
    /// Sums and ratios.
    pub totals: Totals,
    /// Every drive, in the order of the list.
    pub drives: Vec<DriveScore>,
    /// Drives that could not be evaluated, and are in no sum.
    pub failed: Vec<FailedDrive>,
}

/// What the drives add up to.
#[derive(Clone, Debug, Serialize)]
pub struct Totals {
    /// Drives evaluated.
    pub drives: usize,
    /// Their counts together.
    pub counts: Tally,
    /// Percentiles of all times from capture to publication; null without key frames.
    pub capture_to_publish_ms: Option<Percentiles>,
    /// Made of those counts alone.
    pub ratios: Ratios,
}

/// Ratios of pooled counts; null where nothing was counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Ratios {
    /// Key frames answered in time at the wanted level, of all.
    pub deadlines_met: Option<f64>,
    /// Kilometres driven, as estimated.
    pub driven_km: f64,
    /// Hours driven.
    pub driven_hours: f64,
    /// Share of road among what was called road.
    pub road_precision: Option<f64>,
    /// Share of what was called road among road.
    pub road_recall: Option<f64>,
    /// Harmonic mean of both.
    pub road_f: Option<f64>,
    /// Intersection over union of free cells, 0 to 30 m ahead.
    pub free_space_iou: Option<f64>,
    /// Share of occupied cells that were called free.
    pub falsely_free: Option<f64>,
    /// `|estimated / true - 1|` of all path lengths together.
    pub distance_error: Option<f64>,
}

#[expect(
    clippy::cast_precision_loss,
    reason = "exact up to 2^53; the counts beside are exact beyond"
)]
fn ratio(part: u128, whole: u128) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

impl Ratios {
    /// Of counts.
    #[must_use]
    pub fn of(counts: &Tally) -> Self {
        let (road, grid, path) = (&counts.road, &counts.grid, &counts.path);
        // Sums of counts that fit 64 bits each.
        let sum = |parts: &[u64]| parts.iter().map(|part| u128::from(*part)).sum::<u128>();
        let share = |part: u64, rest: &[u64]| ratio(part.into(), u128::from(part) + sum(rest));
        let twice = 2 * u128::from(road.hits);
        Self {
            deadlines_met: ratio(counts.deadlines_met().into(), counts.timed_key_frames.into()),
            driven_km: ratio(counts.driven_mm.into(), 1_000_000).unwrap_or_default(),
            driven_hours: ratio(counts.driven_micros.into(), 3_600_000_000).unwrap_or_default(),
            road_precision: share(road.hits, &[road.false_alarms]),
            road_recall: share(road.hits, &[road.misses]),
            road_f: ratio(twice, twice + sum(&[road.false_alarms, road.misses])),
            free_space_iou: share(grid.free, &[grid.falsely_free, grid.falsely_not_free]),
            falsely_free: share(grid.falsely_free, &[grid.not_free]),
            distance_error: ratio(path.estimated_mm.into(), path.true_mm.into())
                .map(|ratio| (ratio - 1.0).abs()),
        }
    }
}

/// The parts' files: those given, and of a folder its `.json` files.
///
/// # Errors
/// A folder that cannot be listed, or holds no such file.
pub fn part_files(given: &[PathBuf]) -> Result<Vec<PathBuf>, BadInput> {
    let mut files = Vec::new();
    for path in given {
        if path.is_dir() {
            files.extend(crate::eval::masks::files_by_stem(path, "json")?.into_values());
        } else {
            files.push(path.clone());
        }
    }
    Ok(files)
}

/// Joins parts, each with the file that it was read from.
///
/// # Errors
/// Parts that do not make one whole (of several lists, settings or numbers of shards, missing, or given twice), or counts that
/// do not fit 64 bits; the files at fault are named.
pub fn merge(parts: Vec<(PathBuf, Part)>) -> Result<Fleet, BadInput> {
    let Some((first, head)) = parts.first() else {
        let fix = "give the files that `freespace eval drives` wrote with --out, one a shard";
        return Err(BadInput::new("no part is given", fix));
    };
    for (path, part) in &parts {
        belongs(head, first, part, path)?;
    }
    one_network(&parts)?;
    let (list, settings) = (head.list.clone(), head.settings.clone());
    let complete = complete(parts)?;
    let mut counts = Tally::default();
    let (mut drives, mut failed) = (Vec::with_capacity(list.drives), Vec::new());
    for (path, part) in complete {
        for drive in part.drives {
            counts = counts.plus(&drive.counts).ok_or_else(|| {
                let what = format!("with its drive {} the counts exceed 64 bits", drive.name);
                BadInput::of_file(
                    &path,
                    what,
                    "that many were never driven: make the part again with --force",
                )
            })?;
            drives.push(drive);
        }
        failed.extend(part.failed);
    }
    drives.sort_by_key(|drive| drive.index);
    failed.sort_by_key(|drive| drive.index);
    Ok(Fleet {
        list,
        settings,
        totals: Totals {
            drives: drives.len(),
            capture_to_publish_ms: counts.capture_to_publish.percentiles(),
            ratios: Ratios::of(&counts),
            counts,
        },
        drives,
        failed,
    })
}

/// Checks that a part is of the same evaluation as the first one.
fn belongs(head: &Part, first: &Path, part: &Part, path: &Path) -> Result<(), BadInput> {
    let first = first.display();
    if part.shard.of != head.shard.of {
        return Err(BadInput::of_file(
            path,
            format!("is shard {}, but {first} is shard {}", part.shard, head.shard),
            "join parts of one number of shards: make those of the other number again, or leave them out",
        ));
    }
    if part.list != head.list {
        return Err(BadInput::of_file(
            path,
            format!("was made of another list of drives than {first}"),
            "join parts of one list: make the older ones again with --force",
        ));
    }
    if part.settings != head.settings {
        return Err(BadInput::of_file(
            path,
            format!("was made by another version or with another --config or network than {first}"),
            "join parts of one version, configuration and network: make the older ones again with --force",
        ));
    }
    Ok(())
}

/// Checks that all drives were replayed with the same network.
fn one_network(parts: &[(PathBuf, Part)]) -> Result<(), BadInput> {
    let mut replayed = parts.iter().flat_map(|(path, part)| {
        let drives = part.drives.iter();
        drives.filter_map(move |drive| Some((path, &drive.name, drive.network_sha256.as_deref()?)))
    });
    let Some((first, name, sha256)) = replayed.next() else {
        return Ok(());
    };
    match replayed.find(|(.., other)| *other != sha256) {
        None => Ok(()),
        Some((path, other_name, other)) => Err(BadInput::of_file(
            path,
            format!(
                "its drive {other_name} was replayed with the network {other}, but drive {name} of {} with {sha256}",
                first.display()
            ),
            "make the parts again with one --config, or one network, and --force",
        )),
    }
}

/// The parts in the order of their shards, each there once.
fn complete(parts: Vec<(PathBuf, Part)>) -> Result<Vec<(PathBuf, Part)>, BadInput> {
    let of = parts.first().map_or(1, |(_, part)| part.shard.of);
    let mut by_shard: BTreeMap<usize, (PathBuf, Part)> = BTreeMap::new();
    for (path, part) in parts {
        if let Some((other, _)) = by_shard.get(&part.shard.index) {
            return Err(BadInput::of_file(
                &path,
                format!("is shard {}, and so is {}", part.shard, other.display()),
                "give the part of each shard once",
            ));
        }
        by_shard.insert(part.shard.index, (path, part));
    }
    let missing: Vec<String> = (0..of)
        .filter(|index| !by_shard.contains_key(index))
        .map(|index| format!("{index}/{of}"))
        .collect();
    if let Some(first) = missing.first() {
        return Err(BadInput::new(
            format!(
                "{} of {of} shards are missing: {}",
                missing.len(),
                shortened(&missing)
            ),
            format!(
                "make each with `freespace eval drives LIST --shard {first} --out PART.json`, and give its file too"
            ),
        ));
    }
    Ok(by_shard.into_values().collect())
}

/// The first names of a long list.
fn shortened(names: &[String]) -> String {
    const SHOWN: usize = 12;
    let shown = names[..names.len().min(SHOWN)].join(", ");
    match names.len().saturating_sub(SHOWN) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}
