//! Files that are there whole or not at all.
//!
//! Written beside their final place, brought to the disk, and renamed: a process that is killed leaves an old file or none.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// A file could not be written: the disk is full, or its folder may not be written to.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{path}: cannot be written: {source}")]
#[diagnostic(help("check that the disk has room, and that its folder is there and may be written to"))]
pub struct WriteError {
    path: String,
    source: io::Error,
}

/// Writes a file, or replaces it, as one step.
///
/// # Errors
/// Where it cannot be written; what was there before is still there then.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    let unfinished = beside(path);
    let written = write_through(&unfinished, bytes).and_then(|()| fs::rename(&unfinished, path));
    written.map_err(|source| {
        // Best effort: what is left is hidden, and replaced by the next attempt of this process.
        let _ = fs::remove_file(&unfinished);
        WriteError {
            path: path.display().to_string(),
            source,
        }
    })
}

/// A hidden name in the same folder, which no other process uses.
fn beside(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.{}", std::process::id()))
}

fn write_through(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}
