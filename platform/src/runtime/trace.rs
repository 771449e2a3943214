//! What a real-time thread has to tell: small values through a bounded ring, read by the observer's thread.
//!
//! Invariant: telling costs one copy; it never waits. A full ring loses the newest trace.

use freespace::frame::FrameError;
use freespace::health::Blame;
use freespace::space::Micros;
use rtrb::{Consumer, Producer, RingBuffer};

/// Traces that wait for the observer.
const WAITING: usize = 64;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A frame did not fit the camera.
    FrameRefused(FrameError),
    /// A newer job took the place of one that the key-frame task had not begun.
    JobDisplaced(u32),
    /// A key frame found no free job: all are still at work.
    NoFreeJob(u32),
    /// The key-frame task found it too late for a key frame.
    GivenUp(u32, Blame),
    /// An answer came after its fallback, by this many microseconds since the capture.
    AnsweredLate(u32, u64),
    /// A part panicked and was started anew.
    Panicked(Blame),
    /// A part panicked once too often: the drive ends.
    PanickedTooOften(Blame),
    /// A sink did not take a publication.
    SinkRefused,
}

impl std::fmt::Display for Event {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::FrameRefused(error) => write!(f, "frame dropped: {error}"),
            Self::JobDisplaced(number) => {
                write!(
                    f,
                    "key frame {number} gave way to a newer one before its work began"
                )
            }
            Self::NoFreeJob(number) => {
                write!(f, "key frame {number} was not worked on: every job is under way")
            }
            Self::GivenUp(number, blame) => {
                write!(
                    f,
                    "key frame {number} given up as too late, because of {}",
                    blame.name()
                )
            }
            Self::AnsweredLate(number, micros) => {
                write!(
                    f,
                    "key frame {number} answered only {} ms after capture",
                    micros / 1000
                )
            }
            Self::Panicked(blame) => write!(f, "{} panicked; its part was started anew", blame.name()),
            Self::PanickedTooOften(blame) => write!(f, "{} panicked once too often", blame.name()),
            Self::SinkRefused => f.write_str("a sink did not take a publication"),
        }
    }
}

/// An event and its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trace {
    /// When it was told.
    pub at: Micros,
    /// What happened.
    pub event: Event,
}

/// The telling end.
pub(super) struct Teller {
    ring: Producer<Trace>,
}

/// The listening end.
pub(super) type Listener = Consumer<Trace>;

/// Both ends of a ring of traces.
#[must_use]
pub(super) fn traces() -> (Teller, Listener) {
    let (ring, listener) = RingBuffer::new(WAITING);
    (Teller { ring }, listener)
}

impl Teller {
    /// Tells an event.
    pub(super) fn tell(&mut self, at: Micros, event: Event) {
        // Sixty-four unread ones say enough.
        let _ = self.ring.push(Trace { at, event });
    }
}
