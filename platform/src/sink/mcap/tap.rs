//! Taps: ports that hand on what another port gives, and lend a copy to the recorder.
//!
//! In: frames and wheel readings of the port inside. Out: the same, unchanged, and copies through wait-free rings. Invariant: a
//! tap never waits and never allocates; what finds no buffer free, or its ring full, is not recorded, and counted: the newest is
//! dropped, for the older ones are on their way. Cost: one copy of a frame's bytes on the camera's thread, 0.1 ms at 640x480 in
//! colour, and one of 48 bytes for each reading on the frame task's.

use std::sync::Arc;

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer, WheelPort};
use freespace::space::Micros;
use freespace::track::WheelReading;
use rtrb::{Consumer, Producer};

use super::parts::{Counters, add};

/// A reading, and until when readings were asked for.
pub(super) type TakenReading = (Micros, WheelReading);

/// A camera whose frames are recorded.
pub struct CameraTap {
    pub(super) inner: Box<dyn CameraPort + Send>,
    pub(super) free: Consumer<Box<FrameBuffer>>,
    pub(super) taken: Producer<Box<FrameBuffer>>,
    pub(super) counters: Arc<Counters>,
}

impl CameraTap {
    fn lend(&mut self, frame: &FrameBuffer) {
        let Ok(mut copy) = self.free.pop() else {
            add(&self.counters.dropped_frames, 1);
            return;
        };
        // Buffers have room for the largest format; a frame that is larger still is none of this camera.
        if frame.bytes.len() <= copy.bytes.capacity() {
            copy.index = frame.index;
            copy.stamp = frame.stamp;
            copy.format = frame.format;
            (copy.width, copy.height) = (frame.width, frame.height);
            copy.key_frame_wanted = frame.key_frame_wanted;
            copy.bytes.clear();
            copy.bytes.extend_from_slice(&frame.bytes);
        } else {
            add(&self.counters.dropped_frames, 1);
            copy.bytes.clear();
        }
        // There is room for every buffer.
        let _ = self.taken.push(copy);
    }
}

impl CameraPort for CameraTap {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let answer = self.inner.next_frame(buffer);
        if answer == CameraAnswer::Frame {
            self.lend(buffer);
        }
        answer
    }

    fn skip_before(&mut self, now: Micros) -> u64 {
        self.inner.skip_before(now)
    }
}

/// Encoders whose readings are recorded.
pub struct WheelTap {
    pub(super) inner: Box<dyn WheelPort + Send>,
    pub(super) taken: Producer<TakenReading>,
    pub(super) counters: Arc<Counters>,
}

impl WheelPort for WheelTap {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        let Self {
            inner,
            taken,
            counters,
        } = self;
        inner.readings_until(until, &mut |reading| {
            if taken.push((until, reading)).is_err() {
                add(&counters.dropped_messages, 1);
            }
            take(reading);
        });
    }
}
