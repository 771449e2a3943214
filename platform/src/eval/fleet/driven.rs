//! What a recorded drive says of itself.
//!
//! A replay shows what the picture and the map come to; when answers left, and at which level, is a fact of the drive, and is
//! taken from the notes that it left: also where the recording lacks frames that a busy disk did not take.

use super::tally::{DriveScore, Named};
use crate::camera::replay::drive::RecordedDrive;
use crate::statistics::{LatencyCounts, LatencyHistogram};

/// The score of a drive's replay, with deadlines, quality, latency and frames as the drive itself had them.
#[must_use]
pub fn as_driven(mut score: DriveScore, drive: &RecordedDrive) -> DriveScore {
    let mut latency = LatencyHistogram::new();
    let (mut levels, mut misses_by_stage) = (Named::new(), Named::new());
    let (mut key_frames, mut misses) = (0, 0);
    for note in drive.key_frame_notes.values().chain(&drive.frameless_notes) {
        key_frames += 1;
        latency.record(note.latency_micros);
        *levels.entry(note.level.clone()).or_default() += 1;
        if note.is_miss {
            misses += 1;
            let blamed = note.blame.as_deref().unwrap_or("unknown");
            *misses_by_stage.entry(blamed.to_owned()).or_default() += 1;
        }
    }
    let frames = drive.frame_notes.len() as u64;
    let (first, last) = (
        drive.frame_notes.first_key_value(),
        drive.frame_notes.last_key_value(),
    );
    let span = first
        .zip(last)
        .map_or(0, |((first, _), (last, _))| last - first + 1);
    // The first frame has nothing to be tracked against: its pose is the origin.
    let tracked =
        (drive.frame_notes.values().enumerate()).filter(|(place, note)| *place == 0 || note.is_tracked());
    let counts = &mut score.counts;
    counts.key_frames = key_frames;
    counts.timed_key_frames = key_frames;
    counts.deadline_misses = misses;
    counts.misses_by_stage = misses_by_stage;
    counts.levels = levels;
    counts.capture_to_publish = LatencyCounts::of(&latency);
    counts.frames = frames;
    counts.tracked_frames = tracked.count() as u64;
    // Numbers that no frame has.
    counts.dropped_frames = span.saturating_sub(frames);
    score
}
