//! Which drives there are, and which of them a shard takes.
//!
//! In: a list file (a drive a line, relative to the file's folder, `#` begins a comment) or a folder, searched [`DEPTH`] deep.
//! Out: the drives by name, sorted, each a finished run's folder (it holds `report.json`) or a recorded drive (`NAME.mcap`, or a
//! folder that holds `drive.mcap`). Truth lies in the folder's `truth/`, beside `NAME.mcap` in `NAME.truth/`, or below a folder
//! of its own under the drive's name. Invariant: names do not depend on where the list is mounted, and so neither does the
//! assignment: drive i of the sorted list belongs to shard i mod N.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::bad_input::{BadInput, read_text};
use crate::sink::mcap::later_part_of;

/// Folders below the given one that are searched: fleet, car, day, drive, and as many again.
const DEPTH: usize = 8;
/// More shards than a job can have are a slip of the pen.
const MAX_SHARDS: usize = 100_000;

/// Every Nth drive, from the Ith on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    /// From 0.
    pub index: usize,
    /// Shards in all.
    pub of: usize,
}

impl Shard {
    /// All drives.
    pub const WHOLE: Self = Self { index: 0, of: 1 };

    /// Whether the shard takes drive `drive` of the sorted list.
    #[must_use]
    pub const fn takes(self, drive: usize) -> bool {
        drive % self.of == self.index
    }

    /// Whether there is such a shard.
    #[must_use]
    pub const fn is_sound(self) -> bool {
        self.index < self.of && self.of <= MAX_SHARDS
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.split_once('/')
            .and_then(|(index, of)| {
                Some(Self {
                    index: index.parse().ok()?,
                    of: of.parse().ok()?,
                })
            })
            .filter(|shard| shard.is_sound())
            .ok_or_else(|| {
                format!(
                    "`{text}` is no shard; give I/N, I from 0 to N - 1, N at most {MAX_SHARDS}, such as 0/4"
                )
            })
    }
}

/// What is evaluated of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveKind {
    /// The folder that a run left.
    Run,
    /// A recording in MCAP, which is replayed first.
    Recorded,
}

impl DriveKind {
    fn of(path: &Path) -> Option<Self> {
        if path.join("report.json").is_file() {
            return Some(Self::Run);
        }
        let is_recorded = if path.is_dir() {
            path.join("drive.mcap").is_file()
        } else {
            path.is_file() && path.extension().is_some_and(|ending| ending == "mcap") && !follows(path)
        };
        is_recorded.then_some(Self::Recorded)
    }
}

/// Whether a file is a later part of another recording: `NAME.001.mcap` beside `NAME.mcap`.
fn follows(path: &Path) -> bool {
    later_part_of(path).is_some_and(|(_, first)| first.is_file())
}

/// A drive of the list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drive {
    /// Path from the list's folder, with slashes.
    pub name: String,
    /// Where it is.
    pub path: PathBuf,
    /// What it is.
    pub kind: DriveKind,
}

impl Drive {
    /// The folder of its truth, where there is one: that under its name in `apart`, else its own.
    #[must_use]
    pub fn truth(&self, apart: Option<&Path>) -> Option<PathBuf> {
        let named = self.name.strip_suffix(".mcap").unwrap_or(&self.name);
        let own = if self.path.is_dir() {
            self.path.join("truth")
        } else {
            self.path.with_extension("truth")
        };
        let folders = apart.map(|folder| folder.join(named)).into_iter().chain([own]);
        folders.into_iter().find(|folder| folder.is_dir())
    }
}

/// What tells one list from another.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ListDigest {
    /// Drives.
    pub drives: usize,
    /// SHA-256 of their sorted names, each with a line feed, in hexadecimal digits.
    pub sha256: String,
}

/// Drives, sorted by name.
#[derive(Clone, Debug)]
pub struct DriveList {
    /// The drives.
    pub drives: Vec<Drive>,
}

impl DriveList {
    /// Reads a list file, or searches a folder.
    ///
    /// # Errors
    /// A list or folder that cannot be read or names no drive, a line that is none, or a drive that is named twice.
    pub fn open(source: &Path) -> Result<Self, BadInput> {
        let mut drives = if source.is_dir() {
            searched(source)?
        } else {
            listed(source)?
        };
        drives.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(Self { drives })
    }

    /// What tells this list from another.
    #[must_use]
    pub fn digest(&self) -> ListDigest {
        let mut sum = Sha256::new();
        for drive in &self.drives {
            sum.update(drive.name.as_bytes());
            sum.update(b"\n");
        }
        ListDigest {
            drives: self.drives.len(),
            sha256: hex(&sum.finalize()),
        }
    }
}

/// Hexadecimal digits of bytes.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn listed(list: &Path) -> Result<Vec<Drive>, BadInput> {
    let fix =
        "give a folder of drives, or a text file that names one a line, relative to the file's own folder";
    let text = read_text(list, fix)?;
    let folder = list.parent().unwrap_or(Path::new(""));
    let mut drives = BTreeMap::new();
    for (line, row) in text.lines().enumerate() {
        let row = row.trim();
        if row.is_empty() || row.starts_with('#') {
            continue;
        }
        let path = folder.join(row);
        let Some(kind) = DriveKind::of(&path) else {
            let what = format!("{} is no drive", path.display());
            let fix = "name a folder that holds report.json of a finished run or drive.mcap, or the first .mcap file of a drive";
            return Err(BadInput::at_line(list, &text, line, what, fix));
        };
        let name = tidy(Path::new(row));
        let drive = Drive {
            name: name.clone(),
            path,
            kind,
        };
        if drives.insert(name.clone(), drive).is_some() {
            let what = format!("{name} is named twice");
            return Err(BadInput::at_line(list, &text, line, what, "name each drive once"));
        }
    }
    if drives.is_empty() {
        return Err(BadInput::of_file(list, "names no drive", fix));
    }
    Ok(drives.into_values().collect())
}

/// A path as a name: slashes between its parts, no `.` among them.
fn tidy(path: &Path) -> String {
    let parts = path.components().filter(|part| *part != Component::CurDir);
    let path: PathBuf = parts.collect();
    path.to_string_lossy().into_owned()
}

fn searched(folder: &Path) -> Result<Vec<Drive>, BadInput> {
    let mut drives = Vec::new();
    if let Some(kind) = DriveKind::of(folder) {
        // Not a fleet, but one drive of it.
        let name = folder
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let path = folder.to_owned();
        drives.push(Drive { name, path, kind });
        return Ok(drives);
    }
    search(folder, Path::new(""), DEPTH, &mut drives)?;
    if drives.is_empty() {
        return Err(BadInput::of_file(
            folder,
            "holds no drive",
            "give a folder of finished runs (they hold report.json) or of recordings (.mcap), or a list of them",
        ));
    }
    Ok(drives)
}

/// Adds the drives below `folder`, named from `name` on. Hidden entries and truth are no drives.
fn search(folder: &Path, name: &Path, depth: usize, drives: &mut Vec<Drive>) -> Result<(), BadInput> {
    let unread = |error: std::io::Error| {
        let fix = "let this user read it, or name the drives in a list";
        BadInput::of_file(folder, format!("cannot be listed: {error}"), fix)
    };
    for entry in fs::read_dir(folder).map_err(unread)? {
        let entry = entry.map_err(unread)?;
        let (path, name) = (entry.path(), name.join(entry.file_name()));
        let is_hidden = entry.file_name().to_string_lossy().starts_with('.');
        if is_hidden || path.extension().is_some_and(|ending| ending == "truth") {
            continue;
        }
        if let Some(kind) = DriveKind::of(&path) {
            let name = tidy(&name);
            drives.push(Drive { name, path, kind });
        } else if path.is_dir() && depth > 0 {
            search(&path, &name, depth - 1, drives)?;
        }
    }
    Ok(())
}
