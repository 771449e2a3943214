//! The file of one shard.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::list::{ListDigest, Shard, hex};
use super::tally::DriveScore;
use crate::bad_input::{BadInput, read_text};
use crate::whole_file::{WriteError, write_whole};

/// What a part says it is.
const FORMAT: &str = "freespace fleet part 2";
/// What to do about a part that is damaged or stale.
const AGAIN: &str =
    "make it again: `freespace eval drives` with the same list, --shard and --out, and --force";

/// What drives are evaluated with; parts of different settings are not joined.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Version of the program.
    pub program: String,
    /// SHA-256 of the configuration that recordings were replayed with; none where each is replayed with its own.
    pub config_sha256: Option<String>,
    /// SHA-256 of the model of that configuration's network; without one each drive tells its own.
    pub network_sha256: Option<String>,
}

impl Settings {
    /// This program's, with a configuration, and its network's model, in place of the recordings' own.
    #[must_use]
    pub fn new(config_text: Option<&str>, network_sha256: Option<String>) -> Self {
        Self {
            program: env!("CARGO_PKG_VERSION").to_owned(),
            config_sha256: config_text.map(|text| hex(&Sha256::digest(text))),
            network_sha256,
        }
    }
}

/// A drive that could not be evaluated.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailedDrive {
    /// Its place in the sorted list, from 0.
    pub index: usize,
    /// Its name in the list.
    pub name: String,
    /// What is wrong with it.
    pub cause: String,
}

/// What one shard found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    format: String,
    /// Which shard.
    pub shard: Shard,
    /// Of which list.
    pub list: ListDigest,
    /// Evaluated with what.
    pub settings: Settings,
    /// Its drives, by their place in the list.
    pub drives: Vec<DriveScore>,
    /// Those that could not be evaluated.
    pub failed: Vec<FailedDrive>,
}

impl Part {
    /// A part without drives yet.
    #[must_use]
    pub fn new(shard: Shard, list: ListDigest, settings: Settings) -> Self {
        Self {
            format: FORMAT.to_owned(),
            shard,
            list,
            settings,
            drives: Vec::new(),
            failed: Vec::new(),
        }
    }

    /// Reads a finished part.
    ///
    /// # Errors
    /// A file that is none, or holds other drives than those of its shard.
    pub fn read(path: &Path) -> Result<Self, BadInput> {
        let text = read_text(path, "give files that `freespace eval drives` wrote with --out")?;
        let part: Self = serde_json::from_str(&text).map_err(|error| {
            let line = error.line().saturating_sub(1);
            BadInput::at_line(path, &text, line, format!("is no finished part: {error}"), AGAIN)
        })?;
        match part.fault() {
            None => Ok(part),
            Some(fault) => Err(BadInput::of_file(path, fault, AGAIN)),
        }
    }

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), WriteError> {
        // A part always has a JSON form.
        let mut bytes = serde_json::to_vec_pretty(self).unwrap_or_default();
        bytes.push(b'\n');
        write_whole(path, &bytes)
    }

    /// Why this part is not what was asked for; none where it is.
    #[must_use]
    pub fn differs(&self, shard: Shard, list: &ListDigest, settings: &Settings) -> Option<String> {
        if self.shard != shard {
            return Some(format!("is shard {}, not {shard}", self.shard));
        }
        if self.list != *list {
            return Some("was made of another list of drives".to_owned());
        }
        (self.settings != *settings)
            .then(|| "was made by another version, or with another --config or network".to_owned())
    }

    /// What is wrong with its contents.
    fn fault(&self) -> Option<String> {
        if self.format != FORMAT {
            return Some(format!("is `{}`, not `{FORMAT}`", self.format));
        }
        if !self.shard.is_sound() {
            return Some(format!("is shard {}, which there is not", self.shard));
        }
        let mut found: Vec<usize> = (self.drives.iter().map(|drive| drive.index))
            .chain(self.failed.iter().map(|drive| drive.index))
            .collect();
        found.sort_unstable();
        if let Some(twice) = found.windows(2).find(|pair| pair[0] == pair[1]) {
            return Some(format!("holds drive {} twice", twice[0]));
        }
        let is_foreign = |drive: &&usize| !self.shard.takes(**drive) || **drive >= self.list.drives;
        if let Some(foreign) = found.iter().find(is_foreign) {
            let shard = self.shard;
            return Some(format!(
                "overlaps another: it holds drive {foreign}, which is not of shard {shard}"
            ));
        }
        let wanted = (self.shard.index..self.list.drives).step_by(self.shard.of);
        let lacking = wanted
            .into_iter()
            .find(|drive| found.binary_search(drive).is_err());
        lacking.map(|drive| format!("lacks drive {drive} of shard {}", self.shard))
    }
}
