//! Publications to a CAN interface.
//!
//! In: a message and its classic frames; where the configuration wants it, the grid is taken out of the message and follows in
//! CAN FD frames. Out: frames for the CAN thread, through a bounded ring. Invariant: never waits; a publication goes into the ring
//! as a whole, or is refused: the ring is full, or the interface is away or off the bus. Where an
//! earlier one did not leave, the next is sent and told refused. Cost: a copy of 80 bytes a frame, and for the grid its check sums.
//! Dropped, it waits until the last frames have left, 0.3 s at most.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use freespace::emit::{CanFrame, FreeSpaceMessage, GridEncoder};
use freespace::port::{SinkMiss, SinkPort};
use rtrb::Producer;

use crate::can::{Ends, OutState, Outgoing};

/// The publisher's end.
pub struct SocketcanSink {
    ring: Producer<Outgoing>,
    state: Arc<OutState>,
    ends: Ends,
    grid: Option<GridEncoder>,
    grid_frames: usize,
    publication: u32,
}

impl SocketcanSink {
    pub(crate) fn new(
        ring: Producer<Outgoing>,
        state: Arc<OutState>,
        ends: Ends,
        grid_frames: usize,
    ) -> Self {
        Self {
            ring,
            state,
            ends,
            grid: (grid_frames > 0).then(GridEncoder::default),
            grid_frames,
            publication: 0,
        }
    }

    fn refuse(&self) -> SinkMiss {
        self.ends.refused();
        SinkMiss::Refused
    }
}

impl SinkPort for SocketcanSink {
    fn publish(&mut self, message: &[u8], frames: &[CanFrame]) -> Result<(), SinkMiss> {
        let needed = frames.len() + self.grid_frames;
        if !self.state.is_open.load(Ordering::Acquire) || self.ring.slots() < needed {
            return Err(self.refuse());
        }
        let decoded = match (&self.grid, FreeSpaceMessage::decode_own(message)) {
            (None, _) => None,
            (Some(_), Ok(message)) => Some(message),
            (Some(_), Err(_)) => return Err(self.refuse()),
        };
        self.publication = self.publication.wrapping_add(1);
        let publication = self.publication;
        // From now on the thread drops what is left of the last one.
        self.state.newest.store(publication, Ordering::Release);
        let ring = &mut self.ring;
        let mut push = |frame: &CanFrame| {
            let frame = frame.clone();
            // There is room: a larger grid than the configured one would be cut, and its reader would refuse it.
            let _ = ring.push(Outgoing { publication, frame });
        };
        frames.iter().for_each(&mut push);
        if let (Some(grid), Some(message)) = (&mut self.grid, &decoded) {
            grid.encode(message, &mut push);
        }
        self.ends.ring();
        if self.state.has_dropped.swap(false, Ordering::Relaxed) {
            // This one is on its way; that an earlier one did not arrive whole is said all the same.
            return Err(self.refuse());
        }
        Ok(())
    }
}
