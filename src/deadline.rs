//! The deadline: slices of the key-frame task, and what is published when an answer is late.
//!
//! [`Publisher`] is pure logic: the platform's publisher thread feeds it announcements, answers and the time, and sends what
//! it returns. For every announced key frame exactly one publication leaves, at the latest [`Slices::guard_micros`] before
//! its deadline: the answer, or else the last grid moved by the ego motion and aged, or, before there was any, an invalid one.

use crate::space::{Micros, Pose};

/// Time after capture at which the refinement of each stage ends; what is there then is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(deny_unknown_fields, default)
)]
pub struct Slices {
    /// No further bundle-adjustment iteration.
    pub map_micros: u64,
    /// The network's answer is taken from the last key frame instead.
    pub segmentation_micros: u64,
    /// The cut is stopped.
    pub crf_micros: u64,
    /// The grid is due.
    pub deadline_micros: u64,
    /// A fallback leaves this long before the deadline.
    pub guard_micros: u64,
}

impl Default for Slices {
    fn default() -> Self {
        Self {
            map_micros: 90_000,
            segmentation_micros: 170_000,
            crf_micros: 220_000,
            deadline_micros: crate::budget::DEADLINE_MICROS,
            guard_micros: 20_000,
        }
    }
}

/// A key frame whose answer is awaited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Announcement {
    /// Number of the key frame.
    pub sequence: u32,
    /// Index of its frame.
    pub frame: u64,
    /// Capture stamp.
    pub stamp: Micros,
    /// Pose as tracked, to move the last grid by.
    pub world_from_camera: Pose,
}

/// Key frames awaiting their answer.
const PENDING: usize = 8;

/// Decides what leaves for each key frame, and when.
#[derive(Debug, Default)]
pub struct Publisher {
    pending: heapless::Deque<Announcement, PENDING>,
    deadline_micros: u64,
    guard_micros: u64,
    misses: u64,
    late: u64,
}

/// What to do with an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is the awaited one and on time: publish it.
    Publish,
    /// Its key frame was answered by a fallback already: keep it as the base of the next fallback only.
    Late,
}

impl Publisher {
    /// A publisher that keeps this deadline.
    #[must_use]
    pub fn new(slices: &Slices) -> Self {
        Self {
            deadline_micros: slices.deadline_micros,
            guard_micros: slices.guard_micros,
            ..Self::default()
        }
    }

    /// Takes note of a key frame; where too many are pending already, the oldest is returned and must be answered by a
    /// fallback now.
    pub fn announce(&mut self, announcement: Announcement) -> Option<Announcement> {
        let displaced = if self.pending.is_full() {
            self.pending.pop_front()
        } else {
            None
        };
        self.misses += u64::from(displaced.is_some());
        // Room was made above.
        let _ = self.pending.push_back(announcement);
        displaced
    }

    /// Judges an answer.
    pub fn answer(&mut self, sequence: u32) -> Verdict {
        let Some(index) = self
            .pending
            .iter()
            .position(|pending| pending.sequence == sequence)
        else {
            self.late += 1;
            return Verdict::Late;
        };
        // Answers come in order; an earlier key frame still pending stays for its own timer.
        if index == 0 {
            self.pending.pop_front();
        } else {
            let mut kept = heapless::Deque::<Announcement, PENDING>::new();
            for pending in self.pending.iter().filter(|pending| pending.sequence != sequence) {
                let _ = kept.push_back(*pending);
            }
            self.pending = kept;
        }
        Verdict::Publish
    }

    /// The instant at which [`Publisher::expire`] must be asked again.
    #[must_use]
    pub fn next_timer(&self) -> Option<Micros> {
        self.pending.front().map(|pending| self.send_by(pending))
    }

    /// A key frame that must be answered by a fallback now; call until none is left.
    pub fn expire(&mut self, now: Micros) -> Option<Announcement> {
        let due = self
            .pending
            .front()
            .is_some_and(|pending| now >= self.send_by(pending));
        self.misses += u64::from(due);
        if due { self.pending.pop_front() } else { None }
    }

    /// Key frames that a fallback answered.
    #[must_use]
    pub const fn misses(&self) -> u64 {
        self.misses
    }

    /// Answers that came after their fallback.
    #[must_use]
    pub const fn late(&self) -> u64 {
        self.late
    }

    fn send_by(&self, pending: &Announcement) -> Micros {
        pending
            .stamp
            .plus(self.deadline_micros.saturating_sub(self.guard_micros))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn announcement(sequence: u32, stamp: u64) -> Announcement {
        Announcement {
            sequence,
            frame: 0,
            stamp: Micros(stamp),
            world_from_camera: Pose::identity(),
        }
    }

    fn publisher() -> Publisher {
        Publisher::new(&Slices::default())
    }

    #[test]
    fn an_answer_in_time_is_published_once() {
        let mut publisher = publisher();
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
        assert_eq!(publisher.expire(timer).unwrap().sequence, 0);
        assert_eq!(publisher.answer(0), Verdict::Late);
        assert_eq!((publisher.misses(), publisher.late()), (1, 1));
    }

    #[test]
    fn every_key_frame_leaves_even_when_too_many_are_pending() {
        let mut publisher = publisher();
        let mut sent = 0;
        for sequence in 0..20 {
            sent += u64::from(
                publisher
                    .announce(announcement(sequence, u64::from(sequence)))
                    .is_some(),
            );
        }
        while publisher.expire(Micros(10_000_000)).is_some() {
            sent += 1;
        }
        assert_eq!((sent, publisher.misses()), (20, 20));
    }

    #[test]
    fn an_answer_overtaking_another_leaves_the_other_pending() {
        let mut publisher = publisher();
        publisher.announce(announcement(0, 0));
        publisher.announce(announcement(1, 500_000));
        assert_eq!(publisher.answer(1), Verdict::Publish);
        assert_eq!(publisher.expire(Micros(490_000)).unwrap().sequence, 0);
    }
}
