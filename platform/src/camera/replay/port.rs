//! A replayed folder as a camera: the schedule says which of its frames are key frames.

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::space::Micros;

use super::{KeyFrameSchedule, ReplayCamera};

/// Frames of a folder, one after the other; lost ones are told apart by their index.
pub struct ReplayFrames {
    camera: ReplayCamera,
    schedule: KeyFrameSchedule,
    /// Index that the next frame has where none is missing.
    next_index: usize,
    /// Whether the next frame is a key frame, where that was asked already: the schedule is asked once a frame.
    is_next_wanted: Option<bool>,
}

impl ReplayFrames {
    /// All frames of `camera`.
    #[must_use]
    pub const fn new(camera: ReplayCamera, schedule: KeyFrameSchedule) -> Self {
        Self {
            camera,
            schedule,
            next_index: 0,
            is_next_wanted: None,
        }
    }

    fn is_wanted(&mut self, index: usize, stamp: Micros) -> bool {
        let schedule = &mut self.schedule;
        *(self.is_next_wanted).get_or_insert_with(|| schedule.is_key_frame(index, stamp))
    }
}

impl CameraPort for ReplayFrames {
    /// A frame that must become a key frame is never left out.
    fn skip_before(&mut self, now: Micros) -> u64 {
        let mut skipped = 0;
        while let (Some(index), Some(stamp)) = (self.camera.next_index(), self.camera.next_stamp())
            && self.camera.stamp_after_next().is_some_and(|after| after <= now)
            && !self.is_wanted(index, stamp)
        {
            self.camera.skip();
            self.next_index = index + 1;
            self.is_next_wanted = None;
            skipped += 1;
        }
        skipped
    }

    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let Some(index) = self.camera.next_index() else {
            return CameraAnswer::End;
        };
        // A file missing from the sequence, and one that cannot be decoded, is one lost frame.
        if self.next_index < index {
            self.next_index += 1;
            return CameraAnswer::Lost;
        }
        self.next_index = index + 1;
        let frame = match self.camera.next_frame() {
            Some(Ok(frame)) => frame,
            Some(Err(warning)) => {
                self.is_next_wanted = None;
                eprintln!("warning: {warning}");
                return CameraAnswer::Lost;
            }
            None => return CameraAnswer::End,
        };
        buffer.index = frame.index as u64;
        buffer.stamp = frame.stamp;
        buffer.format = frame.format;
        (buffer.width, buffer.height) = (frame.width, frame.height);
        buffer.bytes.clear();
        buffer.bytes.extend_from_slice(frame.bytes);
        let (index, stamp) = (frame.index, frame.stamp);
        buffer.key_frame_wanted = self.is_wanted(index, stamp);
        self.is_next_wanted = None;
        CameraAnswer::Frame
    }
}
