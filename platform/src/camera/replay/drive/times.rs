//! What a recorded drive's frames and key frames took, as a replay injects it.

use freespace::health::{Faults, QualityLevel};
use freespace::space::Micros;
use freespace::stage::{Cuts, StageTimes};

use super::RecordedDrive;
use crate::runtime::{KeyFrameTimes, RecordedTimes};
use crate::sink::mcap::KeyFrameNote;

impl RecordedDrive {
    /// The times for [`run_recorded`](crate::runtime::run_recorded).
    #[must_use]
    pub fn times(&self) -> RecordedTimes {
        RecordedTimes {
            frame_micros: (self.frame_notes.iter())
                .map(|(index, note)| (*index, note.micros))
                .collect(),
            key_frames: (self.key_frame_notes.iter())
                .map(|(index, note)| (*index, key_frame_times(note)))
                .collect(),
            lessons: (self.frame_notes.iter())
                .filter_map(|(index, note)| Some((*index, note.learnt?)))
                .collect(),
        }
    }
}

fn key_frame_times(note: &KeyFrameNote) -> KeyFrameTimes {
    let faults = Faults::NAMED
        .into_iter()
        .filter(|(_, name)| note.faults.iter().any(|fault| fault == name))
        .fold(Faults::NONE, |faults, (fault, _)| faults | fault);
    KeyFrameTimes {
        stamp: Micros(note.stamp_micros),
        stages: StageTimes(note.stage_micros),
        cuts: Cuts {
            refused: note.refused,
            stopped_after: note.stopped_after,
        },
        faults,
        latency_micros: note.latency_micros,
        is_answered_late: [QualityLevel::Moved, QualityLevel::Invalid]
            .iter()
            .any(|level| level.name() == note.level),
    }
}
