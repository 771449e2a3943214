//! The files of a folder in order, each with its index and stamp.
//!
//! With `times.txt` a numeric file name is the line it belongs to; other names are taken in order and must be as many as
//! the lines. Without it the step of the numbers that end the names gives the places, and the frame rate the stamps.

use std::path::{Path, PathBuf};

use freespace::space::Micros;

use super::Entry;
use crate::bad_input::{BadInput, read_text};

pub(super) struct Sequence {
    pub(super) entries: Vec<Entry>,
    pub(super) missing: Vec<usize>,
}

/// Folders of a KITTI odometry sequence that hold the left camera's frames.
const IMAGE_FOLDERS: [&str; 2] = ["image_0", "images"];

pub(super) fn read(source: &Path, frame_rate_hz: f64) -> Result<Sequence, BadInput> {
    let folder = IMAGE_FOLDERS
        .map(|name| source.join(name))
        .into_iter()
        .find(|folder| folder.is_dir())
        .unwrap_or_else(|| source.to_owned());
    let files = images_in(&folder)?;
    let times = source.join("times.txt");
    let entries = if times.is_file() {
        let stamps = read_times(&times)?;
        with_times(files, &stamps, &times)?
    } else {
        with_rate(files, frame_rate_hz)
    };
    let missing = entries
        .windows(2)
        .flat_map(|pair| pair[0].index + 1..pair[1].index)
        .collect();
    Ok(Sequence { entries, missing })
}

/// PNG and JPEG files by name, with their names.
fn images_in(folder: &Path) -> Result<Vec<(String, PathBuf)>, BadInput> {
    let listing = std::fs::read_dir(folder).map_err(|error| {
        BadInput::of_file(
            folder,
            format!("cannot be listed: {error}"),
            "SOURCE is a KITTI odometry folder (with image_0/ or images/), a folder of PNG or JPEG files, or a recording whose name \
             ends in .mcap",
        )
    })?;
    let mut files = Vec::new();
    for entry in listing {
        let path = entry
            .map_err(|error| {
                BadInput::of_file(folder, format!("cannot be listed: {error}"), "check the disk")
            })?
            .path();
        let ending = path
            .extension()
            .and_then(|e| e.to_str())
            .map(str::to_ascii_lowercase);
        if !matches!(ending.as_deref(), Some("png" | "jpg" | "jpeg")) {
            continue;
        }
        let Some(name) = path.file_stem().and_then(|stem| stem.to_str()) else {
            return Err(BadInput::of_file(
                &path,
                "its name is no UTF-8",
                "rename the file",
            ));
        };
        files.push((name.to_owned(), path));
    }
    files.sort();
    if files.is_empty() {
        return Err(BadInput::of_file(
            folder,
            "holds no PNG or JPEG image",
            "SOURCE is a KITTI odometry folder (with image_0/ or images/), a folder of PNG or JPEG files, or a recording whose name \
             ends in .mcap",
        ));
    }
    if let Some(pair) = files.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(BadInput::of_file(
            &pair[1].1,
            format!("has the same name as {}", pair[0].1.display()),
            "keep one of the two: results are named after the frame",
        ));
    }
    Ok(files)
}

/// The stamps of `times.txt`, one number of seconds a line, each later than the one before.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked to be finite, positive and below 1e12 s"
)]
fn read_times(path: &Path) -> Result<Vec<Micros>, BadInput> {
    let text = read_text(path, "times.txt holds a line for each frame, its time in seconds")?;
    let mut seconds: Vec<f64> = Vec::new();
    for (line, row) in text.lines().enumerate() {
        if row.trim().is_empty() && text.lines().skip(line).all(|rest| rest.trim().is_empty()) {
            break;
        }
        let fault = |message: String, fix: &str| BadInput::at_line(path, &text, line, message, fix);
        let time: f64 = row.trim().parse().map_err(|_| {
            fault(
                format!("`{}` is not a time in seconds", row.trim()),
                "write one number a line, such as 1.036224e-01",
            )
        })?;
        if !(0.0..1e12).contains(&time) {
            return Err(fault(
                format!("time {time} is out of range"),
                "times are seconds, zero or later",
            ));
        }
        if let Some(&last) = seconds.last()
            && time <= last
        {
            return Err(fault(
                format!("time goes backwards: {time} s after {last} s"),
                "times must increase from line to line; sort or re-export the file",
            ));
        }
        seconds.push(time);
    }
    if seconds.is_empty() {
        return Err(BadInput::of_file(
            path,
            "is empty",
            "write a time in seconds for each frame, or remove the file",
        ));
    }
    Ok(seconds
        .into_iter()
        .map(|s| Micros((s * 1e6).round() as u64))
        .collect())
}

fn with_times(
    files: Vec<(String, PathBuf)>,
    stamps: &[Micros],
    times: &Path,
) -> Result<Vec<Entry>, BadInput> {
    let numbers: Option<Vec<usize>> = files.iter().map(|(name, _)| name.parse().ok()).collect();
    let count = files.len();
    let indices = match numbers {
        Some(mut numbers) => {
            numbers.sort_unstable();
            numbers
        }
        None if count == stamps.len() => (0..count).collect(),
        None => {
            return Err(BadInput::of_file(
                times,
                format!("has {} lines for {count} images", stamps.len()),
                "give a time for each image, or number the images by their line (000000.png is the first)",
            ));
        }
    };
    let mut files = files;
    files.sort_by_key(|(name, _)| (name.parse::<usize>().ok(), name.clone()));
    files
        .into_iter()
        .zip(indices)
        .map(|((name, path), index)| {
            let stamp = *stamps.get(index).ok_or_else(|| {
                BadInput::of_file(
                    &path,
                    format!("has no time: {} has {} lines, this is frame {index}", times.display(), stamps.len()),
                    "times.txt holds a line for each frame, the first for 000000; use the times of this sequence",
                )
            })?;
            Ok(Entry { index, name, stamp, path })
        })
        .collect()
}

/// The number that ends a name, and what stands before it.
fn split_number(name: &str) -> Option<(&str, u64)> {
    let prefix = name.trim_end_matches(|c: char| c.is_ascii_digit());
    name[prefix.len()..].parse().ok().map(|number| (prefix, number))
}

const fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// A sequence with more gaps than frames is no sequence with gaps: its numbers mean something else, such as a time.
const MOST_PLACES_A_FILE: u64 = 2;

/// Places from the names' numbers where they form one evenly stepped sequence, else from their order.
fn places(files: &[(String, PathBuf)]) -> Vec<usize> {
    let in_order = || (0..files.len()).collect();
    let Some(split) = files
        .iter()
        .map(|(name, _)| split_number(name))
        .collect::<Option<Vec<_>>>()
    else {
        return in_order();
    };
    let (prefix, first) = split[0];
    let increasing = split
        .windows(2)
        .all(|pair| pair[1].0 == prefix && pair[1].1 > pair[0].1);
    let step = split
        .iter()
        .fold(0, |step, (_, number)| gcd(step, number.wrapping_sub(first)));
    let last = split[split.len() - 1].1;
    if !increasing || step == 0 || (last - first) / step >= MOST_PLACES_A_FILE * files.len() as u64 {
        return in_order();
    }
    split
        .iter()
        .map(|(_, number)| usize::try_from((number - first) / step).unwrap_or(usize::MAX))
        .collect()
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "indices of files over a frame rate of at least 0.5 Hz"
)]
fn with_rate(files: Vec<(String, PathBuf)>, frame_rate_hz: f64) -> Vec<Entry> {
    let places = places(&files);
    files
        .into_iter()
        .zip(places)
        .map(|((name, path), index)| {
            let stamp = Micros((index as f64 * 1e6 / frame_rate_hz).round() as u64);
            Entry {
                index,
                name,
                stamp,
                path,
            }
        })
        .collect()
}
