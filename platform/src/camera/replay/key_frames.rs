//! Which frames are key frames: a steady cadence, and frames asked for by name.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::str::FromStr;

use freespace::space::Micros;

use super::ReplayCamera;
use crate::bad_input::{BadInput, closest, read_text};

/// `--key-frames every=N|FILE`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum KeyFrameRule {
    /// The configured interval alone.
    Interval,
    /// Every Nth frame.
    Every(usize),
    /// The configured interval, and the frames that a file names, one a line.
    Listed(PathBuf),
}

impl FromStr for KeyFrameRule {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(number) = text.strip_prefix("every=") else {
            return Ok(Self::Listed(PathBuf::from(text)));
        };
        match number.parse() {
            Ok(n) if n > 0 => Ok(Self::Every(n)),
            _ => Err(format!(
                "`{number}` is not a number of frames; write every=5 for each fifth"
            )),
        }
    }
}

/// The rule applied to one sequence.
#[derive(Clone, Debug)]
pub struct KeyFrameSchedule {
    every: Option<usize>,
    interval_micros: u64,
    /// A frame this early is on time: half a frame, so that jitter does not shift the cadence by a whole one.
    early_micros: u64,
    due: Option<Micros>,
    last_index: Option<usize>,
    /// Indices asked for by name, ascending.
    listed: Vec<usize>,
}

impl KeyFrameSchedule {
    /// The rule for the frames of `camera`.
    ///
    /// # Errors
    /// Where the file of a [`KeyFrameRule::Listed`] cannot be read or names a frame that the sequence does not have.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an interval of at most 10 s"
    )]
    pub fn new(
        rule: &KeyFrameRule,
        interval_s: f64,
        frame_rate_hz: f64,
        camera: &ReplayCamera,
    ) -> Result<Self, BadInput> {
        let (every, listed) = match rule {
            KeyFrameRule::Interval => (None, Vec::new()),
            KeyFrameRule::Every(n) => (Some(*n), Vec::new()),
            KeyFrameRule::Listed(path) => (None, listed(path, camera)?),
        };
        Ok(Self {
            every,
            interval_micros: (interval_s * 1e6).round() as u64,
            early_micros: (0.5e6 / frame_rate_hz).min(0.4e6 * interval_s) as u64,
            due: None,
            last_index: None,
            listed,
        })
    }

    /// Whether this frame is a key frame; called once for each frame, in order. Listed frames do not shift the cadence.
    pub fn is_key_frame(&mut self, index: usize, stamp: Micros) -> bool {
        let due = match self.every {
            Some(n) => self.last_index.is_none_or(|last| index >= last + n),
            None => self.due.is_none_or(|due| stamp.plus(self.early_micros) >= due),
        };
        if due {
            self.last_index = Some(index);
            let mut next = self.due.unwrap_or(stamp).plus(self.interval_micros);
            if next <= stamp {
                // A gap longer than the interval: the cadence starts again here.
                next = stamp.plus(self.interval_micros);
            }
            self.due = Some(next);
        }
        due || self.listed.binary_search(&index).is_ok()
    }
}

fn listed(path: &std::path::Path, camera: &ReplayCamera) -> Result<Vec<usize>, BadInput> {
    let text = read_text(
        path,
        "--key-frames takes every=N, or a file with one frame name a line",
    )?;
    let known: BTreeMap<&str, usize> = camera.listing().map(|(index, name, _)| (name, index)).collect();
    let mut indices = Vec::new();
    for (line, row) in text.lines().enumerate() {
        let name = row.trim();
        if name.is_empty() || name.starts_with('#') {
            continue;
        }
        let stem = [".png", ".jpg", ".jpeg"]
            .into_iter()
            .find_map(|ending| name.strip_suffix(ending))
            .unwrap_or(name);
        let index = known.get(stem).ok_or_else(|| {
            let fix = closest(stem, known.keys().copied()).map_or_else(
                || "name frames as their files are named".to_owned(),
                |near| format!("name frames as their files are named, such as {near}"),
            );
            BadInput::at_line(
                path,
                &text,
                line,
                format!("the sequence has no frame `{name}`"),
                fix,
            )
        })?;
        indices.push(*index);
    }
    indices.sort_unstable();
    Ok(indices)
}
