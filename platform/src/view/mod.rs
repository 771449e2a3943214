//! The view: what a run's observer shows of itself in shared memory besides the grid, for people who watch it.
//!
//! In: key frames as the observer sees them, on its normal thread. Out: one [`View`] a key frame, counters and stage times
//! ([`ViewStatus`]) and a small picture, in the service `NAME/view`. Invariant: no real-time thread comes near it; a run
//! without it is the same run; no picture is drawn where nobody looks. Cost: with a reader some milliseconds of the observer
//! a key frame, without one a copy of the counters; [`ROOM_BYTES`] of shared memory. When full: a picture that is larger than
//! a slot is left out; a reader that is slow gets the newest view.

mod picture;
mod reader;
#[cfg(test)]
mod tests;
mod writer;

pub use picture::PictureSource;
pub use reader::ViewReader;
pub use writer::ViewWriter;

use freespace::stage::Stage;
use serde::{Deserialize, Serialize};

/// Largest view: counters, and a picture of 640 pixels at the quality used is 40 to 120 kB.
pub const MAX_VIEW_BYTES: usize = 256 << 10;
/// Readers that there is room for.
pub const MAX_READERS: usize = 2;
/// Room in `/dev/shm` that the views of a run take: for each reader one that waits and one that is read, and the writer's own.
pub const ROOM_BYTES: u64 = ((MAX_READERS * 2 + 2) * MAX_VIEW_BYTES) as u64;

/// `FSVW` and the layout's version.
const HEAD: [u8; 8] = *b"FSVW\x01\0\0\0";
/// Bytes before the counters: the head, and their length.
const HEAD_BYTES: usize = HEAD.len() + 4;

/// Name of the service beside that of the messages.
#[must_use]
pub fn service_name(messages: &str) -> String {
    format!("{messages}/view")
}

/// What the observer knows and the message does not say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ViewStatus {
    /// Number of the message that this view belongs to.
    pub sequence: u64,
    /// Time in each stage for it, in the order of the stages, microseconds; zero where a stage did not run.
    pub stage_micros: [u64; Stage::ALL.len()],
    /// Frames that entered the pipeline.
    pub frames: u64,
    /// Frames lost by the camera, refused, or displaced by newer ones.
    pub dropped_frames: u64,
    /// Key frames published.
    pub key_frames: u64,
    /// Key frames that a fallback answered, or that came after their deadline.
    pub deadline_misses: u64,
    /// Parts that panicked and were started anew.
    pub restarts: u32,
    /// Landmarks in the map.
    pub landmarks: usize,
    /// Obstacle boxes.
    pub boxes: usize,
    /// Bound on the relative gap between the labelling's energy and the minimum.
    pub energy_gap: f32,
    /// What was told last on standard error, oldest first.
    pub events: Vec<String>,
}

/// A view as it is read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// Counters and times.
    pub status: ViewStatus,
    /// The key frame with its road tinted, JPEG; empty where there was none.
    pub picture: Vec<u8>,
}

/// Writes a view into `out`; `false` where not even the counters have room.
fn encode(status: &ViewStatus, picture: &[u8], out: &mut Vec<u8>) -> bool {
    out.clear();
    out.extend_from_slice(&HEAD);
    out.extend_from_slice(&[0; 4]);
    if serde_json::to_writer(&mut *out, status).is_err() || out.len() > MAX_VIEW_BYTES {
        return false;
    }
    let Ok(length) = u32::try_from(out.len() - HEAD_BYTES) else {
        return false;
    };
    out[HEAD.len()..HEAD_BYTES].copy_from_slice(&length.to_le_bytes());
    if out.len() + picture.len() <= MAX_VIEW_BYTES {
        out.extend_from_slice(picture);
    }
    true
}

/// Reads a view; none of bytes that are none.
fn decode(bytes: &[u8]) -> Option<View> {
    let rest = bytes.strip_prefix(&HEAD)?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let (status, picture) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    Some(View {
        status: serde_json::from_slice(status).ok()?,
        picture: picture.to_vec(),
    })
}
