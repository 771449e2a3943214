//! The CAN thread: steps its links, waits for frames, publications or time.
//!
//! In: links. Invariant: each turn does a bounded amount of work, each wait is bounded. What the sink took last is sent before
//! the thread ends, for [`FLUSH_NS`] at most. Cost: two system calls a wake-up beside those of the frames.

use std::os::fd::{AsFd as _, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::time::{ClockId, clock_gettime};

use super::IDLE_NS;
use super::counters::{Counters, Teller};
use super::link::Link;
use super::outbox::OutState;
use super::wire::{Adapter, Now};
use crate::runtime::allocation::RealTimeScope;

/// How long the last publication may take to leave.
const FLUSH_NS: u64 = 200_000_000;
/// How often whoever dropped the sink looks whether it has left.
const FLUSH_LOOK: std::time::Duration = std::time::Duration::from_millis(1);
/// Bell and interfaces.
const MOST_DESCRIPTORS: usize = 3;

/// What the thread shares with its devices.
pub(super) struct Shared {
    pub(super) counters: Arc<Counters>,
    pub(super) out: Arc<OutState>,
    bell: OwnedFd,
    has_wheels: AtomicBool,
    has_sink: AtomicBool,
}

impl Shared {
    pub(super) fn new() -> std::io::Result<Self> {
        Ok(Self {
            counters: Arc::default(),
            out: Arc::default(),
            bell: eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?,
            has_wheels: AtomicBool::new(false),
            has_sink: AtomicBool::new(false),
        })
    }

    /// Wakes the thread; never waits, for the bell's count cannot come near its end.
    fn ring(&self) {
        let _ = rustix::io::write(&self.bell, &1_u64.to_ne_bytes());
    }

    fn is_over(&self) -> bool {
        let is_sent = !self.has_sink.load(Ordering::Acquire) || self.out.is_flushed.load(Ordering::Acquire);
        is_sent && !self.has_wheels.load(Ordering::Acquire)
    }
}

/// A device's hold on the thread, which ends with its last device.
pub(crate) struct Ends {
    shared: Arc<Shared>,
    is_sink: bool,
}

impl Ends {
    pub(super) fn of_wheels(shared: &Arc<Shared>) -> Self {
        shared.has_wheels.store(true, Ordering::Release);
        Self {
            shared: Arc::clone(shared),
            is_sink: false,
        }
    }

    pub(super) fn of_sink(shared: &Arc<Shared>) -> Self {
        shared.has_sink.store(true, Ordering::Release);
        Self {
            shared: Arc::clone(shared),
            is_sink: true,
        }
    }

    /// Wakes the thread.
    pub(crate) fn ring(&self) {
        self.shared.ring();
    }

    /// Counts a publication that was refused.
    pub(crate) fn refused(&self) {
        self.shared.counters.publications_refused.add(1);
    }
}

impl Drop for Ends {
    /// The sink waits, bounded, until what it took has left: the process may end right after.
    fn drop(&mut self) {
        let shared = &self.shared;
        if !self.is_sink {
            shared.has_wheels.store(false, Ordering::Release);
            return shared.ring();
        }
        shared.out.is_closing.store(true, Ordering::Release);
        shared.ring();
        let begin_ns = now().monotonic_ns;
        while !shared.out.is_flushed.load(Ordering::Acquire)
            && now().monotonic_ns.saturating_sub(begin_ns) < FLUSH_NS + IDLE_NS
        {
            std::thread::sleep(FLUSH_LOOK);
        }
    }
}

/// The thread's own.
pub(super) struct Thread<A: Adapter> {
    links: Vec<Link<A>>,
    teller: Teller,
    shared: Arc<Shared>,
    closing_ns: Option<u64>,
}

impl<A: Adapter> Thread<A> {
    pub(super) fn new(links: Vec<Link<A>>, teller: Teller, shared: Arc<Shared>) -> Self {
        Self {
            links,
            teller,
            shared,
            closing_ns: None,
        }
    }

    /// Runs until the last device is dropped.
    pub(super) fn run(mut self) {
        let scope = RealTimeScope::enter();
        let mut allocations = 0;
        while !self.shared.is_over() {
            // What is rung for from now on is seen by the next turn.
            let _ = rustix::io::read(&self.shared.bell, &mut [0_u8; 8]);
            let until_ns = self.turn();
            self.wait(until_ns);
            let counted = scope.allocations();
            self.shared.counters.allocations.add(counted - allocations);
            allocations = counted;
        }
    }

    /// One turn; when the next is due.
    fn turn(&mut self) -> u64 {
        let mut until_ns = u64::MAX;
        for link in &mut self.links {
            until_ns = until_ns.min(link.step(&now, &mut self.teller));
        }
        let now_ns = now().monotonic_ns;
        let out = &self.shared.out;
        // Flushed once; the wheels may live on.
        if out.is_closing.load(Ordering::Acquire) && !out.is_flushed.load(Ordering::Acquire) {
            let begun_ns = *self.closing_ns.get_or_insert(now_ns);
            let waits = self.links.iter_mut().any(|link| link.has_to_send(now_ns));
            if !waits || now_ns.saturating_sub(begun_ns) > FLUSH_NS {
                out.is_flushed.store(true, Ordering::Release);
                return now_ns;
            }
            return until_ns.min(begun_ns + FLUSH_NS + 1);
        }
        until_ns
    }

    fn wait(&self, until_ns: u64) {
        let left_ns = until_ns.saturating_sub(now().monotonic_ns).min(IDLE_NS);
        let timeout = Timespec {
            tv_sec: 0,
            tv_nsec: i64::try_from(left_ns).unwrap_or(0),
        };
        let bell = || PollFd::from_borrowed_fd(self.shared.bell.as_fd(), PollFlags::IN);
        let mut descriptors = [bell(), bell(), bell()];
        let mut count = 1;
        for fd in self.links.iter().filter_map(Link::descriptor) {
            if count < MOST_DESCRIPTORS {
                descriptors[count] = PollFd::from_borrowed_fd(fd, PollFlags::IN);
                count += 1;
            }
        }
        // A signal ends the wait early, which does no harm.
        let _ = poll(&mut descriptors[..count], Some(&timeout));
    }
}

/// Times that the clocks are read where the thread was interrupted between them.
const CLOCK_READINGS: u32 = 3;
/// Spread of a reading that was not interrupted.
const CLOCK_SPREAD_NS: u64 = 5_000;

/// Both clocks, one right after the other.
pub(super) fn now() -> Now {
    let mut best = read_clocks();
    for _ in 1..CLOCK_READINGS {
        if best.spread_ns <= CLOCK_SPREAD_NS {
            break;
        }
        let again = read_clocks();
        if again.spread_ns < best.spread_ns {
            best = again;
        }
    }
    best
}

fn read_clocks() -> Now {
    let before_ns = nanos(ClockId::Monotonic);
    let realtime_ns = nanos(ClockId::Realtime);
    let monotonic_ns = nanos(ClockId::Monotonic);
    Now {
        monotonic_ns,
        realtime_ns,
        spread_ns: monotonic_ns.saturating_sub(before_ns),
    }
}

fn nanos(clock: ClockId) -> u64 {
    let time = clock_gettime(clock);
    // Neither clock is before its start.
    let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
    seconds * 1_000_000_000 + u64::try_from(time.tv_nsec).unwrap_or(0)
}
