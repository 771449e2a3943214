//! The output folder: taken safely, filled beside its final place, published at the end.

use std::fmt;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ColorType, ImageEncoder};

use super::RecordingError;
use crate::bad_input::BadInput;

/// Where files lie until the run is finished.
const PARTIAL: &str = ".partial";

/// Folders and files of a recording; the report is last, for it says that the recording is complete.
const ENTRIES: [&str; 13] = [
    "masks",
    "overlays",
    "birdseye",
    "grids",
    "truth",
    "emitted.candump",
    "trajectory.kitti",
    "trajectory.tum",
    "timing.csv",
    "scores.csv",
    "latency.png",
    "index.html",
    "report.json",
];

/// A folder that a recording is written to; dropped before [`OutputFolder::publish`], it leaves nothing behind.
#[derive(Debug)]
pub(super) struct OutputFolder {
    dir: PathBuf,
    partial: PathBuf,
    created: bool,
    /// Locked: no other run fills the same folder. It goes last.
    _lock: File,
}

impl OutputFolder {
    pub(super) fn create(dir: &Path) -> Result<Self, RecordingError> {
        let created = !dir.exists();
        if !created {
            check_ours(dir)?;
        }
        let partial = dir.join(PARTIAL);
        let refused = |error: io::Error| {
            let fix = "name a folder after --out that you may write to";
            BadInput::of_file(dir, format!("cannot be made: {error}"), fix)
        };
        fs::create_dir_all(dir).map_err(refused)?;
        let lock = locked(dir)?;
        if partial.exists() {
            fs::remove_dir_all(&partial).map_err(refused)?;
        }
        for name in ["masks", "overlays", "birdseye", "grids"] {
            fs::create_dir_all(partial.join(name)).map_err(refused)?;
        }
        Ok(Self {
            dir: dir.to_owned(),
            partial,
            created,
            _lock: lock,
        })
    }

    /// Where an entry lies until it is published.
    pub(super) fn partial(&self, name: &str) -> PathBuf {
        self.partial.join(name)
    }

    pub(super) fn file(&self, name: &str, bytes: &[u8]) -> Result<(), RecordingError> {
        let path = self.prepared(name)?;
        fs::write(&path, bytes).map_err(|error| RecordingError::write(&path, error))
    }

    /// A file that is written as the run goes on.
    pub(super) fn lines(&self, name: &str) -> Result<LineFile, RecordingError> {
        let path = self.prepared(name)?;
        match File::create(&path) {
            Ok(file) => Ok(LineFile {
                file: BufWriter::new(file),
                path,
            }),
            Err(error) => Err(RecordingError::write(&path, error)),
        }
    }

    /// The path of a file whose folder exists.
    fn prepared(&self, name: &str) -> Result<PathBuf, RecordingError> {
        let path = self.partial.join(name);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|error| RecordingError::write(folder, error))?;
        }
        Ok(path)
    }

    pub(super) fn read(&self, name: &str) -> Option<Vec<u8>> {
        fs::read(self.partial.join(name)).ok()
    }

    pub(super) fn png(
        &self,
        name: &str,
        pixels: &[u8],
        width: usize,
        height: usize,
        color: ColorType,
    ) -> Result<(), RecordingError> {
        let path = self.prepared(name)?;
        let fault = |error: io::Error| RecordingError::write(&path, error);
        let file = BufWriter::new(File::create(&path).map_err(fault)?);
        let size = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
        PngEncoder::new_with_quality(file, CompressionType::Fast, FilterType::Up)
            .write_image(pixels, size(width), size(height), color.into())
            .map_err(|error| fault(io::Error::other(error)))
    }

    /// Replaces an earlier recording by this one.
    pub(super) fn publish(&mut self) -> Result<(), RecordingError> {
        for name in ENTRIES.iter().rev() {
            let old = self.dir.join(name);
            let removed = if old.is_dir() {
                fs::remove_dir_all(&old)
            } else if old.exists() {
                fs::remove_file(&old)
            } else {
                Ok(())
            };
            removed.map_err(|error| RecordingError::write(&old, error))?;
        }
        // Only a simulated drive has a truth; all else is there.
        for name in ENTRIES.iter().filter(|name| self.partial.join(name).exists()) {
            let path = self.dir.join(name);
            fs::rename(self.partial.join(name), &path)
                .map_err(|error| RecordingError::write(&path, error))?;
        }
        self.created = false;
        Ok(())
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        // Best effort: what cannot be removed here is removed by the next run into this folder.
        let _ = fs::remove_dir_all(&self.partial);
        if self.created {
            let _ = fs::remove_dir(&self.dir);
        }
    }
}

/// A file that grows with the run; what is held of it in memory is one buffer.
#[derive(Debug)]
pub(super) struct LineFile {
    file: BufWriter<File>,
    path: PathBuf,
}

impl LineFile {
    /// Writes a line.
    pub(super) fn line(&mut self, line: fmt::Arguments<'_>) -> Result<(), RecordingError> {
        writeln!(self.file, "{line}").map_err(|error| self.fault(error))
    }

    /// Writes what the buffer still holds.
    pub(super) fn finish(&mut self) -> Result<(), RecordingError> {
        self.file.flush().map_err(|error| self.fault(error))
    }

    /// An error of this file.
    pub(super) fn fault(&self, error: io::Error) -> RecordingError {
        RecordingError::write(&self.path, error)
    }
}

impl Write for LineFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// The folder, locked by this run for as long as it is open; where locks are not to be had, open alone.
fn locked(dir: &Path) -> Result<File, BadInput> {
    let folder = File::open(dir).map_err(|error| {
        let fix = "name a folder after --out that you may write to";
        BadInput::of_file(dir, format!("cannot be used as a folder: {error}"), fix)
    })?;
    match folder.try_lock() {
        Err(TryLockError::WouldBlock) => Err(BadInput::of_file(
            dir,
            "is being written to by another run",
            "name another folder after --out, or wait until that run has ended",
        )),
        _ => Ok(folder),
    }
}

/// Refuses a folder with foreign files in it: publishing replaces what is there.
fn check_ours(dir: &Path) -> Result<(), BadInput> {
    let fix = "name a new or empty folder after --out, or one that holds an earlier run";
    let listing = fs::read_dir(dir)
        .map_err(|error| BadInput::of_file(dir, format!("cannot be used as a folder: {error}"), fix))?;
    let names: Vec<String> = listing
        .filter_map(Result::ok)
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name != PARTIAL)
        .collect();
    if let Some(foreign) = names.iter().find(|name| !ENTRIES.contains(&name.as_str())) {
        return Err(BadInput::of_file(
            dir,
            format!("is not empty, and `{foreign}` in it belongs to no earlier run"),
            fix,
        ));
    }
    if !names.is_empty() && !names.iter().any(|name| name == "report.json") {
        return Err(BadInput::of_file(
            dir,
            "is not empty, and has no report.json of an earlier run",
            fix,
        ));
    }
    Ok(())
}
