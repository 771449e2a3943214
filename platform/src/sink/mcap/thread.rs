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
            let had_frame = self.take_turn();
            self.parts.tend(Instant::now());
            if had_frame {
                continue;
            }
            if is_last {
                break;
            }
            std::thread::sleep(LOOK_EVERY);
        }
        self.parts.finish();
    }

    /// Writes one frame, if one waits, and all else that waits: frames come faster than a slow disk takes them, and must not keep
    /// notes waiting until those are lost.
    fn take_turn(&mut self) -> bool {
        let frame = self.frames.pop().ok();
        let had_frame = frame.is_some();
        if let Some(frame) = frame {
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
        had_frame
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use std::io::Cursor;
    use std::path::Path;
    use std::sync::atomic::AtomicUsize;
    use std::sync::mpsc::sync_channel;

    use freespace::space::Micros;
    use rtrb::RingBuffer;

    use super::super::parts::{Counters, Head, Medium, Parts, Split};
    use super::*;

    #[test]
    fn frames_that_never_cease_keep_no_note_waiting_and_no_part_from_its_end() {
        let counters = Arc::new(Counters::default());
        let opened = Arc::new(AtomicUsize::new(0));
        let opening = Arc::clone(&opened);
        let parts = Parts::begin(
            Path::new("memory.mcap"),
            Split {
                bytes: Some(1_000_000),
                after: None,
            },
            Head {
                drive: Vec::new(),
                config: String::new(),
                standing: Vec::new(),
            },
            Box::new(move |_| {
                opening.fetch_add(1, Ordering::Relaxed);
                Ok(Box::new(Cursor::new(Vec::<u8>::new())) as Box<dyn Medium>)
            }),
            &counters,
            Box::new(|line| panic!("{line}")),
        )
        .unwrap();
        let (mut lend, frames) = RingBuffer::new(4);
        let (returned, mut back) = RingBuffer::new(4);
        let (_, wheels) = RingBuffer::new(1);
        let (tell, notes) = sync_channel(8);
        let is_over = Arc::new(AtomicBool::new(false));
        let mut recorder = RecorderThread {
            parts,
            frames,
            returned,
            wheels,
            notes,
            is_over: Arc::clone(&is_over),
            message: Vec::new(),
        };
        // Noise, which does not compress.
        let mut state = 1_u32;
        let noise: Vec<u8> = std::iter::repeat_with(|| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            state.to_ne_bytes()[0]
        })
        .take(300_000)
        .collect();
        let frame = || {
            Box::new(FrameBuffer {
                bytes: noise.clone(),
                width: 300_000,
                height: 1,
                ..FrameBuffer::default()
            })
        };
        (0..4).for_each(|_| lend.push(frame()).unwrap());
        for turn in 0..40 {
            tell.try_send(Note::json(Topic::Frame, Micros(turn), &turn))
                .unwrap();
            assert!(recorder.take_turn());
            recorder.parts.tend(Instant::now());
            // A frame a turn, however many wait; the camera is at it again at once.
            lend.push(back.pop().unwrap()).unwrap();
            assert!(back.pop().is_err());
        }
        assert_eq!(
            counters.losses().dropped_messages + counters.losses().lost_messages,
            0
        );
        let parts = opened.load(Ordering::Relaxed);
        assert!(parts > 1, "{parts} part");
    }
}
