//! `freespace eval drives` and `freespace eval merge`: drives of many cars, evaluated in shards and joined.
//!
//! A shard that was ended half-way leaves no part, and is done again from its first drive; one that is finished is kept, and of
//! one with drives that could not be evaluated those are tried again. Its drives are worked off one after the other: what is to
//! go faster is another shard.

mod table;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::{DrivesArgs, Failure, MergeArgs, ReplayArgs, Timing, TruthArgs, replay_drive, terminal};
use crate::bad_input::{BadInput, read_text};
use crate::config::Config;
use crate::eval::fleet::{self, Drive, DriveKind, DriveList, DriveScore, FailedDrive, Fleet, Part, Settings};
use crate::eval::masks::TruthKind;
use crate::eval::page;
use crate::segmenter::Manifest;
use crate::whole_file::write_whole;

/// Evaluates the drives of a shard.
///
/// # Errors
/// A list without drives, a finished part of something else, a drive that cannot be evaluated, or a part that cannot be
/// written.
pub(super) fn drives(args: &DrivesArgs) -> Result<(), Failure> {
    let list = DriveList::open(&args.source)?;
    let config_text = args
        .config
        .as_deref()
        .map(|path| read_text(path, "give the path of a TOML file, such as config/kitti.toml"));
    let network = args.config.as_deref().map(network_of).transpose()?;
    let settings = Settings::new(config_text.transpose()?.as_deref(), network);
    let mut part = Part::new(args.shard, list.digest(), settings);
    if args.out.exists() && !args.force {
        part = keep(args, &part)?;
        if part.failed.is_empty() {
            terminal::show(format_args!(
                "{}: shard {} is finished already; --force evaluates it again",
                args.out.display(),
                args.shard
            ));
            return Ok(());
        }
        terminal::tell(format_args!(
            "{}: {} drives were not evaluated, and are tried again",
            args.out.display(),
            part.failed.len()
        ));
        part.failed.clear();
    }
    check_place(args)?;
    let kept: BTreeSet<usize> = part.drives.iter().map(|drive| drive.index).collect();
    let taken = list
        .drives
        .iter()
        .enumerate()
        .filter(|(index, _)| args.shard.takes(*index) && !kept.contains(index));
    let of = taken.clone().count();
    for (done, (index, drive)) in taken.enumerate() {
        let heading = format!("{} of {of}: {}", done + 1, drive.name);
        match evaluate(args, index, drive) {
            Ok(score) => {
                let counts = &score.counts;
                let (met, of) = (counts.deadlines_met(), counts.timed_key_frames);
                let all = counts.key_frames;
                terminal::tell(format_args!(
                    "{heading}: {all} key frames, deadlines met {met} of {of}"
                ));
                part.drives.push(score);
            }
            Err(failure) if args.keep_going => {
                terminal::tell(format_args!("{heading}: not evaluated: {failure}"));
                part.failed.push(FailedDrive {
                    index,
                    name: drive.name.clone(),
                    cause: failure.to_string(),
                });
            }
            Err(failure) => {
                terminal::tell(format_args!(
                    "{heading}: not evaluated; --keep-going notes it and goes on"
                ));
                return Err(failure);
            }
        }
    }
    part.drives.sort_by_key(|drive| drive.index);
    part.write(&args.out)?;
    terminal::show(format_args!(
        "{}: shard {}, {} drives",
        args.out.display(),
        args.shard,
        part.drives.len() + part.failed.len()
    ));
    Ok(())
}

/// SHA-256 of the model that a configuration's network has.
fn network_of(config: &Path) -> Result<String, Failure> {
    let config = Config::load(config)?;
    let manifest = Manifest::load(&config.network.manifest).map_err(Failure::bad_input)?;
    Ok(manifest.sha256)
}

/// The part that is there, where it is the wanted one.
fn keep(args: &DrivesArgs, wanted: &Part) -> Result<Part, Failure> {
    let found = Part::read(&args.out)?;
    match found.differs(wanted.shard, &wanted.list, &wanted.settings) {
        None => Ok(found),
        Some(what) => {
            let fix = "name another file after --out, or add --force to replace this one";
            Err(BadInput::of_file(&args.out, what, fix).into())
        }
    }
}

/// What is written must not be found by the next search for drives, and a mistaken place be told before the work.
fn check_place(args: &DrivesArgs) -> Result<(), Failure> {
    let folder = folder_of(&args.out);
    if !folder.is_dir() {
        let fix = format!("mkdir -p {}", folder.display());
        return Err(BadInput::of_file(&args.out, "its folder is not there", fix).into());
    }
    let within = |path: &Path| {
        let (path, source) = (std::path::absolute(path), std::path::absolute(&args.source));
        matches!((path, source), (Ok(path), Ok(source)) if path.starts_with(&source))
    };
    if let Some(runs) = args.runs.as_deref().filter(|runs| within(runs)) {
        let what = format!(
            "lies within {}, and its runs would be drives of the next list",
            args.source.display()
        );
        return Err(BadInput::of_file(runs, what, "give --runs a folder elsewhere").into());
    }
    Ok(())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// One drive, replayed where it is a recording.
fn evaluate(args: &DrivesArgs, index: usize, drive: &Drive) -> Result<DriveScore, Failure> {
    let truth = drive.truth(args.truth.as_deref());
    let score = |run: &Path| fleet::score_run(index, &drive.name, run, truth.as_deref());
    if drive.kind == DriveKind::Run {
        return Ok(score(&drive.path)?);
    }
    let run = run_folder(args, index, drive);
    let replayed = replay_drive::replay(&ReplayArgs {
        source: drive.path.clone(),
        config: args.config.clone(),
        can: None,
        out: run.clone(),
        pace: None,
        timing: Timing::Recorded,
        key_frames: None,
        ablate: None,
        // Of truth, counts are wanted that add up; they come of the files.
        truth: TruthArgs {
            truth_poses: None,
            truth_masks: None,
            truth: TruthKind::World,
        },
        mcap: super::McapArgs::default(),
        json: false,
    });
    let scored = replayed.and_then(|replayed| {
        let score = fleet::as_driven(score(&run)?, &replayed.drive);
        Ok(DriveScore {
            network_sha256: Some(replayed.network_sha256),
            ..score
        })
    });
    if args.runs.is_none() {
        // Best effort: a hidden folder that is left is replaced by the next attempt.
        let _ = std::fs::remove_dir_all(&run);
    }
    scored
}

/// Where a replay goes: below --runs by place and name, else a hidden folder beside the part.
fn run_folder(args: &DrivesArgs, index: usize, drive: &Drive) -> PathBuf {
    match &args.runs {
        Some(runs) => {
            let name = drive.name.strip_suffix(".mcap").unwrap_or(&drive.name);
            let plain = |c: char| {
                if c.is_alphanumeric() || "-_.".contains(c) {
                    c
                } else {
                    '-'
                }
            };
            let name: String = name.chars().map(plain).collect();
            runs.join(format!("{index:06}-{name}"))
        }
        None => {
            let part = args.out.file_name().unwrap_or_default().to_string_lossy();
            folder_of(&args.out).join(format!(".{part}.run"))
        }
    }
}

/// Joins parts and prints the fleet.
///
/// # Errors
/// Parts that do not make one whole, or a result that cannot be written.
pub(super) fn merge(args: &MergeArgs) -> Result<(), Failure> {
    let files = fleet::part_files(&args.parts)?;
    let parts = files
        .into_iter()
        .map(|path| Ok((path.clone(), Part::read(&path)?)));
    let fleet = fleet::merge(parts.collect::<Result<_, BadInput>>()?)?;
    let json = json(&fleet);
    if let Some(out) = &args.out {
        write_whole(out, json.as_bytes())?;
    }
    if let Some(html) = &args.html {
        write_whole(html, page::render_fleet(&fleet).as_bytes())?;
    }
    let text = if args.json { json } else { table::render(&fleet) };
    terminal::show(format_args!("{}", text.trim_end()));
    Ok(())
}

/// A fleet always has a JSON form.
fn json(fleet: &Fleet) -> String {
    let mut text = serde_json::to_string_pretty(fleet).unwrap_or_default();
    text.push('\n');
    text
}
