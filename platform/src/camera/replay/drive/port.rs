//! A recorded drive as a camera.

use std::collections::BTreeSet;

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::space::Micros;

use super::stream::{Found, Stream};
use super::{FramePlace, RecordedDrive};
use crate::sink::mcap::{Topic, picture};

/// The frames of a recorded drive, one after the other.
pub struct DriveFrames {
    stream: Stream,
    frames: Vec<FramePlace>,
    next: usize,
    wanted: BTreeSet<u64>,
    /// Frames that are passed over as lost.
    left_out: BTreeSet<u64>,
}

impl DriveFrames {
    /// All frames that were recorded.
    #[must_use]
    pub fn all(drive: &RecordedDrive) -> Self {
        Self {
            stream: Stream::new(drive.parts.clone()),
            frames: drive.frames.clone(),
            next: 0,
            wanted: drive.wanted.clone(),
            left_out: BTreeSet::new(),
        }
    }

    /// Those that the drive's pipeline took; the others count as lost.
    #[must_use]
    pub fn as_driven(drive: &RecordedDrive) -> Self {
        let indices = drive.frames.iter().map(|frame| frame.index);
        Self {
            left_out: indices.filter(|index| drive.was_left_out(*index)).collect(),
            ..Self::all(drive)
        }
    }

    /// Goes on to the next picture in the file; false at the end.
    fn find_picture(&mut self) -> bool {
        while let Some(found) = self.stream.next() {
            if matches!(
                found,
                Found::Message {
                    topic: Topic::Image,
                    ..
                }
            ) {
                return true;
            }
        }
        false
    }
}

impl CameraPort for DriveFrames {
    /// A frame that must become a key frame is never left out.
    fn skip_before(&mut self, now: Micros) -> u64 {
        let mut skipped = 0;
        while let Some([this, after]) = self.frames.get(self.next..self.next + 2)
            && after.stamp <= now
            && !self.wanted.contains(&this.index)
            && self.find_picture()
        {
            self.next += 1;
            skipped += 1;
        }
        skipped
    }

    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let Some(&FramePlace { index, stamp }) = self.frames.get(self.next) else {
            return CameraAnswer::End;
        };
        self.next += 1;
        if !self.find_picture() {
            return CameraAnswer::End;
        }
        if self.left_out.contains(&index) {
            return CameraAnswer::Lost;
        }
        // All were read once when the drive was opened: the file is damaged since.
        if picture::decode(self.stream.data(), index, stamp, buffer).is_err() {
            return CameraAnswer::Lost;
        }
        buffer.key_frame_wanted = self.wanted.contains(&index);
        CameraAnswer::Frame
    }
}
