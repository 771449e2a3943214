//! What is going to happen, in the order of its time.

use freespace::deadline::{Announcement, Cause};
use freespace::health::Blame;
use freespace::pipeline::{KeyFrameJob, KeyFrameOutput, Lesson};
use freespace::space::Micros;

use super::super::LateWork;

/// Something that one task hands to another.
pub(super) enum Event {
    /// To the publisher: a key frame was taken up.
    Announced(Announcement),
    /// To the publisher: the frame task panicked.
    FramePanicked(Blame),
    /// To the key-frame task.
    Job(Box<KeyFrameJob>),
    /// To the frame task.
    Lesson(Box<Lesson>),
    /// To the publisher: an answer.
    Answered(Box<KeyFrameJob>, Box<KeyFrameOutput>),
    /// To the publisher: the work was given up, after this much of it.
    GivenUp(Box<KeyFrameJob>, Blame, LateWork),
    /// To the publisher: no answer will come.
    Failed(Box<KeyFrameJob>, Cause),
}

/// Room for what waits at a time: a few hand-overs of each kind.
const WAITING: usize = 64;

/// Events by time, those of one time in the order in which they were added.
pub(super) struct Agenda(Vec<(Micros, Event)>);

impl Default for Agenda {
    fn default() -> Self {
        Self(Vec::with_capacity(WAITING))
    }
}

impl Agenda {
    pub(super) fn add(&mut self, at: Micros, event: Event) {
        let index = self.0.partition_point(|(time, _)| *time <= at);
        self.0.insert(index, (at, event));
    }

    /// Time of the next event.
    pub(super) fn next_at(&self) -> Option<Micros> {
        self.0.first().map(|(time, _)| *time)
    }

    pub(super) fn pop(&mut self) -> Option<(Micros, Event)> {
        (!self.0.is_empty()).then(|| self.0.remove(0))
    }
}
