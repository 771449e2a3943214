//! All messages of a DBC file, for a reader at a terminal.
//!
//! In: a DBC text; then frames. Out: names, values, units and words of every signal that the frame carries. Not for the loop.

use std::collections::BTreeMap;
use std::path::Path;

use can_dbc::{Dbc, MessageId, MultiplexIndicator, Signal};

use crate::bad_input::BadInput;
use crate::wheels::signal::Field;

/// Messages by identifier.
pub struct Catalogue {
    messages: BTreeMap<(u32, bool), CatalogueMessage>,
}

/// One message.
pub struct CatalogueMessage {
    /// Its name.
    pub name: String,
    signals: Vec<NamedSignal>,
}

struct NamedSignal {
    name: String,
    unit: String,
    field: Field,
    multiplex: MultiplexIndicator,
    words: BTreeMap<i64, String>,
}

/// A decoded signal.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SignalValue<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its value in its unit.
    pub value: f64,
    /// Its unit; empty without.
    #[serde(skip_serializing_if = "str::is_empty")]
    pub unit: &'a str,
    /// The DBC's word for the value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub word: Option<&'a str>,
}

impl Catalogue {
    /// Reads a DBC file.
    ///
    /// # Errors
    /// An unreadable or malformed file.
    pub fn open(path: &Path) -> Result<Self, BadInput> {
        let text = std::fs::read(path).map_err(|error| {
            BadInput::of_file(
                path,
                format!("cannot be read: {error}"),
                "give the path of a DBC file with --dbc",
            )
        })?;
        Self::new(path, &String::from_utf8_lossy(&text))
    }

    /// Reads a DBC text; `path` is what errors name.
    ///
    /// # Errors
    /// A malformed text.
    pub fn new(path: &Path, text: &str) -> Result<Self, BadInput> {
        let dbc = Dbc::try_from(text).map_err(|error| {
            let fix = "correct the line named there; the file must hold BO_ and SG_ entries";
            BadInput::of_file(path, format!("not a DBC file: {error}"), fix)
        })?;
        let messages = (dbc.messages.iter())
            .map(|message| {
                let id = (
                    message.id.raw() & 0x1fff_ffff,
                    matches!(message.id, MessageId::Extended(_)),
                );
                let signals = (message.signals.iter())
                    .filter_map(|signal| NamedSignal::new(&dbc, message.id, signal))
                    .collect();
                let name = message.name.clone();
                (id, CatalogueMessage { name, signals })
            })
            .collect();
        Ok(Self { messages })
    }

    /// The message of an identifier.
    #[must_use]
    pub fn message(&self, id: u32, is_extended: bool) -> Option<&CatalogueMessage> {
        self.messages.get(&(id, is_extended))
    }
}

impl NamedSignal {
    fn new(dbc: &Dbc, id: MessageId, signal: &Signal) -> Option<Self> {
        let words = dbc
            .value_descriptions_for_signal(id, &signal.name)
            .into_iter()
            .flatten()
            .map(|word| (word.id, word.description.clone()))
            .collect();
        Some(Self {
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            field: Field::of(signal)?,
            multiplex: signal.multiplexer_indicator,
            words,
        })
    }
}

impl CatalogueMessage {
    /// The signals that the frame carries; those beyond its end are left out.
    pub fn values<'a>(&'a self, data: &'a [u8]) -> impl Iterator<Item = SignalValue<'a>> {
        let page = (self.signals.iter())
            .find(|signal| {
                signal.multiplex == MultiplexIndicator::Multiplexor
                    && signal.field.bytes_needed() <= data.len()
            })
            .map(|signal| signal.field.raw(data));
        (self.signals.iter())
            .filter(move |signal| match signal.multiplex {
                MultiplexIndicator::MultiplexedSignal(of) => page == Some(of),
                _ => true,
            })
            .filter(|signal| signal.field.bytes_needed() <= data.len())
            .map(|signal| SignalValue {
                name: &signal.name,
                value: signal.field.physical(data),
                unit: &signal.unit,
                word: i64::try_from(signal.field.raw(data))
                    .ok()
                    .and_then(|raw| signal.words.get(&raw))
                    .map(String::as_str),
            })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use freespace::emit::can::{EGO_ID, STATUS_ID};
    use freespace::emit::grid_frames::GRID_HEAD_ID;
    use freespace::emit::{CanEncoder, Header};

    #[test]
    fn the_shipped_file_describes_what_the_module_sends() {
        let text = include_str!("../../../config/freespace.dbc");
        let catalogue = Catalogue::new(Path::new("freespace.dbc"), text).unwrap();
        let header = Header {
            speed_mps: 12.34,
            ..Header::default()
        };
        for frame in CanEncoder::default().encode(&header) {
            let message = catalogue.message(frame.id, false).unwrap();
            let values: Vec<SignalValue<'_>> = message.values(&frame.data).collect();
            assert!(values.len() >= 5, "{}", message.name);
            let of = |name: &str| values.iter().find(|value| value.name == name).unwrap();
            if frame.id == STATUS_ID {
                assert_eq!(of("Quality").word, Some("invalid"));
            }
            if frame.id == EGO_ID {
                assert!((of("Speed").value - 12.34).abs() < 1e-9);
                assert_eq!(of("Speed").unit, "m/s");
            }
        }
        let head = catalogue.message(GRID_HEAD_ID, false).unwrap();
        assert_eq!(head.values(&[0; 64]).count(), 10);
        assert_eq!(
            head.values(&[0; 8]).count(),
            4,
            "signals beyond the end are left out"
        );
        let error = Catalogue::new(Path::new("x.dbc"), "no DBC at all").err().unwrap();
        assert!(error.message().starts_with("x.dbc"), "{error}");
    }
}
