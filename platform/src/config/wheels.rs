//! `[wheels]`: where wheel readings come from and how a CAN message carries them.

use std::path::PathBuf;

use freespace::track::WheelConfig;
use serde::Deserialize;

use super::can::interface_name;
use super::{Invalid, within};
use crate::wheels::WheelMapping;
use crate::wheels::dbc::SpeedUnit;
pub use crate::wheels::dbc::WheelKind;
use crate::wheels::integrity::{ChecksumAlgorithm, ChecksumMapping};

/// What the config says of the wheel encoders.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WheelsSection {
    /// Where readings come from.
    pub source: WheelSource,
    /// Counters or speeds.
    pub kind: Option<WheelKind>,
    /// DBC file, relative to the config file.
    pub dbc: Option<PathBuf>,
    /// Name of the message in the DBC file.
    pub message: Option<String>,
    /// Signal of each wheel.
    pub signals: Option<FourSignals>,
    /// Signals of the direction of travel, of counters that do not tell.
    pub direction: Option<DirectionSignals>,
    /// Alive counter of the message.
    pub counter: Option<String>,
    /// Check sum of the message.
    pub checksum: Option<ChecksumSection>,
    /// Interface that the message is read from in a live run.
    pub interface: Option<String>,
    /// Metres a raw count, before the DBC's factor.
    pub metres_per_count: Option<f64>,
    /// Raw values of a counter before it wraps.
    pub modulus: Option<u32>,
    /// Unit of the speeds, where the DBC states none or a wrong one.
    pub unit: Option<SpeedUnit>,
    /// Distance between the wheels of an axle.
    pub track_m: Option<f64>,
    /// Silence after which the travel is unknown.
    pub timeout_s: Option<f64>,
    /// Stamp in the CAN log minus stamp of the frame taken at the same instant.
    pub time_offset_s: Option<f64>,
}

/// Where wheel readings come from.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum WheelSource {
    /// There are none: scale from the camera height.
    #[default]
    None,
    /// A CAN message.
    Can,
    /// The simulated road.
    Sim,
}

/// A signal name for each wheel.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct FourSignals {
    /// Front left.
    pub front_left: String,
    /// Front right.
    pub front_right: String,
    /// Rear left.
    pub rear_left: String,
    /// Rear right.
    pub rear_right: String,
}

impl FourSignals {
    /// The names in the core's order: front left, front right, rear left, rear right.
    #[must_use]
    pub fn names(&self) -> [&str; 4] {
        [
            &self.front_left,
            &self.front_right,
            &self.rear_left,
            &self.rear_right,
        ]
    }
}

/// Direction of travel: a signal for each wheel and its two raw values.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct DirectionSignals {
    /// Front left.
    pub front_left: String,
    /// Front right.
    pub front_right: String,
    /// Rear left.
    pub rear_left: String,
    /// Rear right.
    pub rear_right: String,
    /// Raw value when rolling ahead.
    pub forward: u64,
    /// Raw value when rolling back.
    pub backward: u64,
}

impl DirectionSignals {
    /// The names in the core's order: front left, front right, rear left, rear right.
    #[must_use]
    pub fn names(&self) -> [&str; 4] {
        [
            &self.front_left,
            &self.front_right,
            &self.rear_left,
            &self.rear_right,
        ]
    }
}

/// The check sum of the wheel message.
#[derive(Clone, Debug, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct ChecksumSection {
    /// Its signal: one whole byte.
    pub signal: String,
    /// How it is computed.
    pub algorithm: ChecksumAlgorithm,
    /// The data id of `autosar_e2e_p01`.
    pub data_id: Option<u16>,
}

impl ChecksumSection {
    /// The same as the decoder takes it.
    fn plan(&self) -> Result<ChecksumMapping, Invalid> {
        const KEY: &str = "wheels.checksum";
        let needs_id = self.algorithm == ChecksumAlgorithm::AutosarE2eP01;
        if needs_id != self.data_id.is_some() {
            let (problem, fix) = if needs_id {
                (
                    "lacks `data_id`",
                    "add the message's data id, such as data_id = 0x123",
                )
            } else {
                (
                    "has a `data_id` that its algorithm does not use",
                    "remove `data_id`",
                )
            };
            return Err(Invalid::new(KEY, format!("`{KEY}` {problem}"), fix));
        }
        Ok(ChecksumMapping {
            signal: self.signal.clone(),
            algorithm: self.algorithm,
            data_id: self.data_id.unwrap_or(0),
        })
    }
}

/// The checked plan.
#[derive(Clone, Debug)]
pub enum Wheels {
    /// There are none.
    None,
    /// The simulated road's.
    Sim(WheelConfig),
    /// Those of a CAN message.
    Can(Box<CanWheels>),
}

/// Wheel readings in a CAN message.
#[derive(Clone, Debug)]
pub struct CanWheels {
    /// DBC file.
    pub dbc: PathBuf,
    /// Name of the message.
    pub message: String,
    /// Signal of each wheel.
    pub signals: FourSignals,
    /// Signals of the direction of travel.
    pub direction: Option<DirectionSignals>,
    /// Alive counter of the message.
    pub counter: Option<String>,
    /// Check sum of the message.
    pub checksum: Option<ChecksumMapping>,
    /// Interface that the message is read from in a live run.
    pub interface: Option<String>,
    /// Counters or speeds.
    pub kind: WheelKind,
    /// Unit of the speeds, where the DBC states none or a wrong one.
    pub unit: Option<SpeedUnit>,
    /// Stamp in the log minus stamp of the frame taken at the same instant.
    pub time_offset_s: f64,
    /// For the core's odometer.
    pub odometer: WheelConfig,
}

fn required<T: Clone>(key: &'static str, value: Option<&T>, fix: &str) -> Result<T, Invalid> {
    value
        .cloned()
        .ok_or_else(|| Invalid::new(key, format!("`{key}` is missing"), fix))
}

impl CanWheels {
    /// The same as the decoder takes it.
    #[must_use]
    pub fn mapping(&self) -> WheelMapping {
        let owned = |names: [&str; 4]| names.map(str::to_owned);
        let (forward, backward) = self
            .direction
            .as_ref()
            .map_or((1, 2), |d| (d.forward, d.backward));
        WheelMapping {
            message: self.message.clone(),
            signals: owned(self.signals.names()),
            directions: self.direction.as_ref().map(|direction| owned(direction.names())),
            faults: None,
            counter: self.counter.clone(),
            checksum: self.checksum.clone(),
            kind: self.kind,
            unit: self.unit,
            direction_ahead: forward,
            direction_back: backward,
        }
    }

    /// Added to a log's stamps to bring them to the frames' time.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "checked: within 10^10 s")]
    pub fn offset_micros(&self) -> i64 {
        -(self.time_offset_s * 1e6).round() as i64
    }
}

impl WheelsSection {
    pub(super) fn plan(&self) -> Result<Wheels, Invalid> {
        match self.source {
            WheelSource::None => self.check_empty().map(|()| Wheels::None),
            WheelSource::Sim => Ok(Wheels::Sim(self.odometer()?)),
            WheelSource::Can => self.can().map(Box::new).map(Wheels::Can),
        }
    }

    /// Keys that say nothing without a source are a mistake: the user believes that wheels are used.
    fn check_empty(&self) -> Result<(), Invalid> {
        let given = [
            ("wheels.kind", self.kind.is_some()),
            ("wheels.dbc", self.dbc.is_some()),
            ("wheels.message", self.message.is_some()),
            ("wheels.signals", self.signals.is_some()),
            ("wheels.counter", self.counter.is_some()),
            ("wheels.checksum", self.checksum.is_some()),
            ("wheels.interface", self.interface.is_some()),
        ];
        match given.into_iter().find(|(_, given)| *given) {
            Some((key, _)) => Err(Invalid::new(
                key,
                format!("`{key}` is given, but the source of [wheels] is \"none\""),
                "set `source = \"can\"` in [wheels], or remove the key",
            )),
            None => Ok(()),
        }
    }

    fn can(&self) -> Result<CanWheels, Invalid> {
        let kind = required(
            "wheels.kind",
            self.kind.as_ref(),
            "set it to \"counts\" or \"speeds\"",
        )?;
        let time_offset_s = self.time_offset_s.unwrap_or(0.0);
        // A log may have another epoch; an interface is stamped on the frames' own clock, but for what buses and cameras delay.
        let most_s = if self.interface.is_some() { 1.0 } else { 1e10 };
        within("wheels.time_offset_s", time_offset_s, -most_s..=most_s, "seconds")?;
        Ok(CanWheels {
            dbc: required(
                "wheels.dbc",
                self.dbc.as_ref(),
                "name the DBC file that describes the message",
            )?,
            message: required(
                "wheels.message",
                self.message.as_ref(),
                "name the message in the DBC file",
            )?,
            signals: required(
                "wheels.signals",
                self.signals.as_ref(),
                "signals = { front_left = \"...\", front_right = \"...\", rear_left = \"...\", rear_right = \"...\" }",
            )?,
            direction: self.direction.clone(),
            counter: self.counter.clone(),
            checksum: self.checksum.as_ref().map(ChecksumSection::plan).transpose()?,
            interface: (self.interface.as_deref())
                .map(|name| interface_name("wheels.interface", name))
                .transpose()?,
            kind,
            unit: self.unit,
            time_offset_s,
            odometer: self.odometer()?,
        })
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a time-out of at most 10 s"
    )]
    fn odometer(&self) -> Result<WheelConfig, Invalid> {
        let kind = required(
            "wheels.kind",
            self.kind.as_ref(),
            "set it to \"counts\" or \"speeds\"",
        )?;
        let (metres_per_count, modulus) = match kind {
            WheelKind::Speeds => (0.0, 0),
            WheelKind::Counts => (
                required(
                    "wheels.metres_per_count",
                    self.metres_per_count.as_ref(),
                    "metres that the car moves in one raw count: wheel circumference over counts a turn",
                )?,
                required(
                    "wheels.modulus",
                    self.modulus.as_ref(),
                    "raw values before the counter wraps: 256 for 8 bits",
                )?,
            ),
        };
        if kind == WheelKind::Counts {
            within("wheels.metres_per_count", metres_per_count, 1e-5..=3.0, "metres")?;
            within(
                "wheels.modulus",
                f64::from(modulus),
                4.0..=4_294_967_295.0,
                "counts",
            )?;
        }
        let track_m = required(
            "wheels.track_m",
            self.track_m.as_ref(),
            "metres between the rear wheels",
        )?;
        within("wheels.track_m", track_m, 0.3..=4.0, "metres")?;
        let timeout_s = self.timeout_s.unwrap_or(DEFAULT_TIMEOUT_S);
        within("wheels.timeout_s", timeout_s, 0.01..=10.0, "seconds")?;
        Ok(WheelConfig {
            metres_per_count,
            modulus,
            track_m,
            timeout_micros: (timeout_s * 1e6).round() as u64,
        })
    }
}

/// Ten missed messages at 50 Hz, the slowest wheel message of the shipped configurations.
const DEFAULT_TIMEOUT_S: f64 = 0.2;
