//! When the next frame may be handed to the transmit queue, so that it never fills: the default queue holds ten frames.
//!
//! In: each frame's time on the bus. Out: the time until the next may go. Invariant: on a bus that others leave to us, at most
//! [`BURST_FRAMES`] of our frames wait in the queue; over time our frames take no more than the configured share of the bus.
//! Where others fill the bus the queue fills all the same: the kernel then says `ENOBUFS`, and the frame is tried again.

/// Frames that are handed over at once: more than half of the default queue would leave others no room, fewer would let a kernel
/// whose timers are as coarse as 10 ms send a grid too slowly.
const BURST_FRAMES: u64 = 6;
/// Wait after a full queue, unless a frame takes longer: so that a jammed bus costs no more than 2,000 calls a second.
const RETRY_NS: u64 = 500_000;

/// Paces frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pacer {
    /// Share of the bus, in thousandths.
    share_thousandths: u64,
    /// When all that was handed over has left, at our share.
    free_ns: u64,
    /// Not before this, after a full queue.
    retry_ns: u64,
}

impl Pacer {
    /// Paces to a share of the bus's time, of 0.01 to 1.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 1 to 1000"
    )]
    pub(super) fn new(share: f64) -> Self {
        Self {
            share_thousandths: (share * 1e3).clamp(1.0, 1e3) as u64,
            free_ns: 0,
            retry_ns: 0,
        }
    }

    /// When a frame of `frame_ns` on the bus may go, where that is later than `now_ns`: once the burst before it has nearly left,
    /// for a wake-up a burst costs a sixth of one a frame.
    pub(super) fn wait_until(&self, now_ns: u64, frame_ns: u64) -> Option<u64> {
        let frame = self.spread(frame_ns);
        let full = self
            .free_ns
            .saturating_sub((BURST_FRAMES - 1) * frame)
            .max(self.retry_ns);
        (full > now_ns).then(|| full.max(self.free_ns.saturating_sub(frame)))
    }

    /// A frame was taken by the queue.
    pub(super) fn sent(&mut self, now_ns: u64, frame_ns: u64) {
        self.free_ns = self.free_ns.max(now_ns) + self.spread(frame_ns);
    }

    /// The queue was full.
    pub(super) fn refused(&mut self, now_ns: u64, frame_ns: u64) {
        self.retry_ns = now_ns + frame_ns.max(RETRY_NS);
    }

    const fn spread(&self, frame_ns: u64) -> u64 {
        frame_ns * 1000 / self.share_thousandths
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A queue of `length` frames on a bus whose frames take `frame_ns`; how many it refused of `frames`, and when the last left.
    fn send(mut pacer: Pacer, frames: usize, frame_ns: u64, length: usize) -> (usize, u64) {
        let (mut now, mut refused, mut leaves) = (0, 0, Vec::<u64>::new());
        for _ in 0..frames {
            loop {
                now = pacer.wait_until(now, frame_ns).unwrap_or(now);
                if leaves.iter().filter(|at| **at > now).count() < length {
                    break;
                }
                refused += 1;
                pacer.refused(now, frame_ns);
            }
            pacer.sent(now, frame_ns);
            let begin = leaves.last().map_or(now, |at| (*at).max(now));
            leaves.push(begin + frame_ns);
        }
        (refused, leaves.last().copied().unwrap_or(0))
    }

    #[test]
    fn a_queue_of_ten_never_fills() {
        for share in [0.1, 0.5, 1.0] {
            assert_eq!(send(Pacer::new(share), 500, 270_000, 6).0, 0, "share {share}");
        }
    }

    #[test]
    fn the_share_of_the_bus_is_kept() {
        let (_, last_ns) = send(Pacer::new(0.5), 208, 408_000, 10);
        assert!((160_000_000..=170_000_000).contains(&last_ns), "{last_ns}");
    }

    #[test]
    fn a_full_queue_is_tried_again_after_a_while() {
        let mut pacer = Pacer::new(1.0);
        pacer.refused(1000, 100);
        assert_eq!(pacer.wait_until(1000, 100), Some(501_000));
        assert_eq!(pacer.wait_until(501_000, 100), None);
        // A shorter queue than our burst refuses, and all frames leave all the same.
        assert!(send(Pacer::new(1.0), 50, 270_000, 2).1 <= 60 * 270_000 + 50 * RETRY_NS);
    }
}
