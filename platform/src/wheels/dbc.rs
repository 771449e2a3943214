//! Decodes wheel messages as a DBC file describes them.
//!
//! In: a DBC text and a [`WheelMapping`] at start-up, then CAN frames. Out: a [`WheelReading`] a wheel message: raw counters
//! (never scaled: they wrap at a power of two), or speeds in metres a second. Invariant: a signal lies within the message's
//! stated length, and a shorter frame is a fault. Cost: at most 16 signals of at most 64 bits a frame, no allocation.

use std::fs;
use std::path::{Path, PathBuf};

use can_dbc::{Dbc, Message, MessageId, MultiplexIndicator, Signal};
use freespace::space::Micros;
use freespace::track::WheelReading;
use serde::Deserialize;

use super::integrity::{AliveCounter, Checksum, ChecksumAlgorithm, ChecksumMapping};
use super::signal::Field;

/// How many like names an error lists.
const NAMES_LISTED: usize = 12;

/// What the four signals carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WheelKind {
    /// Counters of encoder edges that wrap around.
    Counts,
    /// Speeds.
    Speeds,
}

/// Unit of a speed signal, where the DBC states none or a wrong one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum SpeedUnit {
    /// Kilometres an hour.
    #[serde(rename = "km/h")]
    KilometresAnHour,
    /// Miles an hour.
    #[serde(rename = "mph")]
    MilesAnHour,
    /// Metres a second.
    #[serde(rename = "m/s")]
    MetresASecond,
}

impl SpeedUnit {
    /// Metres a second in one of this unit; exact by definition of the mile (1609.344 m).
    #[must_use]
    pub const fn mps(self) -> f64 {
        match self {
            Self::KilometresAnHour => 1.0 / 3.6,
            Self::MilesAnHour => 0.44704,
            Self::MetresASecond => 1.0,
        }
    }

    /// As DBC files spell them.
    fn of_dbc(unit: &str) -> Option<Self> {
        match unit.trim().to_ascii_lowercase().as_str() {
            "km/h" | "kph" | "kmh" | "kmph" => Some(Self::KilometresAnHour),
            "mph" | "mi/h" => Some(Self::MilesAnHour),
            "m/s" | "mps" => Some(Self::MetresASecond),
            _ => None,
        }
    }
}

/// Which message and signals tell of the wheels; names in the order front left, front right, rear left, rear right.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WheelMapping {
    /// The message's name in the DBC.
    pub message: String,
    /// Counter or speed signals.
    pub signals: [String; 4],
    /// Direction signals, where the message has them.
    #[serde(default)]
    pub directions: Option<[String; 4]>,
    /// Fault flags, where the message has them: a reading with one set is refused.
    #[serde(default)]
    pub faults: Option<[String; 4]>,
    /// Alive counter of the message, where it has one: a reading is refused where it stands still or leaps.
    #[serde(default)]
    pub counter: Option<String>,
    /// Check sum of the message, where it has one: a reading is refused where it is wrong.
    #[serde(default)]
    pub checksum: Option<ChecksumMapping>,
    /// Counters or speeds.
    pub kind: WheelKind,
    /// Unit of the speeds instead of the DBC's.
    #[serde(default)]
    pub unit: Option<SpeedUnit>,
    /// Raw value of a direction signal that means ahead.
    #[serde(default = "ahead")]
    pub direction_ahead: u64,
    /// Raw value of a direction signal that means back.
    #[serde(default = "back")]
    pub direction_back: u64,
}

const fn ahead() -> u64 {
    1
}

const fn back() -> u64 {
    2
}

/// Why a mapping does not fit its DBC file.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum MappingError {
    /// The DBC file cannot be read.
    #[error("{file}: the DBC file cannot be read: {error}", file = .file.display())]
    #[diagnostic(help("give the path of the vehicle's DBC file"))]
    Read {
        /// The DBC file.
        file: PathBuf,
        /// The system's words.
        error: std::io::Error,
    },
    /// The text is no DBC.
    #[error("{file}: not a DBC file: {detail}", file = .file.display())]
    #[diagnostic(help("correct the line named there; the file must hold BO_ and SG_ entries"))]
    Syntax {
        /// The DBC file.
        file: PathBuf,
        /// The parser's words.
        detail: String,
    },
    /// No such message.
    #[error("{file}: no message {message}; messages like it: {like}", file = .file.display())]
    #[diagnostic(help("set the wheels' message to one of the file's"))]
    UnknownMessage {
        /// The DBC file.
        file: PathBuf,
        /// The name asked for.
        message: String,
        /// Names in the file.
        like: String,
    },
    /// No such signal.
    #[error("{file}: message {message} has no signal {signal}; its signals: {known}", file = .file.display())]
    #[diagnostic(help("set the wheels' signals to those of {message}"))]
    UnknownSignal {
        /// The DBC file.
        file: PathBuf,
        /// The message.
        message: String,
        /// The name asked for.
        signal: String,
        /// Names in the message, the likest first.
        known: String,
    },
    /// The signal is there but cannot be used so.
    #[error("{file}: signal {message}.{signal}: {problem}", file = .file.display())]
    #[diagnostic(help("{fix}"))]
    Unusable {
        /// The DBC file.
        file: PathBuf,
        /// The message.
        message: String,
        /// The signal.
        signal: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        fix: &'static str,
    },
}

/// Why a wheel message gave no reading; the caller counts it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[error("{}", self.name())]
pub enum DecodeFault {
    /// Fewer bytes than the signals need.
    Short,
    /// The car's own fault flag of a wheel is set.
    Flagged,
    /// A speed beyond the DBC's range: the code for "not available" lies there.
    OutOfRange,
    /// The message is damaged, or another sender's.
    Checksum,
    /// The message is the last one again.
    CounterStuck,
    /// More messages are missing than may be lost, or two senders take turns.
    CounterJumped,
}

impl DecodeFault {
    /// The words of its display, without allocation.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Short => "shorter than its signals need",
            Self::Flagged => "a wheel's fault flag is set",
            Self::OutOfRange => "a speed beyond the range of the DBC",
            Self::Checksum => "the check sum is wrong",
            Self::CounterStuck => "the alive counter stands still",
            Self::CounterJumped => "the alive counter leaps",
        }
    }
}

/// Decodes one message into wheel readings.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelDecoder {
    id: u32,
    is_extended: bool,
    /// Bytes that hold every signal read.
    bytes_needed: usize,
    kind: WheelKind,
    values: [Field; 4],
    directions: Option<[Field; 4]>,
    faults: Option<[Field; 4]>,
    checksum: Option<Checksum>,
    counter: Option<(Field, AliveCounter)>,
    mps_per_unit: f64,
    direction_ahead: u64,
    direction_back: u64,
}

impl WheelDecoder {
    /// Reads a DBC file and makes a decoder of it.
    ///
    /// # Errors
    /// An unreadable or malformed file, an unknown message or signal, or a signal that cannot be used.
    pub fn open(dbc: &Path, mapping: &WheelMapping) -> Result<Self, MappingError> {
        let text = fs::read(dbc).map_err(|error| MappingError::Read {
            file: dbc.to_owned(),
            error,
        })?;
        // DBC files are often Latin-1: names are ASCII, so what is lost lies in comments.
        Self::new(dbc, &String::from_utf8_lossy(&text), mapping)
    }

    /// Makes a decoder of a DBC text; `file` is what errors name.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn new(file: &Path, text: &str, mapping: &WheelMapping) -> Result<Self, MappingError> {
        let dbc = Dbc::try_from(text).map_err(|error| MappingError::Syntax {
            file: file.to_owned(),
            detail: error.to_string(),
        })?;
        let message = (dbc
            .messages
            .iter()
            .find(|message| message.name == mapping.message))
        .ok_or_else(|| unknown_message(file, &dbc, &mapping.message))?;
        let source = Source {
            file,
            dbc: &dbc,
            message,
        };

        let values = source.fields(&mapping.signals)?;
        let directions = (mapping.directions.as_ref())
            .map(|names| source.fields(names))
            .transpose()?;
        let faults = (mapping.faults.as_ref())
            .map(|names| source.fields(names))
            .transpose()?;
        let mps_per_unit = match mapping.kind {
            WheelKind::Counts => {
                source.check_counters(&mapping.signals, &values)?;
                0.0
            }
            WheelKind::Speeds => source.unit(&mapping.signals, mapping.unit)?.mps(),
        };
        let id = message.id.raw() & 0x1fff_ffff;
        let checksum = (mapping.checksum.as_ref())
            .map(|checksum| source.checksum(checksum, id))
            .transpose()?;
        let counter = (mapping.counter.as_ref())
            .map(|name| source.alive_counter(name))
            .transpose()?;
        let all = (values.iter())
            .chain(directions.iter().flatten())
            .chain(faults.iter().flatten())
            .chain(counter.iter().map(|(field, _)| field));
        let covered = checksum.map_or(0, |checksum| checksum.length);
        Ok(Self {
            id,
            is_extended: matches!(message.id, MessageId::Extended(_)),
            bytes_needed: all.map(Field::bytes_needed).max().unwrap_or(0).max(covered),
            kind: mapping.kind,
            values,
            directions,
            faults,
            checksum,
            counter,
            mps_per_unit,
            direction_ahead: mapping.direction_ahead,
            direction_back: mapping.direction_back,
        })
    }

    /// Identifier of the wheel message, and whether it is an extended one.
    #[must_use]
    pub const fn id(&self) -> (u32, bool) {
        (self.id, self.is_extended)
    }

    /// Value at which the counters wrap; nothing for speeds.
    #[must_use]
    pub fn counter_modulus(&self) -> Option<u64> {
        (self.kind == WheelKind::Counts).then(|| 1 << self.values[0].size)
    }

    /// The reading of a frame; nothing where the frame is another message.
    ///
    /// # Errors
    /// A frame that is too short, damaged, repeated, flagged as faulty by the car, or out of range.
    pub fn decode(
        &mut self,
        id: u32,
        is_extended: bool,
        data: &[u8],
        stamp: Micros,
    ) -> Option<Result<WheelReading, DecodeFault>> {
        (id == self.id && is_extended == self.is_extended).then(|| self.reading(data, stamp))
    }

    fn reading(&mut self, data: &[u8], stamp: Micros) -> Result<WheelReading, DecodeFault> {
        if data.len() < self.bytes_needed {
            return Err(DecodeFault::Short);
        }
        if self.checksum.is_some_and(|checksum| !checksum.is_right(data)) {
            return Err(DecodeFault::Checksum);
        }
        if let Some((field, counter)) = &mut self.counter {
            counter.check(field.raw(data))?;
        }
        if self.faults.iter().flatten().any(|flag| flag.raw(data) != 0) {
            return Err(DecodeFault::Flagged);
        }
        let direction = (self.directions).map_or([0; 4], |fields| {
            fields.map(|field| self.direction(field.raw(data)))
        });
        if self.kind == WheelKind::Counts {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "counters have at most 32 bits, checked in new"
            )]
            let counts = self.values.map(|field| field.raw(data) as u32);
            return Ok(WheelReading::Counts {
                stamp,
                counts,
                direction,
            });
        }
        let mut mps = [0.0; 4];
        for (wheel, field) in self.values.iter().enumerate() {
            let speed = field.physical(data);
            if speed.abs() > field.limit || !speed.is_finite() {
                return Err(DecodeFault::OutOfRange);
            }
            // A speed without sign takes that of the direction signal.
            let is_back = direction[wheel] < 0 && speed > 0.0;
            mps[wheel] = if is_back { -speed } else { speed } * self.mps_per_unit;
        }
        Ok(WheelReading::Speeds { stamp, mps })
    }

    const fn direction(&self, raw: u64) -> i8 {
        if raw == self.direction_ahead {
            1
        } else if raw == self.direction_back {
            -1
        } else {
            0
        }
    }
}

/// The message that the mapping names.
struct Source<'a> {
    file: &'a Path,
    dbc: &'a Dbc,
    message: &'a Message,
}

impl Source<'_> {
    fn fields(&self, names: &[String; 4]) -> Result<[Field; 4], MappingError> {
        let [a, b, c, d] = names;
        Ok([self.field(a)?, self.field(b)?, self.field(c)?, self.field(d)?])
    }

    fn signal(&self, name: &str) -> Result<&Signal, MappingError> {
        (self.message.signals.iter().find(|signal| signal.name == name)).ok_or_else(|| {
            MappingError::UnknownSignal {
                file: self.file.to_owned(),
                message: self.message.name.clone(),
                signal: name.to_owned(),
                known: likest(
                    name,
                    self.message.signals.iter().map(|signal| signal.name.as_str()),
                ),
            }
        })
    }

    fn field(&self, name: &str) -> Result<Field, MappingError> {
        let signal = self.signal(name)?;
        if !matches!(signal.multiplexer_indicator, MultiplexIndicator::Plain) {
            let fix = "name a signal that every frame of the message carries";
            return Err(self.unusable(name, "it is multiplexed".to_owned(), fix));
        }
        let is_float = (self.dbc.signal_extended_value_type_list.iter()).any(|entry| {
            entry.message_id == self.message.id
                && entry.signal_name == name
                && entry.signal_extended_value_type
                    != can_dbc::SignalExtendedValueType::SignedOrUnsignedInteger
        });
        if is_float {
            return Err(self.unusable(
                name,
                "it is a floating-point signal".to_owned(),
                "name an integer signal",
            ));
        }
        let Some(field) = Field::of(signal) else {
            return Err(self.unusable(
                name,
                format!("{} bits at {} are no signal", signal.size, signal.start_bit),
                "correct the signal's start and length in the DBC",
            ));
        };
        if field.bytes_needed() as u64 > self.message.size {
            let problem = format!(
                "it ends in byte {}, the message has {}",
                field.bytes_needed(),
                self.message.size
            );
            let fix = "correct the signal's start and length in the DBC";
            return Err(self.unusable(name, problem, fix));
        }
        Ok(field)
    }

    /// A check sum is one whole byte.
    fn checksum(&self, mapping: &ChecksumMapping, id: u32) -> Result<Checksum, MappingError> {
        let field = self.field(&mapping.signal)?;
        let first_bit = if field.big_endian { 7 } else { 0 };
        let length = usize::try_from(self.message.size).unwrap_or(usize::MAX);
        let byte = field.start / 8;
        if field.size != 8 || field.start % 8 != first_bit {
            let problem = format!("{} bits at {} are no whole byte", field.size, field.start);
            return Err(self.unusable(&mapping.signal, problem, "name a check sum of one byte"));
        }
        if mapping.algorithm == ChecksumAlgorithm::Toyota && byte + 1 != length {
            let problem = format!("byte {byte} is not the last of {length}");
            let fix = "the sum of \"toyota\" is the last byte: name that, or another algorithm";
            return Err(self.unusable(&mapping.signal, problem, fix));
        }
        Ok(Checksum {
            algorithm: mapping.algorithm,
            data_id: mapping.data_id,
            id,
            byte,
            length,
        })
    }

    /// A counter wraps behind its largest value in the DBC, else behind that of its bits.
    fn alive_counter(&self, name: &str) -> Result<(Field, AliveCounter), MappingError> {
        let field = self.field(name)?;
        if field.signed || field.size > 16 {
            let problem = format!(
                "{} bits, signed: {}; a counter is unsigned, of at most 16 bits",
                field.size, field.signed
            );
            return Err(self.unusable(name, problem, "name the message's alive counter"));
        }
        let of_bits = 1_u64 << field.size;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to at most 16 bits"
        )]
        let stated = (field.limit / field.factor.abs()).clamp(0.0, 65_536.0) as u64 + 1;
        let modulus = if (2..of_bits).contains(&stated) {
            stated
        } else {
            of_bits
        };
        Ok((field, AliveCounter::new(modulus)))
    }

    fn check_counters(&self, names: &[String; 4], fields: &[Field; 4]) -> Result<(), MappingError> {
        for (name, field) in names.iter().zip(fields) {
            if field.signed || field.size > 32 || field.size != fields[0].size {
                let problem = format!(
                    "{} bits, signed: {}; a counter is unsigned, of at most 32 bits, alike on all wheels",
                    field.size, field.signed
                );
                return Err(self.unusable(name, problem, "name counter signals, or set kind = \"speeds\""));
            }
        }
        Ok(())
    }

    fn unit(&self, names: &[String; 4], stated: Option<SpeedUnit>) -> Result<SpeedUnit, MappingError> {
        if let Some(unit) = stated {
            return Ok(unit);
        }
        let unit = &self.signal(&names[0])?.unit;
        let mut others = names.iter().map(|name| self.signal(name));
        if others.any(|other| other.is_ok_and(|other| other.unit != *unit)) {
            let problem = "the four speeds have different units".to_owned();
            return Err(self.unusable(
                &names[0],
                problem,
                "set the wheels' unit to \"km/h\", \"mph\" or \"m/s\"",
            ));
        }
        SpeedUnit::of_dbc(unit).ok_or_else(|| {
            let problem = format!("its unit \"{unit}\" is no known speed");
            self.unusable(
                &names[0],
                problem,
                "set the wheels' unit to \"km/h\", \"mph\" or \"m/s\"",
            )
        })
    }

    fn unusable(&self, signal: &str, problem: String, fix: &'static str) -> MappingError {
        MappingError::Unusable {
            file: self.file.to_owned(),
            message: self.message.name.clone(),
            signal: signal.to_owned(),
            problem,
            fix,
        }
    }
}

fn unknown_message(file: &Path, dbc: &Dbc, name: &str) -> MappingError {
    MappingError::UnknownMessage {
        file: file.to_owned(),
        message: name.to_owned(),
        like: likest(name, dbc.messages.iter().map(|message| message.name.as_str())),
    }
}

/// The names nearest to `name` by edit distance, upper and lower case alike.
fn likest<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> String {
    let mut names: Vec<(usize, &str)> = names.map(|other| (distance(name, other), other)).collect();
    names.sort_unstable();
    let listed: Vec<&str> = names.iter().take(NAMES_LISTED).map(|(_, other)| *other).collect();
    if listed.is_empty() {
        "none".to_owned()
    } else {
        listed.join(", ")
    }
}

/// Levenshtein's distance.
fn distance(one: &str, other: &str) -> usize {
    let (one, other) = (one.to_ascii_lowercase(), other.to_ascii_lowercase());
    let mut row: Vec<usize> = (0..=other.len()).collect();
    for (at, byte) in one.bytes().enumerate() {
        let mut diagonal = row[0];
        row[0] = at + 1;
        for (to, other_byte) in other.bytes().enumerate() {
            let replaced = diagonal + usize::from(byte != other_byte);
            diagonal = row[to + 1];
            row[to + 1] = replaced.min(diagonal + 1).min(row[to] + 1);
        }
    }
    row[other.len()]
}

#[cfg(test)]
#[path = "dbc_tests.rs"]
mod tests;
