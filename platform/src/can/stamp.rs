//! Receive stamps on the one clock of the module: `CLOCK_REALTIME`, or the adapter's own clock, to `CLOCK_MONOTONIC`.
//!
//! In: a frame's stamp, and both clocks as read right after it was received. Out: nanoseconds of `CLOCK_MONOTONIC`.
//! Invariant: a stamp lies between the instant at which the socket's queue was last seen empty and the receipt, and never
//! before the stamp of the frame before it; so a step of the wall clock, by whatever amount, moves no reading.
//! Cost: constant. A stamp that fits no known offset of the clocks is replaced by the receipt, and counted.

use super::wire::Now;

/// The two clocks are read one after the other, and frames are stamped on another core.
const SLACK_NS: i64 = 50_000;
/// A change of the clocks' offset beyond this is a step; slewing changes it by 0.5 ms a second at most.
const STEP_NS: i64 = 5_000_000;
/// Over this long the smallest delay of an adapter's stamps is looked for: crystals drift by 0.1 ms in it.
const WINDOW_NS: u64 = 2_000_000_000;
/// An adapter's clock that is off by more was set anew.
const RESTART_NS: i64 = 20_000_000;

/// Where a stamp came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StampSource {
    /// The adapter.
    Hardware,
    /// The kernel's receive interrupt.
    Software,
    /// The receiving thread, for the frame had no stamp that fits.
    Receipt,
}

/// Maps the stamps of one socket.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StampMap {
    /// When the queue was last seen empty.
    emptied_ns: u64,
    /// `CLOCK_REALTIME` less `CLOCK_MONOTONIC`, before the last step and now.
    offsets_ns: Option<[i64; 2]>,
    last_ns: u64,
    hardware: HardwareClock,
    steps: u64,
}

impl StampMap {
    /// A map of a socket that was opened at `now`: no frame in it is older.
    pub(super) fn opened(&mut self, now: Now) {
        self.emptied_ns = now.monotonic_ns;
        self.hardware = HardwareClock::default();
        self.note_offset(now);
    }

    /// The queue was seen empty right after `now`.
    pub(super) fn emptied(&mut self, now: Now) {
        self.emptied_ns = now.monotonic_ns;
        self.note_offset(now);
    }

    /// Steps of the wall clock that were seen.
    pub(super) const fn steps(&self) -> u64 {
        self.steps
    }

    /// The stamp of a frame that was received right before `now`.
    pub(super) fn monotonic(
        &mut self,
        now: Now,
        software_ns: Option<u64>,
        hardware_ns: Option<u64>,
    ) -> (u64, StampSource) {
        self.note_offset(now);
        let fitting = software_ns.and_then(|stamp| self.fitting(now, stamp));
        let (mut stamp_ns, mut source) = fitting.map_or((now.monotonic_ns, StampSource::Receipt), |stamp| {
            (stamp, StampSource::Software)
        });
        if let Some(hardware_ns) = hardware_ns {
            let sharper = self.hardware.monotonic(stamp_ns, hardware_ns);
            if sharper.saturating_add_signed(SLACK_NS) >= self.emptied_ns {
                (stamp_ns, source) = (sharper, StampSource::Hardware);
            }
        }
        self.last_ns = stamp_ns.clamp(self.last_ns.min(now.monotonic_ns), now.monotonic_ns);
        (self.last_ns, source)
    }

    fn note_offset(&mut self, now: Now) {
        let offset = now.realtime_ns.wrapping_sub(now.monotonic_ns).cast_signed();
        match &mut self.offsets_ns {
            None => self.offsets_ns = Some([offset; 2]),
            Some([before, latest]) => {
                let apart_ns = latest.abs_diff(offset);
                if apart_ns > STEP_NS.unsigned_abs().saturating_add(now.spread_ns) {
                    *before = *latest;
                    self.steps += 1;
                } else if now.spread_ns > SLACK_NS.unsigned_abs() {
                    // Interrupted between the clocks: the offset known is better.
                    return;
                }
                *latest = offset;
            }
        }
    }

    /// The stamp by the present offset, else by that before the last step, where it is one that this frame can have.
    fn fitting(&self, now: Now, stamp_ns: u64) -> Option<u64> {
        let [before, latest] = self.offsets_ns?;
        [latest, before].into_iter().find_map(|offset| {
            let stamp = stamp_ns.wrapping_sub(offset.cast_unsigned());
            let earliest = self.emptied_ns.saturating_sub(SLACK_NS.unsigned_abs());
            let latest = now.monotonic_ns.saturating_add(SLACK_NS.unsigned_abs());
            (earliest..=latest)
                .contains(&stamp)
                .then(|| stamp.min(now.monotonic_ns))
        })
    }
}

/// The clock of an adapter: the smallest delay between its stamp and the kernel's tells how far apart the clocks are.
#[derive(Clone, Copy, Debug, Default)]
struct HardwareClock {
    begun_ns: u64,
    /// `CLOCK_MONOTONIC` less the adapter's clock, smallest of the window before and of this one.
    offsets_ns: Option<[i64; 2]>,
}

impl HardwareClock {
    fn monotonic(&mut self, software_ns: u64, hardware_ns: u64) -> u64 {
        let offset = software_ns.wrapping_sub(hardware_ns).cast_signed();
        let smallest = match self.offsets_ns {
            Some([before, this]) if before.min(this).abs_diff(offset) < RESTART_NS.unsigned_abs() => {
                let offsets = if software_ns.saturating_sub(self.begun_ns) > WINDOW_NS {
                    self.begun_ns = software_ns;
                    [this, offset]
                } else {
                    [before, this.min(offset)]
                };
                self.offsets_ns = Some(offsets);
                offsets[0].min(offsets[1])
            }
            _ => {
                self.begun_ns = software_ns;
                self.offsets_ns = Some([offset; 2]);
                offset
            }
        };
        hardware_ns.wrapping_add(smallest.cast_unsigned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WALL: u64 = 1_700_000_000_000_000_000;
    const MS: u64 = 1_000_000;

    fn at(monotonic_ns: u64, step: i64) -> Now {
        Now {
            monotonic_ns,
            realtime_ns: (WALL + monotonic_ns).wrapping_add(step.cast_unsigned()),
            spread_ns: 100,
        }
    }

    proptest! {
        #[test]
        fn a_step_of_the_clock_moves_no_reading(
            step in -3_000_000_000_i64..3_000_000_000,
            delay_us in 0_u64..400,
            step_at in 0_usize..40,
            stamped_before: bool,
        ) {
            let mut map = StampMap::default();
            map.opened(at(0, 0));
            for frame in 0..80_usize {
                let captured = (frame as u64 + 1) * 10 * MS;
                let received = captured + delay_us * 1000;
                // The step falls between two frames, or between a frame's stamp and its receipt.
                let at_receipt = if frame >= step_at { step } else { 0 };
                let at_stamp = if frame == step_at && stamped_before { 0 } else { at_receipt };
                let (stamp, _) = map.monotonic(at(received, at_receipt), Some(at(captured, at_stamp).realtime_ns), None);
                let off = stamp.abs_diff(captured);
                // Where a step is as small as the way since the queue was empty, both readings of the stamp may fit.
                let bound = if at_stamp == at_receipt { 0 } else { 10 * MS };
                prop_assert!(off <= bound, "frame {} is off by {} ns", frame, off);
                prop_assert!(stamp <= received);
                map.emptied(at(received + 1000, at_receipt));
            }
            prop_assert_eq!(map.steps(), u64::from(step.unsigned_abs() > 5 * MS));
        }
    }

    #[test]
    fn an_interruption_between_the_clocks_is_no_step() {
        let mut map = StampMap::default();
        map.opened(at(0, 0));
        map.emptied(Now {
            spread_ns: 30 * MS,
            ..at(100 * MS, -20 * MS.cast_signed())
        });
        let (stamp, source) = map.monotonic(at(110 * MS, 0), Some(WALL + 109 * MS), None);
        assert_eq!((stamp, source, map.steps()), (109 * MS, StampSource::Software, 0));
    }

    #[test]
    fn stamps_never_fall_and_never_lie_ahead() {
        let mut map = StampMap::default();
        map.opened(at(0, 0));
        let (first, source) = map.monotonic(at(5 * MS, 0), Some(WALL + 4 * MS), None);
        assert_eq!((first, source), (4 * MS, StampSource::Software));
        let (second, _) = map.monotonic(at(5 * MS, 0), Some(WALL + 3 * MS), None);
        assert_eq!(second, 4 * MS);
        let (ahead, _) = map.monotonic(at(6 * MS, 0), Some(WALL + 6 * MS + 20_000), None);
        assert_eq!(ahead, 6 * MS);
        let (foreign, source) = map.monotonic(at(7 * MS, 0), Some(12345), None);
        assert_eq!((foreign, source), (7 * MS, StampSource::Receipt));
        let (none, source) = map.monotonic(at(8 * MS, 0), None, None);
        assert_eq!((none, source), (8 * MS, StampSource::Receipt));
    }

    #[test]
    fn an_adapters_stamps_take_the_jitter_of_the_kernels_away() {
        let mut map = StampMap::default();
        map.opened(at(0, 0));
        let mut worst = 0;
        for frame in 1..=1000_u64 {
            let captured = frame * 10 * MS;
            // The adapter's clock began 7 s ago and is 50 ppm fast; the interrupt is up to 0.9 ms late.
            let hardware = 7_000 * MS + captured + captured / 20_000;
            let late = (frame * 7919 % 10) * 100_000;
            let received = at(captured + late + 30_000, 0);
            let (stamp, source) = map.monotonic(received, Some(WALL + captured + late), Some(hardware));
            assert_eq!(source, StampSource::Hardware);
            if frame > 10 {
                worst = worst.max(stamp.abs_diff(captured));
            }
            map.emptied(at(captured + late + 40_000, 0));
        }
        assert!(worst <= 300_000, "{worst} ns");
        // The adapter is plugged in again: its clock begins anew.
        let captured = 20_000 * MS;
        let (stamp, _) = map.monotonic(at(captured + 1000, 0), Some(WALL + captured), Some(5));
        assert_eq!(stamp, captured);
    }
}
