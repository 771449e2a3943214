//! What the camera's thread tells without writing a line: counters that anybody reads, events that one reader prints.
//!
//! Invariant: telling takes no lock and no memory. Cost: an atomic addition, a place in a ring. Where the ring is full the event
//! is dropped and counted; the counters lose nothing.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rtrb::{Consumer, Producer, RingBuffer};
use rustix::io::Errno;

use super::{Mode, Refusal};

/// Events that wait for their reader: an hour of a plug that is loose once a minute.
const RING: usize = 128;

/// Something that happened to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraEvent {
    /// It cannot be opened, or its stream ended; it is tried again for ever.
    Away {
        /// The kernel's error number.
        errno: i32,
    },
    /// It gives frames.
    Connected(Mode),
    /// It is there again, but not as it must be; it is tried again for ever.
    Refused(Refusal),
    /// It gave no frame for long, though it is there: it is opened anew.
    Stuck,
    /// The first loss of this kind since it was connected.
    Lost(Loss),
}

/// Why a frame was not handed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// The driver calls it damaged, or gave too few bytes.
    Damaged,
    /// It could not be decoded.
    Undecodable,
    /// Frames are missing in the driver's count.
    Gap,
    /// Its stamp is not later than the last one.
    StampBack,
    /// Its stamp lies in the future.
    StampAhead,
    /// Its stamp is too old to serve any answer.
    StampOld,
    /// Its stamp is of another clock.
    StampClock,
}

impl CameraEvent {
    /// Of what the kernel answers while a camera is being pulled out, each is the same to the driver of the car.
    pub(super) const fn away(errno: Errno) -> Self {
        let errno = match errno {
            Errno::NODEV | Errno::NXIO => Errno::NOENT,
            errno => errno,
        };
        Self::Away {
            errno: errno.raw_os_error(),
        }
    }
}

impl fmt::Display for CameraEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Away { errno } => match Errno::from_raw_os_error(errno) {
                Errno::NOENT => {
                    f.write_str("the camera is not there; it is looked for every two seconds")
                }
                Errno::BUSY => f.write_str("another program uses the camera; it is tried every two seconds"),
                Errno::NOSPC => f.write_str(
                    "the USB bus has no room for this camera; give it a bus of its own, a smaller size or mjpeg",
                ),
                errno => write!(f, "the camera fails ({errno}); it is tried every two seconds"),
            },
            Self::Connected(mode) => write!(f, "the camera gives {mode}"),
            Self::Refused(why) => write!(f, "the camera is there, but not taken: {why}"),
            Self::Stuck => f.write_str("the camera gives no frames; it is opened anew"),
            Self::Lost(loss) => f.write_str(match loss {
                Loss::Damaged => "a frame was damaged; cable and bus load may be the reason",
                Loss::Undecodable => "a frame could not be decoded",
                Loss::Gap => "the driver lost frames",
                Loss::StampBack => "a frame's stamp went back; it is not used",
                Loss::StampAhead => "a frame's stamp lies in the future; it is not used",
                Loss::StampOld => "a frame came a second after its capture; it is not used",
                Loss::StampClock => "a frame was not stamped by CLOCK_MONOTONIC; it is not used",
            }),
        }
    }
}

/// Counts since the camera was first opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CameraCounts {
    /// Frames handed over.
    pub frames: u64,
    /// Frames that the driver called damaged, or that had too few bytes.
    pub damaged: u64,
    /// Frames that could not be decoded.
    pub undecodable: u64,
    /// Frames missing in the driver's count.
    pub missing: u64,
    /// Frames that a newer one overtook while they waited.
    pub superseded: u64,
    /// Frames whose stamps could not be true.
    pub bad_stamps: u64,
    /// Waits that ended without a frame.
    pub silences: u64,
    /// Times that the camera was connected.
    pub connections: u64,
    /// Times that its stream ended.
    pub disconnections: u64,
    /// Times that it was there, and not as it must be.
    pub refusals: u64,
    /// Events that found no room.
    pub untold: u64,
}

impl CameraCounts {
    /// Frames that the camera took, and nobody got.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.damaged + self.undecodable + self.missing + self.bad_stamps
    }
}

macro_rules! counters {
    ($($name:ident),+) => {
        #[derive(Debug, Default)]
        pub(super) struct Counters { $(pub(super) $name: AtomicU64),+ }

        impl Counters {
            fn read(&self) -> CameraCounts {
                CameraCounts { $($name: self.$name.load(Ordering::Relaxed)),+ }
            }
        }
    };
}
counters!(
    frames,
    damaged,
    undecodable,
    missing,
    superseded,
    bad_stamps,
    silences,
    connections,
    disconnections,
    refusals,
    untold
);

/// Reads the counters, from any thread; cheap to clone.
#[derive(Clone, Debug)]
pub struct CameraStatus(Arc<Counters>);

impl CameraStatus {
    /// The counts now.
    #[must_use]
    pub fn counts(&self) -> CameraCounts {
        self.0.read()
    }
}

/// The one reader of the events.
#[derive(Debug)]
pub struct CameraEvents {
    device: PathBuf,
    ring: Consumer<CameraEvent>,
}

impl CameraEvents {
    /// The configured device, for the line to begin with.
    #[must_use]
    pub fn device(&self) -> &Path {
        &self.device
    }

    /// The next event that nobody read yet.
    pub fn next_event(&mut self) -> Option<CameraEvent> {
        self.ring.pop().ok()
    }
}

/// The camera's own end.
pub(super) struct Teller {
    counters: Arc<Counters>,
    ring: Producer<CameraEvent>,
    /// Losses told since the last connection, a bit each.
    losses_told: u32,
    /// What was told since a frame came, so that an attempt every two seconds is no line every two seconds.
    since_frame: heapless::Vec<CameraEvent, 8>,
}

impl Teller {
    pub(super) fn new(device: &Path) -> (Self, CameraStatus, CameraEvents) {
        let (ring, events) = RingBuffer::new(RING);
        let counters = Arc::new(Counters::default());
        let status = CameraStatus(Arc::clone(&counters));
        let events = CameraEvents {
            device: device.to_owned(),
            ring: events,
        };
        let teller = Self {
            counters,
            ring,
            losses_told: 0,
            since_frame: heapless::Vec::new(),
        };
        (teller, status, events)
    }

    pub(super) fn count(&self, which: impl FnOnce(&Counters) -> &AtomicU64, frames: u64) {
        which(&self.counters).fetch_add(frames, Ordering::Relaxed);
    }

    fn tell(&mut self, event: CameraEvent) {
        if self.ring.push(event).is_err() {
            self.count(|counters| &counters.untold, 1);
        }
    }

    /// Tells once what keeps the camera away, until a frame comes.
    pub(super) fn tell_once(&mut self, event: CameraEvent) {
        // So many different reasons say enough.
        if !self.since_frame.contains(&event) && self.since_frame.push(event).is_ok() {
            self.tell(event);
        }
    }

    /// The first frame of a connection came.
    pub(super) fn connected(&mut self, mode: Mode) {
        self.since_frame.clear();
        self.losses_told = 0;
        self.tell(CameraEvent::Connected(mode));
    }

    /// Counts lost frames, and tells the first of their kind.
    pub(super) fn lost(&mut self, loss: Loss, frames: u64) {
        self.count(
            |counters| match loss {
                Loss::Damaged => &counters.damaged,
                Loss::Undecodable => &counters.undecodable,
                Loss::Gap => &counters.missing,
                Loss::StampBack | Loss::StampAhead | Loss::StampOld | Loss::StampClock => {
                    &counters.bad_stamps
                }
            },
            frames,
        );
        let bit = 1 << loss as u32;
        if self.losses_told & bit == 0 {
            self.losses_told |= bit;
            self.tell(CameraEvent::Lost(loss));
        }
    }
}
