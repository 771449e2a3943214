//! The sharing thread: takes letters, writes messages, clears up after readers.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use freespace::emit::FreeSpaceMessage;
use freespace::port::SinkMiss;
use rtrb::Producer;

use super::leftovers::{IN_THE_MAKING, clear_away};
use super::writer::Writer;
use super::{Desk, LETTERS, Letter, SharingConfig, SharingError};
use crate::runtime::rights::{Lacks, RealTimeConfig, ThreadRole, enter};

/// How often dead readers are looked for: with every message of a module that makes two a second. One that is started anew by a
/// supervisor finds its place free by then.
const CLEAR_AWAY_EVERY: Duration = Duration::from_millis(400);

/// Times that the service is made anew after the library panicked; each panic takes a letter with it.
const REOPENINGS: usize = LETTERS - 1;

pub(super) struct Body {
    pub(super) desk: Arc<Desk>,
    pub(super) back: Producer<Box<Letter>>,
    pub(super) config: SharingConfig,
    pub(super) real_time: RealTimeConfig,
}

impl Body {
    /// Runs until the sink is dropped; says first whether there is a service.
    pub(super) fn run(mut self, tell: &Sender<Result<Lacks, SharingError>>) {
        let entered = enter(ThreadRole::Sharing, &self.real_time);
        self.desk.letters.claim();
        let opened = Writer::open(&self.config);
        let mut writer = match opened {
            Ok(writer) => writer,
            Err(error) => {
                let _ = tell.send(Err(error));
                return;
            }
        };
        let _ = tell.send(Ok(entered.lacks));
        for _ in 0..=REOPENINGS {
            let served = catch_unwind(AssertUnwindSafe(|| self.serve(&writer)));
            if served.is_ok() {
                return;
            }
            self.desk.has_failed.store(true, Ordering::Relaxed);
            drop(writer);
            writer = match Writer::open(&self.config) {
                Ok(writer) => writer,
                Err(_) => return,
            };
        }
    }

    fn serve(&mut self, writer: &Writer) {
        let mut cleared = Instant::now();
        while let Some(letter) = self.desk.letters.wait_forewarned(|| writer.announce()) {
            let written = FreeSpaceMessage::decode_own(&letter.bytes[..letter.length])
                .map_err(|_| SinkMiss::Refused)
                .and_then(|message| writer.write(&message, letter.posted));
            if written.is_err() {
                self.desk.has_failed.store(true, Ordering::Relaxed);
            }
            // There is room for every letter.
            let _ = self.back.push(letter);
            if cleared.elapsed() > CLEAR_AWAY_EVERY {
                clear_away(IN_THE_MAKING);
                cleared = Instant::now();
            }
        }
    }
}
