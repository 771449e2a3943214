//! How far a run is, for a person at a terminal.

use freespace::port::Clock as _;

use crate::cli::terminal;
use crate::clock::MonotonicClock;
use crate::statistics::Publication;

/// One line on standard error that is written over again, twice a second; nothing where that is no terminal.
pub(in crate::cli) struct Progress {
    /// Frames of the whole run, where that has an end.
    frames: Option<usize>,
    clock: MonotonicClock,
    shown_micros: u64,
    key_frames: u64,
    misses: u64,
    is_shown: bool,
}

impl Progress {
    /// For a run of `frames` frames; of any number where there is none.
    pub(in crate::cli) fn new(frames: Option<usize>) -> Self {
        use std::io::IsTerminal as _;
        Self {
            frames,
            clock: MonotonicClock::default(),
            shown_micros: 0,
            key_frames: 0,
            misses: 0,
            is_shown: std::io::stderr().is_terminal(),
        }
    }

    pub(super) fn publication(&mut self, publication: &Publication) {
        self.key_frames += 1;
        self.misses += u64::from(publication.is_miss);
    }

    /// Makes room for a line of its own.
    pub(super) fn interrupt(&self) {
        self.end();
    }

    pub(super) fn frame(&mut self, index: u64) {
        let now = self.clock.now().0;
        if self.is_shown && now > self.shown_micros + 500_000 {
            self.shown_micros = now;
            let of = self
                .frames
                .map(|frames| format!(" of {frames}"))
                .unwrap_or_default();
            terminal::tell_over(format_args!(
                "\rframe {:>5}{of}   key frames {}   misses {} ",
                index + 1,
                self.key_frames,
                self.misses
            ));
        }
    }

    pub(super) fn end(&self) {
        if self.is_shown {
            terminal::tell_over(format_args!("\r{:78}\r", ""));
        }
    }
}
