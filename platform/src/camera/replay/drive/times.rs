//! What a recorded drive's frames and key frames took, as a replay injects it.

use freespace::health::{Faults, QualityLevel};
use freespace::space::Micros;
use freespace::stage::{Cuts, StageTimes};

use super::RecordedDrive;
use crate::runtime::{KeyFrameTimes, RecordedTimes};
use crate::sink::mcap::{KeyFrameNote, LateWorkNote};

impl RecordedDrive {
    /// The times for [`run_recorded`](crate::runtime::run_recorded).
    #[must_use]
    pub fn times(&self) -> RecordedTimes {
        RecordedTimes {
            frame_micros: (self.frame_notes.iter())
                .map(|(index, note)| (*index, note.micros))
                .collect(),
            key_frames: (self.key_frame_notes.iter())
                .map(|(index, note)| (*index, key_frame_times(note, self.late_work_notes.get(index))))
                .collect(),
            lessons: (self.frame_notes.iter())
                .filter_map(|(index, note)| Some((*index, note.learnt?)))
                .collect(),
        }
    }
}

/// After its capture, when a late answer comes of whose work the drive did not hear to its end: after the fallback, and before
/// the next key frame.
const LATE_ANSWER_MICROS: u64 = 450_000;

fn key_frame_times(note: &KeyFrameNote, late: Option<&LateWorkNote>) -> KeyFrameTimes {
    let is_answered_late = [QualityLevel::Moved, QualityLevel::Invalid]
        .map(QualityLevel::name)
        .contains(&&*note.level);
    // A fallback ran no stage: what was done meanwhile stands apart.
    let (stages, refused, stopped_after, faults) = match late {
        Some(late) => (late.stage_micros, late.refused, late.stopped_after, &late.faults),
        None => (note.stage_micros, note.refused, note.stopped_after, &note.faults),
    };
    KeyFrameTimes {
        stamp: Micros(note.stamp_micros),
        stages: StageTimes(stages),
        cuts: Cuts {
            refused,
            stopped_after,
        },
        faults: named(faults),
        latency_micros: note.latency_micros,
        heard_micros: is_answered_late.then(|| late.map_or(LATE_ANSWER_MICROS, |late| late.micros)),
    }
}

fn named(faults: &[String]) -> Faults {
    Faults::NAMED
        .into_iter()
        .filter(|(_, name)| faults.iter().any(|fault| fault == name))
        .fold(Faults::NONE, |faults, (fault, _)| faults | fault)
}
