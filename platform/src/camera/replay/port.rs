//! A replayed folder as a camera: the schedule says which of its frames are key frames.

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};

use super::{KeyFrameSchedule, ReplayCamera};

/// Frames of a folder, one after the other; lost ones are told apart by their index.
pub struct ReplayFrames {
    camera: ReplayCamera,
    schedule: KeyFrameSchedule,
    /// Index that the next frame has where none is missing.
    next_index: usize,
}

impl ReplayFrames {
    /// All frames of `camera`.
    #[must_use]
    pub const fn new(camera: ReplayCamera, schedule: KeyFrameSchedule) -> Self {
        Self {
            camera,
            schedule,
            next_index: 0,
        }
    }
}

impl CameraPort for ReplayFrames {
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
        buffer.key_frame_wanted = self.schedule.is_key_frame(frame.index, frame.stamp);
        CameraAnswer::Frame
    }
}
