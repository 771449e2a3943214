//! What leaves for each key frame, and when.
//!
//! In: announcements, answers and failures of the tasks, and the time. Out: [`Verdict`]s and [`Due`]s. Invariant: for every
//! announced key frame, and for every instant of the cadence without one, exactly one publication leaves, at the latest
//! [`Slices::send_by_micros`] after its capture: the answer, or else a fallback. Cost: one pass over the pending key frames.
//! Where more are pending than there is room for, the oldest is given up and counted: that takes a publisher which did not
//! run for 16 key frames.

use super::Slices;
use crate::health::Blame;
use crate::space::{Micros, Pose};

/// A key frame whose answer is awaited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Announcement {
    /// Number of the key frame, as the frame task counts.
    pub sequence: u32,
    /// Index of its frame.
    pub frame: u64,
    /// Capture stamp.
    pub stamp: Micros,
    /// The instant of the cadence that this key frame serves; none where it was asked for out of turn.
    pub due: Option<Micros>,
    /// Pose as tracked, to move the last grid by.
    pub world_from_camera: Pose,
}

/// Why a fallback is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The answer is late: whoever is at work is to blame.
    Late,
    /// The key-frame task gave up, and says whom it blames.
    GivenUp(Blame),
    /// A stage panicked.
    Panicked(Blame),
    /// No frame became a key frame at an instant of the cadence.
    Missing,
}

/// A fallback that is due.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Due {
    /// The key frame that was announced.
    pub announcement: Option<Announcement>,
    /// Its capture stamp; the instant of the cadence where there was no frame.
    pub stamp: Micros,
    /// Why.
    pub cause: Cause,
}

/// What to do with an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is awaited: publish it.
    Publish,
    /// A fallback left in its place: keep it as the base of the next fallback only.
    Late,
}

/// Key frames awaiting their answer.
const PENDING: usize = 16;

#[derive(Clone, Copy, Debug)]
struct Pending {
    due: Due,
    is_over: bool,
}

/// Decides what leaves for each key frame, and when.
#[derive(Debug)]
pub struct Publisher {
    pending: heapless::Vec<Pending, PENDING>,
    slices: Slices,
    period_micros: Option<u64>,
    /// The instant of the cadence that no announcement has served yet.
    expected: Option<Micros>,
    misses: u64,
    late: u64,
    unanswered: u64,
}

impl Publisher {
    /// A publisher that keeps this deadline, for key frames this far apart; none where they come on demand only.
    #[must_use]
    pub fn new(slices: &Slices, period_micros: Option<u64>) -> Self {
        Self {
            pending: heapless::Vec::new(),
            slices: *slices,
            period_micros: period_micros.map(|period| period.max(1)),
            expected: None,
            misses: 0,
            late: 0,
            unanswered: 0,
        }
    }

    /// Expects a first key frame at `stamp`, and answers for it should none come. Without this call the first announcement
    /// sets the cadence.
    pub fn expect_from(&mut self, stamp: Micros) {
        if self.period_micros.is_some() {
            self.expected = Some(stamp);
        }
    }

    /// Expects no further key frame; those announced stay awaited.
    pub fn expect_no_more(&mut self) {
        self.expected = None;
        self.period_micros = None;
    }

    /// Takes note of a key frame. [`Verdict::Late`]: its instant of the cadence was answered already.
    ///
    /// The frames set the phase of the cadence: an instant between the last answered one and the expected one is new, and the
    /// next one is expected a period after it.
    pub fn announce(&mut self, announcement: Announcement) -> Verdict {
        if let (Some(period), Some(due)) = (self.period_micros, announcement.due) {
            if self.expected.is_some_and(|expected| due.plus(period) <= expected) {
                self.late += 1;
                return Verdict::Late;
            }
            self.miss_instants_before(due, period);
            self.expected = Some(due.plus(period));
        }
        self.push(Pending {
            due: Due {
                announcement: Some(announcement),
                stamp: announcement.stamp,
                cause: Cause::Late,
            },
            is_over: false,
        });
        Verdict::Publish
    }

    /// Judges an answer.
    pub fn answer(&mut self, sequence: u32) -> Verdict {
        if let Some(index) = self.find(sequence) {
            self.pending.remove(index);
            return Verdict::Publish;
        }
        self.late += 1;
        Verdict::Late
    }

    /// No answer will come for this key frame: its fallback is due at once.
    pub fn fail(&mut self, sequence: u32, cause: Cause) {
        if let Some(index) = self.find(sequence) {
            self.pending[index].is_over = true;
            self.pending[index].due.cause = cause;
        }
    }

    /// A part that works on no key frame panicked at `now`: an invalid message is due at once.
    pub fn panicked(&mut self, blame: Blame, now: Micros) {
        self.push(Pending {
            due: Due {
                announcement: None,
                stamp: now,
                cause: Cause::Panicked(blame),
            },
            is_over: true,
        });
    }

    /// The instant at which [`Publisher::expire`] must be asked again.
    #[must_use]
    pub fn next_timer(&self) -> Option<Micros> {
        let pending = self.pending.iter().map(|pending| self.send_at(pending));
        let missing = self
            .expected
            .map(|expected| expected.plus(self.slices.send_by_micros));
        pending.chain(missing).min()
    }

    /// A fallback that must leave now; call until none is left.
    pub fn expire(&mut self, now: Micros) -> Option<Due> {
        if let (Some(expected), Some(period)) = (self.expected, self.period_micros)
            && now >= expected.plus(self.slices.send_by_micros)
        {
            self.miss_instant(expected, period);
        }
        let index = self
            .pending
            .iter()
            .position(|pending| now >= self.send_at(pending))?;
        self.misses += 1;
        Some(self.pending.remove(index).due)
    }

    /// Key frames that a fallback answered.
    #[must_use]
    pub const fn misses(&self) -> u64 {
        self.misses
    }

    /// Key frames that nothing answered: the publisher itself did not run.
    #[must_use]
    pub const fn unanswered(&self) -> u64 {
        self.unanswered
    }

    /// Answers and announcements that came after their fallback.
    #[must_use]
    pub const fn late(&self) -> u64 {
        self.late
    }

    fn find(&self, sequence: u32) -> Option<usize> {
        self.pending.iter().position(|pending| {
            pending
                .due
                .announcement
                .is_some_and(|announced| announced.sequence == sequence)
        })
    }

    /// Makes up for instants that passed without a key frame; a gap longer than there is room for is only counted.
    fn miss_instants_before(&mut self, due: Micros, period: u64) {
        let Some(expected) = self.expected else { return };
        let missed = due.since(expected) / period;
        let kept = missed.min(PENDING as u64 / 2);
        self.unanswered += missed - kept;
        self.expected = Some(Micros(due.0.saturating_sub(kept * period)));
        for _ in 0..kept {
            if let Some(expected) = self.expected {
                self.miss_instant(expected, period);
            }
        }
    }

    fn miss_instant(&mut self, expected: Micros, period: u64) {
        self.push(Pending {
            due: Due {
                announcement: None,
                stamp: expected,
                cause: Cause::Missing,
            },
            is_over: false,
        });
        self.expected = Some(expected.plus(period));
    }

    fn push(&mut self, pending: Pending) {
        if self.pending.is_full() {
            self.pending.remove(0);
            self.unanswered += 1;
        }
        // Room was made above.
        let _ = self.pending.push(pending);
    }

    fn send_at(&self, pending: &Pending) -> Micros {
        if pending.is_over {
            Micros(0)
        } else {
            pending.due.stamp.plus(self.slices.send_by_micros)
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::stage::Stage;
    use alloc::vec::Vec;

    const PERIOD: u64 = 500_000;

    fn announcement(sequence: u32, stamp: u64) -> Announcement {
        Announcement {
            sequence,
            frame: 0,
            stamp: Micros(stamp),
            due: Some(Micros(stamp - stamp % PERIOD)),
            world_from_camera: Pose::identity(),
        }
    }

    fn publisher() -> Publisher {
        Publisher::new(&Slices::default(), Some(PERIOD))
    }

    fn stamps_until(publisher: &mut Publisher, now: u64) -> Vec<(u64, Cause)> {
        core::iter::from_fn(|| publisher.expire(Micros(now)))
            .map(|due| (due.stamp.0, due.cause))
            .collect()
    }

    #[test]
    fn an_answer_in_time_is_published_once() {
        let mut publisher = Publisher::new(&Slices::default(), None);
        publisher.announce(announcement(0, 0));
        assert_eq!(publisher.answer(0), Verdict::Publish);
        assert_eq!(publisher.answer(0), Verdict::Late);
        assert_eq!(publisher.next_timer(), None);
        assert_eq!(publisher.misses(), 0);
    }

    #[test]
    fn silence_is_answered_before_the_deadline() {
        let mut publisher = publisher();
        publisher.announce(announcement(0, 1_000_000));
        let timer = publisher.next_timer().unwrap();
        assert!(timer < Micros(1_500_000));
        assert!(publisher.expire(Micros(timer.0 - 1)).is_none());
        assert_eq!(publisher.expire(timer).unwrap().announcement.unwrap().sequence, 0);
        assert_eq!(publisher.answer(0), Verdict::Late);
        assert_eq!((publisher.misses(), publisher.late()), (1, 1));
    }

    #[test]
    fn instants_without_a_key_frame_are_answered_on_time_too() {
        let mut publisher = publisher();
        publisher.announce(announcement(0, 10_000));
        assert_eq!(publisher.answer(0), Verdict::Publish);
        // No frame comes for one and a half seconds.
        assert_eq!(publisher.next_timer(), Some(Micros(900_000)));
        assert_eq!(stamps_until(&mut publisher, 900_000), [(500_000, Cause::Missing)]);
        assert_eq!(
            stamps_until(&mut publisher, 1_400_000),
            [(1_000_000, Cause::Missing)]
        );
        // The key frame of an instant that was answered already is late; the next one is awaited as ever.
        assert_eq!(publisher.announce(announcement(1, 1_480_000)), Verdict::Late);
        assert_eq!(publisher.announce(announcement(2, 1_510_000)), Verdict::Publish);
        assert_eq!(publisher.answer(2), Verdict::Publish);
    }

    /// Frames at 100 Hz whose first one is captured `phase` after the publisher began to expect: the stamps of all that left.
    fn answered_of_phase(phase: u64) -> Vec<u64> {
        let mut publisher = publisher();
        publisher.expect_from(Micros(0));
        let mut left = Vec::new();
        for now in (0..6_000_000).step_by(10_000) {
            let after = u64::checked_sub(now, phase);
            if let Some(after) = after.filter(|after| after % PERIOD == 0) {
                let sequence = u32::try_from(after / PERIOD).unwrap();
                let announced = Announcement {
                    due: Some(Micros(now)),
                    ..announcement(sequence, now)
                };
                publisher.announce(announced);
                if publisher.answer(sequence) == Verdict::Publish {
                    left.push(now);
                }
            }
            left.extend(stamps_until(&mut publisher, now).iter().map(|(stamp, _)| *stamp));
        }
        left
    }

    #[test]
    fn whatever_the_phase_of_the_first_frame_its_cadence_is_followed() {
        for phase in (0..=1_000_000).step_by(10_000) {
            let left = answered_of_phase(phase);
            let own = left.iter().filter(|stamp| **stamp % PERIOD == phase % PERIOD);
            let frames = (6_000_000 - phase).div_ceil(PERIOD);
            assert!(own.count() as u64 + 1 >= frames, "{phase}: {left:?}");
            // No instant twice but at the start, and none forgotten.
            for pair in left.windows(2).skip(3) {
                assert_eq!(pair[1] - pair[0], PERIOD, "{phase}: {left:?}");
            }
        }
    }

    #[test]
    fn a_key_frame_after_a_gap_does_not_hide_the_gap() {
        let mut publisher = publisher();
        publisher.announce(announcement(0, 0));
        publisher.answer(0);
        publisher.announce(announcement(3, 1_500_000));
        assert_eq!(
            stamps_until(&mut publisher, 1_500_000),
            [(500_000, Cause::Missing), (1_000_000, Cause::Missing)]
        );
        publisher.announce(announcement(9_999, 5_000_000_000));
        assert_eq!(stamps_until(&mut publisher, 5_000_000_000).len(), 9);
        assert_eq!(publisher.unanswered(), 10_000 - 4 - 8);
    }

    #[test]
    fn who_gives_up_is_answered_for_at_once() {
        let mut publisher = publisher();
        publisher.announce(announcement(0, 0));
        let blame = Blame::Stage(Stage::Map);
        publisher.fail(0, Cause::GivenUp(blame));
        assert_eq!(publisher.next_timer(), Some(Micros(0)));
        assert_eq!(stamps_until(&mut publisher, 20_000), [(0, Cause::GivenUp(blame))]);
        publisher.panicked(blame, Micros(30_000));
        assert_eq!(
            stamps_until(&mut publisher, 30_000),
            [(30_000, Cause::Panicked(blame))]
        );
    }

    #[test]
    fn every_key_frame_leaves_even_when_many_are_pending() {
        let mut publisher = Publisher::new(&Slices::default(), None);
        for sequence in 0..16 {
            publisher.announce(announcement(sequence, u64::from(sequence)));
        }
        assert_eq!(stamps_until(&mut publisher, 10_000_000).len(), 16);
        assert_eq!(publisher.misses(), 16);
    }

    #[test]
    fn an_answer_overtaking_another_leaves_the_other_pending() {
        let mut publisher = publisher();
        publisher.announce(announcement(0, 0));
        publisher.announce(announcement(1, 500_000));
        assert_eq!(publisher.answer(1), Verdict::Publish);
        assert_eq!(stamps_until(&mut publisher, 490_000).len(), 1);
    }

    #[test]
    fn nothing_is_expected_after_the_end() {
        let mut publisher = publisher();
        publisher.expect_from(Micros(0));
        assert_eq!(stamps_until(&mut publisher, 450_000).len(), 1);
        publisher.expect_no_more();
        assert_eq!(publisher.next_timer(), None);
    }
}
