//! One message on its way to the file, and Foxglove's small types.

use foxglove::Encode;
use foxglove::schemas::{FrameTransform, Quaternion, Timestamp, Vector3};
use freespace::space::{Micros, Pose};
use serde::Serialize;

use super::format::Topic;

/// A message, encoded.
pub(super) struct Note {
    pub(super) topic: Topic,
    /// When it was captured, or left.
    pub(super) at: Micros,
    pub(super) data: Vec<u8>,
}

impl Note {
    /// A message of Foxglove's.
    pub(super) fn encoded(topic: Topic, at: Micros, message: &impl Encode) -> Self {
        let mut data = Vec::with_capacity(message.encoded_len().unwrap_or(0));
        // Writing to memory that grows cannot fail.
        let _ = message.encode(&mut data);
        Self { topic, at, data }
    }

    /// A message of our own.
    pub(super) fn json(topic: Topic, at: Micros, message: &impl Serialize) -> Self {
        // Plain structures of numbers and texts cannot fail.
        let data = serde_json::to_vec(message).unwrap_or_default();
        Self { topic, at, data }
    }
}

/// A stamp; none beyond the year 2106.
pub(super) fn timestamp(at: Micros) -> Option<Timestamp> {
    let seconds = u32::try_from(at.0 / 1_000_000).ok()?;
    let nanos = u32::try_from(at.0 % 1_000_000 * 1_000).ok()?;
    Timestamp::new_checked(seconds, nanos)
}

/// A pose as a transform between named frames.
pub(super) fn transform(parent: &str, child: &str, parent_from_child: &Pose, at: Micros) -> FrameTransform {
    let translation = parent_from_child.translation.vector;
    let rotation = parent_from_child.rotation.coords;
    FrameTransform {
        timestamp: timestamp(at),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: Some(Vector3 {
            x: translation.x,
            y: translation.y,
            z: translation.z,
        }),
        rotation: Some(Quaternion {
            x: rotation.x,
            y: rotation.y,
            z: rotation.z,
            w: rotation.w,
        }),
    }
}
