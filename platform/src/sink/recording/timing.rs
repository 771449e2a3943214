//! `timing.csv`: a row a key frame, a column a stage.
//!
//! Written as the run goes on and read again for the page, so that no row is kept in memory. A name may hold a comma: columns
//! are counted from the right.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use freespace::stage::Stage;
use serde::Serialize;

use super::folder::LineFile;
use super::trajectory::Seconds;
use super::{KeyFrameRecord, RecordingError};

/// The file under way.
#[derive(Debug)]
pub(super) struct TimingFile {
    file: LineFile,
    rows: usize,
}

impl TimingFile {
    /// Writes the heading.
    pub(super) fn new(mut file: LineFile) -> Result<Self, RecordingError> {
        let stages: String = Stage::ALL
            .iter()
            .map(|stage| format!(",{}_ms", stage.name()))
            .collect();
        file.line(format_args!(
            "name,stamp_s,publish_latency_ms,level,deadline_met{stages}"
        ))?;
        Ok(Self { file, rows: 0 })
    }

    /// Writes a key frame's row.
    #[expect(clippy::cast_precision_loss, reason = "microseconds of one key frame")]
    pub(super) fn key_frame(&mut self, record: &KeyFrameRecord<'_>) -> Result<(), RecordingError> {
        let times = record
            .times
            .0
            .map(|micros| format!(",{:.3}", micros as f64 * 1e-3));
        // Without a latency there is no deadline either.
        let (latency, met) = record.publish_latency_ms.map_or_else(Default::default, |ms| {
            (format!("{ms:.3}"), u8::from(record.deadline_met).to_string())
        });
        self.rows += 1;
        self.file.line(format_args!(
            "{},{},{latency},{},{met}{}",
            record.name,
            Seconds(record.stamp),
            record.level,
            times.concat()
        ))
    }

    /// Writes what is still held.
    pub(super) fn finish(&mut self) -> Result<(), RecordingError> {
        self.file.finish()
    }

    /// Rows written.
    pub(super) const fn rows(&self) -> usize {
        self.rows
    }
}

/// A row, as the page shows it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Row {
    pub(super) name: String,
    pub(super) time: String,
    pub(super) latency_ms: Option<f64>,
    pub(super) level: String,
    pub(super) met: bool,
    pub(super) stages_ms: Vec<f64>,
}

impl Row {
    fn parse(line: &str) -> Option<Self> {
        let mut columns = line.rsplitn(5 + Stage::ALL.len(), ',');
        let mut stages_ms: Vec<f64> = Vec::with_capacity(Stage::ALL.len());
        for _ in Stage::ALL {
            stages_ms.push(columns.next()?.parse().ok()?);
        }
        stages_ms.reverse();
        Some(Self {
            met: columns.next()? != "0",
            level: columns.next()?.to_owned(),
            latency_ms: match columns.next()? {
                "" => None,
                text => Some(text.parse().ok()?),
            },
            time: columns.next()?.to_owned(),
            name: columns.next()?.to_owned(),
            stages_ms,
        })
    }
}

/// The rows of a finished file, one at a time.
pub(super) fn rows(path: &Path) -> Result<impl Iterator<Item = Row>, RecordingError> {
    let file = File::open(path).map_err(|error| RecordingError::write(path, error))?;
    let lines = BufReader::new(file).lines().skip(1);
    Ok(lines.map_while(Result::ok).filter_map(|line| Row::parse(&line)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn a_name_may_hold_a_comma() {
        let row = Row::parse("a,b,0.500000,45.250,full,1,0.1,2,3,4,5,6,7,8").unwrap();
        assert_eq!((row.name.as_str(), row.time.as_str()), ("a,b", "0.500000"));
        assert_eq!((row.latency_ms, row.met), (Some(45.25), true));
        assert_eq!(row.stages_ms, [0.1, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
        let untimed = Row::parse("a,0.500000,,full,,0.1,2,3,4,5,6,7,8").unwrap();
        assert_eq!((untimed.latency_ms, untimed.met), (None, true));
        assert_eq!(Row::parse("name,1,2"), None);
    }
}
