//! Publications to a CAN interface.
//!
//! In: a message and its classic frames; where the configuration wants it, the grid is taken out of the message and follows in
//! CAN FD frames. Out: frames for the CAN thread, through a bounded ring. Invariant: never waits; a publication goes into the ring
//! as a whole, or is refused: the ring is full, or the interface is away or off the bus. Cost: a copy of 80 bytes a frame, and
//! for the grid its check sums. Dropped, it waits until the last frames have left, 0.3 s at most.

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
        if let Some(grid) = &mut self.grid
            && let Ok(message) = FreeSpaceMessage::decode(message)
        {
            grid.encode(&message, &mut push);
        }
        self.ends.ring();
        Ok(())
    }
}
