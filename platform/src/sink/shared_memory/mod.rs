//! Shared memory: each message to every reader on this computer, in place and at once.
//!
//! In: encoded messages, from the publisher's thread. Out: one [`SharedMessage`](freespace::emit::SharedMessage) a message, in
//! the service that `freespace-reader` opens, and an event that wakes its readers. Invariant: [`SharedMemorySink::publish`]
//! copies the bytes into one of three boxes made at the start and rings a bell; it meets no reader, allocates nothing
//! and waits for nobody. Everything that a reader can have a say in (a new one is connected, a dead one is cleared away) is
//! done by the *sharing* thread, which the car does not wait for. Cost: one copy of the message on either side. When full: a
//! message that the sharing thread has not taken yet is replaced by the next one, and that is a [`SinkMiss`]; a reader that is
//! too slow misses messages, and costs nothing. Source: iceoryx2 0.10.

mod error;
mod leftovers;
mod thread;
mod writer;

pub use error::SharingError;
pub(crate) use writer::SPARE_NODES;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use freespace::emit::{CanFrame, SHARED_BYTES};
use freespace::health::Faults;
use freespace::port::{Clock as _, SinkMiss, SinkPort};
use freespace::space::Micros;
use freespace_reader::service;
use rtrb::{Consumer, RingBuffer};

use crate::clock::MonotonicClock;
use crate::runtime::handover::Mailbox;
use crate::runtime::rights::{Lacks, RealTimeConfig, ThreadRole, thread_builder};
use crate::view;

/// Boxes that circulate: one at hand, one waiting, one being written.
const LETTERS: usize = 3;

/// How long the sharing thread may take to come to its end.
const CLOSING: Duration = Duration::from_secs(1);

/// Bytes that the service itself takes besides the messages: its lists of readers and slots, its event.
const SERVICE_BYTES: u64 = 1 << 20;

/// Where messages are shared, and with how many.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SharingConfig {
    /// Name of the service.
    pub name: String,
    /// Readers that there is room for.
    pub max_readers: usize,
}

impl Default for SharingConfig {
    fn default() -> Self {
        Self {
            name: service::DEFAULT_NAME.to_owned(),
            max_readers: 4,
        }
    }
}

impl SharingConfig {
    /// Room in `/dev/shm` that a run takes.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        (service::slots(self.max_readers) * SHARED_BYTES) as u64 + SERVICE_BYTES + view::ROOM_BYTES
    }
}

/// A message on its way to the sharing thread.
struct Letter {
    bytes: Box<[u8]>,
    length: usize,
    /// When the publisher let go of it: what it waits from then on is part of its age.
    posted: Micros,
}

impl Letter {
    fn new(message_bytes: usize) -> Box<Self> {
        Box::new(Self {
            bytes: vec![0; message_bytes].into_boxed_slice(),
            length: 0,
            posted: Micros(0),
        })
    }
}

/// What publisher and sharing thread share.
#[derive(Default)]
struct Desk {
    letters: Mailbox<Letter>,
    /// A message could not be written: the next one is told so.
    has_failed: AtomicBool,
}

/// Publishes to shared memory.
pub struct SharedMemorySink {
    desk: Arc<Desk>,
    clock: MonotonicClock,
    #[expect(clippy::vec_box, reason = "a letter changes hands as its box")]
    at_hand: Vec<Box<Letter>>,
    returned: Consumer<Box<Letter>>,
    thread: Option<JoinHandle<()>>,
}

/// A sink, and what its thread was refused.
pub struct Opened {
    /// The sink.
    pub sink: SharedMemorySink,
    /// Rights that the sharing thread lacks.
    pub lacks: Lacks,
}

impl SharedMemorySink {
    /// Makes the service, or takes it over from a module that died, and starts the sharing thread, for encoded messages of at
    /// most `message_bytes`.
    ///
    /// # Errors
    /// See [`SharingError`].
    pub fn open(
        config: &SharingConfig,
        message_bytes: usize,
        real_time: &RealTimeConfig,
    ) -> Result<Opened, SharingError> {
        let desk = Arc::new(Desk::default());
        let (back, returned) = RingBuffer::new(LETTERS);
        let (tell, told) = mpsc::channel();
        let body = thread::Body {
            desk: Arc::clone(&desk),
            back,
            config: config.clone(),
            real_time: *real_time,
        };
        let thread = thread_builder(ThreadRole::Sharing, real_time)
            .spawn(move || body.run(&tell))
            .map_err(|_| SharingError::Thread)?;
        // A thread that ends without a word has panicked inside the library.
        let lacks = told.recv().unwrap_or(Err(SharingError::Library))?;
        let sink = Self {
            desk,
            clock: MonotonicClock::of_devices(),
            at_hand: (0..LETTERS).map(|_| Letter::new(message_bytes)).collect(),
            returned,
            thread: Some(thread),
        };
        Ok(Opened { sink, lacks })
    }

    fn post(&mut self, message: &[u8]) -> Result<(), SinkMiss> {
        while let Ok(letter) = self.returned.pop() {
            self.at_hand.push(letter);
        }
        let mut letter = self.at_hand.pop().ok_or(SinkMiss::Refused)?;
        let Some(room) = letter.bytes.get_mut(..message.len()) else {
            self.at_hand.push(letter);
            return Err(SinkMiss::Refused);
        };
        room.copy_from_slice(message);
        letter.length = message.len();
        letter.posted = self.clock.now();
        match self.desk.letters.post(letter) {
            None => Ok(()),
            Some(never_shared) => {
                self.at_hand.push(never_shared);
                Err(SinkMiss::Refused)
            }
        }
    }
}

impl SinkPort for SharedMemorySink {
    fn publish(&mut self, message: &[u8], _frames: &[CanFrame]) -> Result<(), SinkMiss> {
        let posted = self.post(message);
        if self.desk.has_failed.swap(false, Ordering::Relaxed) {
            return Err(SinkMiss::Refused);
        }
        posted
    }

    fn fault(&self) -> Faults {
        Faults::SHARING_FAILED
    }

    fn prepare(&mut self) {
        self.desk.letters.forewarn();
    }
}

impl Drop for SharedMemorySink {
    /// The last message is shared before the service goes. A library that hangs over it is left to the end of the process.
    fn drop(&mut self) {
        self.desk.letters.close();
        let Some(thread) = self.thread.take() else {
            return;
        };
        let until = Instant::now() + CLOSING;
        while !thread.is_finished() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
        if thread.is_finished() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests;
