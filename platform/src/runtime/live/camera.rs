//! The camera's thread: frames from the port, at their capture stamps, to the frame task.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use freespace::health::Blame;
use freespace::port::{CameraAnswer, CameraPort, Clock as _, FrameBuffer};
use freespace::space::Micros;
use freespace::stage::{Stage, StageProbe as _};
use rtrb::Consumer;

use super::super::page_faults::FaultMeter;
use super::super::restart::guarded;
use super::super::trace::{Event, Teller};
use super::{Counters, Shared};

/// Frames after which every buffer has been through.
const WARM_FRAMES: u32 = 60;
/// How often a long sleep is broken off to see whether the drive is to end.
const LOOK_MICROS: u64 = 100_000;

pub(super) struct CameraThread {
    pub(super) camera: Box<dyn CameraPort + Send>,
    pub(super) shared: Arc<Shared>,
    pub(super) stop: Arc<AtomicBool>,
    /// Buffers that come back from the frame task.
    pub(super) returned: Consumer<Box<FrameBuffer>>,
    /// Buffers at hand.
    #[expect(clippy::vec_box, reason = "the boxes go on to other threads")]
    pub(super) buffers: Vec<Box<FrameBuffer>>,
    pub(super) teller: Teller,
}

impl CameraThread {
    pub(super) fn run(mut self) {
        let mut is_started = false;
        let mut faults = FaultMeter::warm_after(WARM_FRAMES);
        while !self.is_to_end() {
            faults.look(&self.shared.counters.page_faults);
            let Some(mut buffer) = self.buffer() else {
                return;
            };
            match self.next_frame(&mut buffer, is_started) {
                CameraAnswer::End => break,
                // The publisher answers for the key frames that do not come.
                CameraAnswer::Silent => self.buffers.push(buffer),
                CameraAnswer::Lost => {
                    Counters::add(&self.shared.counters.lost_frames, 1);
                    self.buffers.push(buffer);
                }
                CameraAnswer::Frame => {
                    if !is_started {
                        self.shared.clock.start_at(buffer.stamp);
                        is_started = true;
                    }
                    if self.slept_until(buffer.stamp) {
                        self.hand_over(buffer);
                    }
                }
            }
        }
        self.shared.frames.close();
    }

    fn is_to_end(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
            || self.shared.restarts.is_spent()
            || self.shared.is_given_up.load(Ordering::Relaxed)
    }

    /// Sleeps until a stamp, however far a gap of the recording puts it off; false where the drive is to end first.
    fn slept_until(&self, stamp: Micros) -> bool {
        let clock = &self.shared.clock;
        while stamp > clock.now().plus(LOOK_MICROS) {
            if self.is_to_end() {
                return false;
            }
            clock.sleep_until(clock.now().plus(LOOK_MICROS));
        }
        clock.sleep_until(stamp);
        true
    }

    /// A free buffer: with four of them there always is one, for the frame task holds one, and one waits.
    fn buffer(&mut self) -> Option<Box<FrameBuffer>> {
        self.buffers.pop().or_else(|| self.returned.pop().ok())
    }

    fn next_frame(&mut self, buffer: &mut FrameBuffer, is_started: bool) -> CameraAnswer {
        let (camera, shared) = (&mut self.camera, &self.shared);
        // The camera's time counts as that of the first stage, where nobody but the watch over hanging threads reads it.
        shared.camera_progress.enter(Stage::Frame);
        let fetched = guarded(|| {
            if is_started {
                let now = shared.clock.now();
                let skipped = camera.skip_before(now);
                Counters::add(&shared.counters.displaced_frames, skipped);
                if skipped > 0 {
                    // They were captured, and this thread came too late for them.
                    shared.captured.set(now);
                }
            }
            camera.next_frame(buffer)
        });
        shared.camera_progress.rest();
        fetched.unwrap_or_else(|_| {
            let may = self.shared.restarts.may_restart();
            let event = if may {
                Event::Panicked
            } else {
                Event::PanickedTooOften
            };
            self.teller.tell(self.shared.clock.now(), event(Blame::Camera));
            CameraAnswer::Lost
        })
    }

    fn hand_over(&mut self, buffer: Box<FrameBuffer>) {
        let is_wanted = buffer.key_frame_wanted;
        self.shared.captured.set(buffer.stamp);
        let Some(displaced) = self.shared.frames.post(buffer) else {
            return;
        };
        Counters::add(&self.shared.counters.displaced_frames, 1);
        // A wish for a key frame outlives the frame that carried it.
        if displaced.key_frame_wanted && !is_wanted {
            self.shared.key_frame_wanted.store(true, Ordering::Relaxed);
        }
        self.buffers.push(displaced);
    }
}
