//! What a recording lacks, as it says of itself.
//!
//! A metadata record `losses` stands at the head of each part, follows within a second where a count has grown, and stands at the
//! end; counts are since the start of the recording, so that of any run of parts the last less the first is what they lack.

use std::collections::BTreeMap;

use mcap::records::Metadata;

/// Name of the record.
const NAME: &str = "losses";
const FRAMES: &str = "dropped_frames";
const MESSAGES: &str = "dropped_messages";
const LOST: &str = "lost_messages";

/// What is not in a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Frames that found no buffer free: the disk was too slow.
    pub dropped_frames: u64,
    /// Other messages that found a queue full, on their way to the observer or from it.
    pub dropped_messages: u64,
    /// Messages, frames among them, that the disk refused.
    pub lost_messages: u64,
}

impl Losses {
    /// Whether notes of the drive may be missing: poses, answers, wheel readings.
    #[must_use]
    pub const fn has_lost_notes(&self) -> bool {
        self.dropped_messages + self.lost_messages > 0
    }

    /// What was lost since `earlier`.
    #[must_use]
    pub const fn since(&self, earlier: &Self) -> Self {
        Self {
            dropped_frames: self.dropped_frames.saturating_sub(earlier.dropped_frames),
            dropped_messages: self.dropped_messages.saturating_sub(earlier.dropped_messages),
            lost_messages: self.lost_messages.saturating_sub(earlier.lost_messages),
        }
    }

    pub(super) fn record(&self) -> Metadata {
        let counts = [
            (FRAMES, self.dropped_frames),
            (MESSAGES, self.dropped_messages),
            (LOST, self.lost_messages),
        ];
        let named = counts.map(|(name, count)| (name.to_owned(), count.to_string()));
        Metadata {
            name: NAME.to_owned(),
            metadata: BTreeMap::from(named),
        }
    }

    /// Of a record; none where it is another one, or damaged.
    #[must_use]
    pub fn of_record(record: &Metadata) -> Option<Self> {
        let count = |name: &str| record.metadata.get(name)?.parse().ok();
        if record.name != NAME {
            return None;
        }
        Some(Self {
            dropped_frames: count(FRAMES)?,
            dropped_messages: count(MESSAGES)?,
            lost_messages: count(LOST)?,
        })
    }
}

impl std::fmt::Display for Losses {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} frames and {} messages found their queue full, and {} messages the disk",
            self.dropped_frames, self.dropped_messages, self.lost_messages
        )
    }
}
