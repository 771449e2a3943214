//! `scores.csv`: how well each key frame whose truth is known agrees with it.
//!
//! A row a key frame, its name and an intersection over union: of the free cells 0 to 30 m ahead where a simulated drive knows
//! its grid, of the road's pixels where a replay has labelled frames. Written as the run goes on and read again for the page. A
//! name may hold a comma: the number is the last column.

use std::collections::BTreeMap;
use std::path::Path;

use super::RecordingError;
use super::folder::{LineFile, OutputFolder};

/// What a score compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScoreOf {
    /// Free cells of the grid.
    FreeSpace,
    /// Road pixels.
    Road,
}

impl ScoreOf {
    const fn column(self) -> &'static str {
        match self {
            Self::FreeSpace => "free_space_iou",
            Self::Road => "road_iou",
        }
    }
}

/// The file under way; made with its first row.
#[derive(Debug, Default)]
pub(super) struct ScoresFile(Option<LineFile>);

impl ScoresFile {
    /// Writes a key frame's row.
    pub(super) fn score(
        &mut self,
        folder: &OutputFolder,
        name: &str,
        of: ScoreOf,
        iou: f64,
    ) -> Result<(), RecordingError> {
        if self.0.is_none() {
            let mut file = folder.lines("scores.csv")?;
            file.line(format_args!("name,{}", of.column()))?;
            self.0 = Some(file);
        }
        self.0
            .as_mut()
            .map_or(Ok(()), |file| file.line(format_args!("{name},{iou:.6}")))
    }

    /// Writes what is still held.
    pub(super) fn finish(&mut self) -> Result<(), RecordingError> {
        self.0.as_mut().map_or(Ok(()), LineFile::finish)
    }
}

/// Scores by name.
pub(super) type Scores = BTreeMap<String, f64>;

/// The rows of a finished file; none where there is no file.
pub(super) fn read(path: &Path) -> Result<Scores, RecordingError> {
    if !path.exists() {
        return Ok(Scores::new());
    }
    let text = std::fs::read_to_string(path).map_err(|error| RecordingError::write(path, error))?;
    let rows = text.lines().skip(1).filter_map(|row| {
        let (name, iou) = row.rsplit_once(',')?;
        Some((name.to_owned(), iou.parse().ok()?))
    });
    Ok(rows.collect())
}
