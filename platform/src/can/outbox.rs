//! Frames on their way out: the ring between publisher and CAN thread, and what is dropped from it.
//!
//! In: frames of publications, in the order to send them. Out: the one to send next. Invariant: frames of an older publication
//! never leave after a newer one came, and none leaves later than a period after the thread first saw its publication.
//! Cost: constant for a frame. A full ring refuses the publication as a whole; whoever publishes counts it.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use freespace::emit::CanFrame;
use rtrb::Consumer;

use super::counters::Counters;

/// A frame and the publication that it belongs to.
pub(crate) struct Outgoing {
    pub(crate) publication: u32,
    pub(crate) frame: CanFrame,
}

/// What publisher and CAN thread share.
#[derive(Debug, Default)]
pub(crate) struct OutState {
    /// The newest publication.
    pub(crate) newest: AtomicU32,
    /// Whether frames can leave now.
    pub(crate) is_open: AtomicBool,
    /// Frames were dropped that should have left: the next publication is told so.
    pub(crate) has_dropped: AtomicBool,
    /// Nothing will be published any more.
    pub(crate) is_closing: AtomicBool,
    /// All that could leave has left: the thread needs not be waited for.
    pub(crate) is_flushed: AtomicBool,
}

/// Frames of grids are the long ones.
fn is_of_grid(frame: &CanFrame) -> bool {
    frame.data.len() > 8
}

/// The thread's end.
pub(super) struct Outbox {
    ring: Consumer<Outgoing>,
    next: Option<Outgoing>,
    /// The publication that is leaving, and when it was first seen.
    leaving: Option<(u32, u64)>,
    period_ns: u64,
}

impl Outbox {
    pub(super) fn new(ring: Consumer<Outgoing>, period_micros: u64) -> Self {
        Self {
            ring,
            next: None,
            leaving: None,
            period_ns: period_micros * 1000,
        }
    }

    /// The frame to send next, once what is too old was dropped.
    pub(super) fn next(&mut self, now_ns: u64, state: &OutState, counters: &Counters) -> Option<&CanFrame> {
        loop {
            let outgoing = match self.next.take() {
                Some(outgoing) => outgoing,
                None => self.ring.pop().ok()?,
            };
            let publication = outgoing.publication;
            let begun_ns = match self.leaving {
                Some((leaving, begun_ns)) if leaving == publication => begun_ns,
                _ => {
                    self.leaving = Some((publication, now_ns));
                    now_ns
                }
            };
            if publication != state.newest.load(Ordering::Acquire) {
                counters.dropped_for_newer.add(1);
                // A grid that gives way is incomplete to its readers, and no fault; what leaves before it should have left.
                if !is_of_grid(&outgoing.frame) {
                    state.has_dropped.store(true, Ordering::Relaxed);
                }
            } else if now_ns.saturating_sub(begun_ns) > self.period_ns {
                counters.dropped_late.add(1);
                state.has_dropped.store(true, Ordering::Relaxed);
            } else {
                return Some(&self.next.insert(outgoing).frame);
            }
        }
    }

    /// The frame that [`Self::next`] gave is done with.
    pub(super) fn done(&mut self) {
        self.next = None;
    }
}
