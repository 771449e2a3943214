//! Hand-overs between threads, wait-free on both sides: a mailbox in which the newest wins, and the bell that wakes a thread.
//!
//! In, Out: boxes that circulate; they are made before the start. Invariant: neither side locks, allocates or waits for the
//! other; a thread waits only by parking itself, until its bell rings. Cost: one atomic exchange, and one wake-up call of the
//! kernel. A full mailbox gives the older box back to whoever posts the newer one, who counts it. Queues are `rtrb` rings.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};

use crossbeam_utils::atomic::AtomicCell;
use freespace::port::Clock as _;
use freespace::space::Micros;

use crate::clock::MonotonicClock;

/// Wakes the one thread that claimed it.
#[derive(Debug, Default)]
pub(super) struct Bell(OnceLock<Thread>);

impl Bell {
    /// The calling thread will be woken. A bell has one owner for ever.
    pub(super) fn claim(&self) {
        let _ = self.0.set(thread::current());
    }

    /// Wakes the owner, or lets its next wait return at once.
    pub(super) fn ring(&self) {
        if let Some(owner) = self.0.get() {
            owner.unpark();
        }
    }
}

/// Waits for the calling thread's bell, at most until `until`. May return early: look again at what was waited for.
pub(super) fn wait(clock: &MonotonicClock, until: Option<Micros>) {
    match until {
        None => thread::park(),
        Some(until) if clock.now() >= until => {}
        Some(until) => thread::park_timeout(clock.until(until)),
    }
}

/// Room for one box; the newest wins.
pub(crate) struct Mailbox<T> {
    slot: AtomicCell<Option<Box<T>>>,
    bell: Bell,
    is_closed: AtomicBool,
    /// A box was promised, and is not there yet.
    is_forewarned: AtomicBool,
}

/// How long the owner of a mailbox stays awake for a box that it was promised; the promise may be broken.
const AWAKE: Duration = Duration::from_micros(300);

impl<T> Default for Mailbox<T> {
    fn default() -> Self {
        const { assert!(AtomicCell::<Option<Box<T>>>::is_lock_free()) };
        Self {
            slot: AtomicCell::new(None),
            bell: Bell::default(),
            is_closed: AtomicBool::new(false),
            is_forewarned: AtomicBool::new(false),
        }
    }
}

impl<T> Mailbox<T> {
    /// Puts a box in and wakes the owner; gives back the one that it displaced.
    pub(crate) fn post(&self, item: Box<T>) -> Option<Box<T>> {
        let displaced = self.slot.swap(Some(item));
        self.is_forewarned.store(false, Ordering::Release);
        self.bell.ring();
        displaced
    }

    /// What waits in the box.
    pub(super) fn take(&self) -> Option<Box<T>> {
        self.slot.take()
    }

    /// The calling thread will wait here.
    pub(crate) fn claim(&self) {
        self.bell.claim();
    }

    /// Wakes the owner before there is a box: waking takes longer than most boxes take to come.
    pub(crate) fn forewarn(&self) {
        self.is_forewarned.store(true, Ordering::Release);
        self.bell.ring();
    }

    /// Waits for the next box; none once the mailbox is closed and empty.
    pub(crate) fn wait(&self) -> Option<Box<T>> {
        self.wait_forewarned(|| {})
    }

    /// As [`Mailbox::wait`]; forewarned, it does `first` and stays awake for a moment.
    pub(crate) fn wait_forewarned(&self, mut first: impl FnMut()) -> Option<Box<T>> {
        loop {
            if self.is_forewarned.load(Ordering::Acquire) {
                first();
                self.stay_awake();
            }
            if let Some(item) = self.take() {
                return Some(item);
            }
            if self.is_closed.load(Ordering::Acquire) {
                return self.take();
            }
            thread::park();
        }
    }

    /// Does not sleep while a box is promised, but at most for [`AWAKE`].
    fn stay_awake(&self) {
        let begin = Instant::now();
        while self.is_forewarned.load(Ordering::Acquire) && begin.elapsed() < AWAKE {
            core::hint::spin_loop();
        }
        self.is_forewarned.store(false, Ordering::Release);
    }

    /// Waits for the next box, at most until `until`.
    pub(super) fn wait_until(&self, clock: &MonotonicClock, until: Micros) -> Option<Box<T>> {
        loop {
            if let Some(item) = self.take() {
                return Some(item);
            }
            if self.is_closed.load(Ordering::Acquire) || clock.now() >= until {
                return self.take();
            }
            wait(clock, Some(until));
        }
    }

    /// Nothing will be posted any more.
    pub(crate) fn close(&self) {
        self.is_closed.store(true, Ordering::Release);
        self.bell.ring();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use std::sync::Arc;

    #[test]
    fn the_newest_wins_and_the_older_comes_back() {
        let mailbox = Mailbox::default();
        assert!(mailbox.post(Box::new(1)).is_none());
        assert_eq!(mailbox.post(Box::new(2)).as_deref(), Some(&1));
        assert_eq!(mailbox.take().as_deref(), Some(&2));
        assert!(mailbox.take().is_none());
    }

    #[test]
    fn no_box_is_lost_between_two_threads() {
        let mailbox = Arc::new(Mailbox::default());
        let reader = {
            let mailbox = Arc::clone(&mailbox);
            thread::spawn(move || {
                mailbox.claim();
                let mut seen = Vec::new();
                while let Some(number) = mailbox.wait() {
                    seen.push(*number);
                }
                seen
            })
        };
        let displaced: Vec<u32> = (0..10_000)
            .filter_map(|number| mailbox.post(Box::new(number)))
            .map(|number| *number)
            .collect();
        mailbox.close();
        let mut all = reader.join().unwrap();
        assert!(
            all.is_sorted(),
            "a reader never sees an older box after a newer one"
        );
        assert_eq!(all.last(), Some(&9_999), "the last one is never lost");
        all.extend(displaced);
        all.sort_unstable();
        assert!(all.into_iter().eq(0..10_000));
    }

    #[test]
    fn a_promise_that_is_broken_holds_nobody_up() {
        let mailbox = Arc::new(Mailbox::default());
        let reader = {
            let mailbox = Arc::clone(&mailbox);
            thread::spawn(move || {
                mailbox.claim();
                std::iter::from_fn(|| mailbox.wait())
                    .map(|number| *number)
                    .collect::<Vec<u32>>()
            })
        };
        mailbox.forewarn();
        thread::sleep(10 * AWAKE);
        mailbox.forewarn();
        assert!(mailbox.post(Box::new(7)).is_none());
        mailbox.forewarn();
        mailbox.close();
        assert_eq!(reader.join().unwrap(), [7]);
    }

    #[test]
    fn a_wait_ends_at_its_time() {
        let mailbox = Mailbox::<u8>::default();
        let clock = MonotonicClock::default();
        assert!(mailbox.wait_until(&clock, clock.now().plus(1_000)).is_none());
    }
}
