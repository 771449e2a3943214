//! The recorder's thread: takes what the taps lend and the observer notes, and writes it. A normal thread; it may block.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use freespace::port::FrameBuffer;
use rtrb::{Consumer, Producer};

use super::format::{Topic, WantedNote, WheelNote};
use super::note::Note;
use super::parts::Parts;
use super::picture;
use super::tap::TakenReading;

/// How often it looks: taps ring no bell, for that would be a call of the kernel on a real-time thread.
const LOOK_EVERY: Duration = Duration::from_millis(10);

pub(super) struct RecorderThread {
    pub(super) parts: Parts,
    pub(super) frames: Consumer<Box<FrameBuffer>>,
    pub(super) returned: Producer<Box<FrameBuffer>>,
    pub(super) wheels: Consumer<TakenReading>,
    pub(super) notes: Receiver<Note>,
    /// Nothing more will come.
    pub(super) is_over: Arc<AtomicBool>,
    /// The message being made.
    pub(super) message: Vec<u8>,
}

impl RecorderThread {
    pub(super) fn run(mut self) {
        loop {
            let is_last = self.is_over.load(Ordering::Acquire);
            self.drain();
            self.parts.tend(Instant::now());
            if is_last {
                break;
            }
            std::thread::sleep(LOOK_EVERY);
        }
        self.parts.finish();
    }

    fn drain(&mut self) {
        while let Ok(frame) = self.frames.pop() {
            self.write_frame(&frame);
            // There is room for every buffer.
            let _ = self.returned.push(frame);
        }
        while let Ok((until, reading)) = self.wheels.pop() {
            let note = Note::json(Topic::Wheels, reading.stamp(), &WheelNote::new(&reading, until));
            self.write(&note);
        }
        while let Ok(note) = self.notes.try_recv() {
            self.write(&note);
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "an index of 32 bits lasts four years at 30 frames a second"
    )]
    fn write_frame(&mut self, frame: &FrameBuffer) {
        // A frame too large for its buffer was counted by the tap.
        if frame.bytes.is_empty() {
            return;
        }
        if frame.key_frame_wanted {
            let wanted = WantedNote { frame: frame.index };
            self.write(&Note::json(Topic::KeyFrameWanted, frame.stamp, &wanted));
        }
        picture::encode(frame, &mut self.message);
        self.parts
            .write(Topic::Image, frame.index as u32, frame.stamp.0, &self.message);
    }

    fn write(&mut self, note: &Note) {
        self.parts.write(note.topic, 0, note.at.0, &note.data);
    }
}
