//! Wheel readings from a log of can-utils' `candump`.
//!
//! In: the log's lines, as [`LoggedFrame`] reads them. Out: wheel readings with stamps in whole microseconds, the configured
//! offset added. Invariant: the readings' stamps never fall: a reading earlier than
//! the one before it is left out and counted, one that is over a second earlier is an error (two logs in one file).
//! The whole log is read and decoded at the start, 72 bytes a reading; a line that is none is an error that names it.

use std::fs::File;
use std::io::{BufRead, BufReader, Error};
use std::path::{Path, PathBuf};

use freespace::port::WheelPort;
use freespace::space::Micros;
use freespace::track::WheelReading;

use super::candump_line::{FrameKind, LineFault, LoggedFrame};
use super::{DecodeFault, WheelDecoder};

/// How far a stamp may fall before the log counts as broken: the buses of one log are merged within a few milliseconds.
const STEP_BACK_MICROS: u64 = 1_000_000;
/// How much of a wrong line an error repeats, characters.
const SHOWN: usize = 60;

/// What must be known to read a log.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CandumpOptions {
    /// Only frames of this interface, such as `can0`; all where there is none.
    pub interface: Option<String>,
    /// Added to every stamp: brings the log's time to that of the frames.
    pub offset_micros: i64,
}

/// Why a log is refused.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum CandumpError {
    /// The file cannot be read.
    #[error("{file}: the CAN log cannot be read: {error}", file = .file.display())]
    #[diagnostic(help("give the path of a log made by `candump -l` or `candump -L`"))]
    Read {
        /// The log.
        file: PathBuf,
        /// The system's words.
        error: Error,
    },
    /// A line that candump did not write.
    #[error("{file}, line {line}: {fault}: \"{text}\"", file = .file.display())]
    #[diagnostic(help(
        "remove line {line}, or record again with `candump -L`; a line reads (SECONDS.MICROS) IFACE ID#HEX"
    ))]
    Line {
        /// The log.
        file: PathBuf,
        /// One-based.
        line: u64,
        /// What is wrong.
        fault: LineFault,
        /// The line's beginning.
        text: String,
    },
    /// Time goes back by more than a second.
    #[error("{file}, line {line}: the stamp goes back by {back_micros} us", file = .file.display())]
    #[diagnostic(help("the file seems to hold two recordings: split it before line {line}"))]
    Backwards {
        /// The log.
        file: PathBuf,
        /// One-based.
        line: u64,
        /// How far.
        back_micros: u64,
    },
    /// Nothing about the wheels.
    #[error("{file}: none of its {frames} frames gives a wheel reading (identifier {id:#X}, {matching} frames, {refused} refused)", file = .file.display())]
    #[diagnostic(help(
        "check the message in the wheels' DBC mapping, the interface, and the time offset ({before_start} readings lie before time zero)"
    ))]
    NoReading {
        /// The log.
        file: PathBuf,
        /// Frames in the log.
        frames: u64,
        /// The wheel message's identifier.
        id: u32,
        /// Frames with it.
        matching: u64,
        /// Of these, frames that could not be decoded.
        refused: u64,
        /// Of these, readings whose stamp lies before zero.
        before_start: u64,
    },
}

/// What a log held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CandumpSummary {
    /// Frames of any kind, on the chosen interface.
    pub frames: u64,
    /// Wheel messages.
    pub matching: u64,
    /// Wheel messages shorter than their signals.
    pub short: u64,
    /// Wheel messages with a fault flag set.
    pub flagged: u64,
    /// Wheel messages with a speed beyond the DBC's range.
    pub out_of_range: u64,
    /// Wheel messages with a wrong check sum.
    pub checksum: u64,
    /// Wheel messages whose alive counter stands still.
    pub counter_stuck: u64,
    /// Wheel messages whose alive counter leaps.
    pub counter_jumped: u64,
    /// Readings left out because their stamp is earlier than the one before.
    pub stamps_back: u64,
    /// Readings left out because the offset moves them before time zero.
    pub before_start: u64,
    /// Readings kept.
    pub readings: u64,
}

impl CandumpSummary {
    /// Wheel messages that gave no reading, for what they say themselves.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.short
            + self.flagged
            + self.out_of_range
            + self.checksum
            + self.counter_stuck
            + self.counter_jumped
    }
}

/// The wheel readings of a log.
#[derive(Clone, Debug)]
pub struct CandumpWheels {
    readings: Box<[WheelReading]>,
    next: usize,
    summary: CandumpSummary,
}

impl CandumpWheels {
    /// Reads and decodes a whole log.
    ///
    /// # Errors
    /// An unreadable file, a line that candump did not write, time that goes back, or no wheel reading at all.
    pub fn open(path: &Path, decoder: &WheelDecoder, options: &CandumpOptions) -> Result<Self, CandumpError> {
        let read = |error| CandumpError::Read {
            file: path.to_owned(),
            error,
        };
        let mut lines = BufReader::new(File::open(path).map_err(read)?);
        let mut log = Log {
            path,
            decoder: decoder.clone(),
            options,
            readings: Vec::new(),
            summary: CandumpSummary::default(),
        };
        let mut bytes = Vec::new();
        let mut line = 0;
        while lines.read_until(b'\n', &mut bytes).map_err(read)? > 0 {
            line += 1;
            log.line(line, &String::from_utf8_lossy(&bytes))?;
            bytes.clear();
        }
        log.finish()
    }

    /// What the log held.
    #[must_use]
    pub const fn summary(&self) -> &CandumpSummary {
        &self.summary
    }

    /// All readings, by their stamps.
    #[must_use]
    pub fn readings(&self) -> &[WheelReading] {
        &self.readings
    }
}

impl WheelPort for CandumpWheels {
    fn readings_until(&mut self, until: Micros, out: &mut dyn FnMut(WheelReading)) {
        while let Some(reading) = self
            .readings
            .get(self.next)
            .filter(|reading| reading.stamp() <= until)
        {
            out(*reading);
            self.next += 1;
        }
    }
}

/// A log being read.
struct Log<'a> {
    path: &'a Path,
    decoder: WheelDecoder,
    options: &'a CandumpOptions,
    readings: Vec<WheelReading>,
    summary: CandumpSummary,
}

impl Log<'_> {
    fn line(&mut self, line: u64, text: &str) -> Result<(), CandumpError> {
        if text.trim().is_empty() {
            return Ok(());
        }
        let frame = LoggedFrame::parse(text).map_err(|fault| CandumpError::Line {
            file: self.path.to_owned(),
            line,
            fault,
            text: text
                .trim()
                .chars()
                .filter(|character| !character.is_control())
                .take(SHOWN)
                .collect(),
        })?;
        if (self.options.interface.as_deref()).is_some_and(|interface| interface != frame.interface) {
            return Ok(());
        }
        self.summary.frames += 1;
        if matches!(frame.kind, FrameKind::Data | FrameKind::Fd) {
            self.frame(line, &frame)?;
        }
        Ok(())
    }

    fn frame(&mut self, line: u64, frame: &LoggedFrame<'_>) -> Result<(), CandumpError> {
        // The decoder never looks at the stamp, so the logged one may lie before time zero.
        let stamp = frame.stamp.0.checked_add_signed(self.options.offset_micros);
        let shifted = Micros(stamp.unwrap_or(0));
        let summary = &mut self.summary;
        let Some(decoded) = self
            .decoder
            .decode(frame.id, frame.is_extended, frame.data(), shifted)
        else {
            return Ok(());
        };
        summary.matching += 1;
        let reading = match decoded {
            Ok(reading) => reading,
            Err(fault) => {
                *match fault {
                    DecodeFault::Short => &mut summary.short,
                    DecodeFault::Flagged => &mut summary.flagged,
                    DecodeFault::OutOfRange => &mut summary.out_of_range,
                    DecodeFault::Checksum => &mut summary.checksum,
                    DecodeFault::CounterStuck => &mut summary.counter_stuck,
                    DecodeFault::CounterJumped => &mut summary.counter_jumped,
                } += 1;
                return Ok(());
            }
        };
        if stamp.is_none() {
            summary.before_start += 1;
            return Ok(());
        }
        let back_micros = self.readings.last().map_or(0, |last| last.stamp().since(shifted));
        if back_micros > STEP_BACK_MICROS {
            return Err(CandumpError::Backwards {
                file: self.path.to_owned(),
                line,
                back_micros,
            });
        }
        if back_micros > 0 {
            summary.stamps_back += 1;
        } else {
            self.readings.push(reading);
        }
        Ok(())
    }

    fn finish(self) -> Result<CandumpWheels, CandumpError> {
        let mut summary = self.summary;
        summary.readings = self.readings.len() as u64;
        if self.readings.is_empty() {
            return Err(CandumpError::NoReading {
                file: self.path.to_owned(),
                frames: summary.frames,
                id: self.decoder.id().0,
                matching: summary.matching,
                refused: summary.refused(),
                before_start: summary.before_start,
            });
        }
        Ok(CandumpWheels {
            readings: self.readings.into_boxed_slice(),
            next: 0,
            summary,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
    use super::*;
    use crate::wheels::WheelMapping;
    use miette::Diagnostic;
    use std::fs;

    const DBC: &str = concat!(
        "VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: ABS\n\n",
        "BO_ 903 PULSES: 4 ABS\n",
        " SG_ FL : 0|8@1+ (0.5,0) [0|127.5] \"\" ABS\n",
        " SG_ FR : 8|8@1+ (0.5,0) [0|127.5] \"\" ABS\n",
        " SG_ RL : 16|8@1+ (0.5,0) [0|127.5] \"\" ABS\n",
        " SG_ RR : 24|8@1+ (0.5,0) [0|127.5] \"\" ABS\n",
    );

    /// Writes a log, opens it, removes it.
    fn open(name: &str, log: &str, options: &CandumpOptions) -> Result<CandumpWheels, CandumpError> {
        let text = "message = \"PULSES\"\nkind = \"counts\"\nsignals = [\"FL\", \"FR\", \"RL\", \"RR\"]";
        let mapping: WheelMapping = toml::from_str(text).unwrap();
        let decoder = WheelDecoder::new(Path::new("pulses.dbc"), DBC, &mapping).unwrap();
        assert_eq!(decoder.counter_modulus(), Some(256));
        let path = std::env::temp_dir().join(format!("freespace-{name}-{}.candump", std::process::id()));
        fs::write(&path, log).unwrap();
        let wheels = CandumpWheels::open(&path, &decoder, options);
        fs::remove_file(&path).unwrap();
        wheels
    }

    #[test]
    fn readings_come_out_once_and_in_time() {
        let log = "(10.000001) can0 387#01020304\n(10.010000) can0 100#FF\n(10.020000) can0 387#11121314\n\n(10.030000) can1 387#21222324\n";
        let mut wheels = open("order", log, &CandumpOptions::default()).unwrap();
        let mut seen = Vec::new();
        wheels.readings_until(Micros(10_000_000), &mut |reading| seen.push(reading));
        assert!(seen.is_empty());
        wheels.readings_until(Micros(10_020_000), &mut |reading| seen.push(reading));
        wheels.readings_until(Micros(10_020_000), &mut |reading| seen.push(reading));
        assert_eq!(seen.len(), 2);
        let first = WheelReading::Counts {
            stamp: Micros(10_000_001),
            counts: [1, 2, 3, 4],
            direction: [0; 4],
        };
        assert_eq!(seen[0], first);
        assert_eq!(wheels.summary().readings, 3);

        let only = CandumpOptions {
            interface: Some("can1".to_owned()),
            ..CandumpOptions::default()
        };
        assert_eq!(open("interface", log, &only).unwrap().summary().readings, 1);
    }

    #[test]
    fn the_offset_moves_stamps_exactly_and_what_lies_before_zero_is_left_out() {
        let log = "(1700000000.000313) can0 387#00000000\n(1700000000.020449) can0 387#01010101\n";
        let options = CandumpOptions {
            interface: None,
            offset_micros: -1_700_000_000_000_400,
        };
        let wheels = open("offset", log, &options).unwrap();
        assert_eq!(wheels.readings()[0].stamp(), Micros(20_049));
        assert_eq!(wheels.summary().before_start, 1);
    }

    #[test]
    fn short_frames_and_small_steps_back_are_counted_a_large_one_is_an_error() {
        let log = "(10.0) can0 387#01020304\n(10.02) can0 387#0102\n(9.99) can0 387#05060708\n(10.04) can0 387#11121314\n";
        let wheels = open("counted", log, &CandumpOptions::default()).unwrap();
        let summary = wheels.summary();
        assert_eq!((summary.short, summary.stamps_back, summary.readings), (1, 1, 2));

        let error = open(
            "back",
            "(10.0) can0 387#01020304\n(2.0) can0 387#01020304\n",
            &CandumpOptions::default(),
        );
        assert!(
            matches!(
                error,
                Err(CandumpError::Backwards {
                    line: 2,
                    back_micros: 8_000_000,
                    ..
                })
            ),
            "{error:?}"
        );
    }

    #[test]
    fn a_garbage_line_is_an_error_that_names_file_line_and_fix() {
        let log = "(10.0) can0 387#01020304\n(10.02) can0 387#0102030\n";
        let error = open("garbage", log, &CandumpOptions::default()).unwrap_err();
        let message = error.to_string();
        assert!(
            message.contains(".candump, line 2") && message.contains("387#0102030"),
            "{message}"
        );
        assert!(error.help().unwrap().to_string().contains("remove line 2"));
        let binary = open("binary", "\u{0}\u{1}ELF\u{fffd}", &CandumpOptions::default()).unwrap_err();
        assert!(binary.to_string().contains("line 1"), "{binary}");
    }

    #[test]
    fn a_log_without_wheels_is_an_error_that_tells_what_was_looked_for() {
        let error = open(
            "nothing",
            "(10.0) can0 100#01020304\n",
            &CandumpOptions::default(),
        )
        .unwrap_err();
        let message = error.to_string();
        assert!(
            message.contains("none of its 1 frames") && message.contains("0x387"),
            "{message}"
        );
    }
}
