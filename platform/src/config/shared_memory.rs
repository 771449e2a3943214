//! `[shared_memory]`: where readers on this computer find the message.

use serde::Deserialize;

use super::{Config, Invalid, within};
use crate::sink::shared_memory::SharingConfig;

/// `[shared_memory]`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SharedMemorySection {
    /// Whether messages are shared; where it is not said, they are if that is possible.
    pub enabled: Option<bool>,
    /// Name of the service.
    pub name: Option<String>,
    /// Readers that there is room for.
    pub max_readers: Option<i64>,
}

/// Longest name of a service.
const NAME_BYTES: usize = 100;

/// How much is made of sharing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// Messages are not shared.
    Off,
    /// They are shared where that is possible; where not, it is told, and the run goes on.
    Wanted(SharingConfig),
    /// A run that cannot share them does not start.
    Required(SharingConfig),
}

impl SharedMemorySection {
    #[expect(clippy::cast_precision_loss, reason = "compared with small bounds only")]
    pub(super) fn check(&self) -> Result<(), Invalid> {
        if let Some(max_readers) = self.max_readers {
            within(
                "shared_memory.max_readers",
                max_readers as f64,
                1.0..=32.0,
                "readers",
            )?;
        }
        let Some(name) = &self.name else {
            return Ok(());
        };
        let is_plain =
            |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"_/-".contains(&byte);
        if name.is_empty() || name.len() > NAME_BYTES || !name.bytes().all(is_plain) {
            return Err(Invalid::new(
                "shared_memory.name",
                format!("`shared_memory.name` is \"{name}\", which readers could not all write"),
                "use a to z, 0 to 9, _, - and /, at most 100 of them, such as \"freespace/grid\"",
            ));
        }
        Ok(())
    }
}

impl Config {
    /// Where messages are shared, checked when the config was read.
    #[must_use]
    pub fn sharing(&self) -> Sharing {
        let section = &self.shared_memory;
        let default = SharingConfig::default();
        let max_readers = section
            .max_readers
            .and_then(|readers| usize::try_from(readers).ok());
        let config = SharingConfig {
            name: section.name.clone().unwrap_or(default.name),
            max_readers: max_readers.unwrap_or(default.max_readers),
        };
        match section.enabled {
            Some(false) => Sharing::Off,
            Some(true) => Sharing::Required(config),
            None => Sharing::Wanted(config),
        }
    }
}
