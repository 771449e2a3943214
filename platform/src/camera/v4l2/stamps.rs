//! Which stamps are believed, and the index of a frame over all connections.
//!
//! In: the driver's stamps and counts. Out: stamps that rise and lie in the past, indices that rise by one a frame that the
//! camera took. Invariant: a stamp once handed out is never reached again, whatever the driver says later.

use freespace::space::Micros;

use super::Loss;

/// A frame older than this serves no answer: twice the deadline.
const OLDEST_MICROS: u64 = 1_000_000;

/// Judges stamps.
#[derive(Debug)]
pub(super) struct StampGate {
    offset_micros: i64,
    last: Option<Micros>,
}

impl StampGate {
    pub(super) const fn new(offset_micros: i64) -> Self {
        Self {
            offset_micros,
            last: None,
        }
    }

    /// The capture stamp of a frame stamped `raw` by its driver, seen at `now`.
    pub(super) fn pass(&mut self, raw: Micros, now: Micros) -> Result<Micros, Loss> {
        let stamp = Micros(raw.0.saturating_add_signed(self.offset_micros));
        // A driver that stamps the end of a frame before it is there is set right by the offset.
        if stamp > now {
            return Err(Loss::StampAhead);
        }
        if now.since(stamp) > OLDEST_MICROS {
            return Err(Loss::StampOld);
        }
        if self.last.is_some_and(|last| stamp <= last) {
            return Err(Loss::StampBack);
        }
        self.last = Some(stamp);
        Ok(stamp)
    }
}

/// Numbers frames.
#[derive(Debug, Default)]
pub(super) struct FrameCount {
    /// Index that the next frame has where none is missing.
    next: u64,
    /// The driver's count of the last frame of this connection.
    sequence: Option<u32>,
}

/// A count that jumps further than this was set anew; drivers lose frames by dozens.
const LARGEST_GAP: u32 = 100_000;

impl FrameCount {
    /// Frames that the camera took, with those that are missing.
    pub(super) const fn taken(&self) -> u64 {
        self.next
    }

    /// A new connection counts anew.
    pub(super) const fn reconnect(&mut self) {
        self.sequence = None;
    }

    /// The index of a frame with that count of the driver, and how many are missing before it.
    pub(super) fn take(&mut self, sequence: u32) -> (u64, u64) {
        let step = self.sequence.map_or(1, |last| sequence.wrapping_sub(last));
        // A count that stands still, goes back or jumps tells nothing.
        let missing = match step {
            1..=LARGEST_GAP => u64::from(step - 1),
            _ => 0,
        };
        self.sequence = Some(sequence);
        let index = self.next + missing;
        self.next = index + 1;
        (index, missing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_is_believed_where_it_rises_and_lies_in_the_past() {
        let mut gate = StampGate::new(-5_000);
        let now = Micros(5_000_000);
        assert_eq!(gate.pass(Micros(5_005_001), now), Err(Loss::StampAhead));
        assert_eq!(gate.pass(Micros(0), now), Err(Loss::StampOld));
        assert_eq!(gate.pass(Micros(4_900_000), now), Ok(Micros(4_895_000)));
        assert_eq!(gate.pass(Micros(4_900_000), now), Err(Loss::StampBack));
        assert_eq!(gate.pass(Micros(4_800_000), now), Err(Loss::StampBack));
        assert_eq!(gate.pass(Micros(4_900_001), now), Ok(Micros(4_895_001)));
        assert_eq!(
            StampGate::new(5_000).pass(Micros(4_999_000), now),
            Err(Loss::StampAhead),
            "an offset leads into the future"
        );
    }

    #[test]
    fn indices_rise_over_gaps_wraps_resets_and_connections() {
        let mut count = FrameCount::default();
        let taken = [u32::MAX - 1, u32::MAX, 2, 2, 0, 1_000_000].map(|sequence| count.take(sequence));
        assert_eq!(taken, [(0, 0), (1, 0), (4, 2), (5, 0), (6, 0), (7, 0)]);
        count.reconnect();
        assert_eq!(count.take(40), (8, 0));
    }
}
