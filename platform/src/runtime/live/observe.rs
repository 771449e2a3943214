//! The observer's side, on the caller's normal thread: reports, publications and traces as they come; the watch over the threads.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use freespace::budget::HANG_MICROS;
use freespace::health::Blame;
use freespace::pipeline::{KeyFrameJob, KeyFrameOutput};
use freespace::stage::{Place, Progress};
use rtrb::{Consumer, Producer};

use crate::statistics::Publication;

use super::super::trace::Listener;
use super::super::{FrameReport, KeyFrameReport, LateWork, Observer, RunError, Status};
use super::Shared;
use super::publisher::LENT;

/// A publication on loan.
pub(super) struct Observation {
    /// The last message, which no key frame asked for.
    pub(super) is_last_word: bool,
    pub(super) job: Option<Box<KeyFrameJob>>,
    pub(super) output: Box<KeyFrameOutput>,
}

/// How often the observer looks even where no bell rings.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// How long the publisher is given to say its last word.
pub(in crate::runtime) const LAST_WORD: Duration = Duration::from_secs(1);

pub(super) struct ObserverThread {
    pub(super) shared: Arc<Shared>,
    /// Where the network's thread is.
    pub(super) network_progress: Arc<Progress>,
    pub(super) reports: Consumer<FrameReport>,
    pub(super) publications: Consumer<Publication>,
    pub(super) late: Consumer<LateWork>,
    pub(super) seen: Consumer<Observation>,
    pub(super) returned: Producer<Observation>,
    pub(super) listeners: Vec<Listener>,
}

impl ObserverThread {
    /// Observes until the publisher has ended; sees to it that a hanging thread ends the drive.
    pub(super) fn run(mut self, observer: &mut dyn Observer) -> Result<(), RunError> {
        self.shared.observer_bell.claim();
        let shared = Arc::clone(&self.shared);
        let network = Arc::clone(&self.network_progress);
        let mut hangs = [
            Hang::of(&shared.camera_progress).blaming(Blame::Camera),
            Hang::of(&shared.frame_progress),
            Hang::of(&shared.key_frame_progress),
            // Its key frames are answered without it, and count as fresh: no one else would notice.
            Hang::of(&network),
            Hang::of(&shared.publisher_progress),
        ];
        loop {
            let is_last = self.shared.is_published.load(Ordering::Acquire);
            self.look(observer);
            observer.status(&self.status());
            if is_last {
                break;
            }
            if let Some(blame) = hangs.iter_mut().find_map(Hang::noticed) {
                self.give_up();
                return Err(RunError::Hung(blame.name()));
            }
            std::thread::park_timeout(LOOK_EVERY);
        }
        Ok(())
    }

    /// The hanging thread cannot be ended: the publisher says the last word, if it can, and the process must end.
    fn give_up(&self) {
        self.shared.is_given_up.store(true, Ordering::Relaxed);
        self.shared.publisher_bell.ring();
        let begin = Instant::now();
        while !self.shared.is_published.load(Ordering::Acquire) && begin.elapsed() < LAST_WORD {
            std::thread::park_timeout(LOOK_EVERY);
        }
    }

    fn look(&mut self, observer: &mut dyn Observer) {
        while let Ok(report) = self.reports.pop() {
            observer.frame(&report);
        }
        while let Ok(publication) = self.publications.pop() {
            observer.publication(&publication);
        }
        while let Ok(work) = self.late.pop() {
            observer.late_work(&work);
        }
        // One that takes longer over a key frame than the next one takes to come must still get to its other duties.
        for _ in 0..LENT {
            let Ok(observation) = self.seen.pop() else { break };
            let output = &observation.output;
            if observation.is_last_word {
                observer.last_word(output);
            } else {
                observer.key_frame(&KeyFrameReport {
                    index: output.frame,
                    job: observation.job.as_deref(),
                    output,
                });
            }
            // There is room for whatever was lent.
            let _ = self.returned.push(observation);
            self.shared.publisher_bell.ring();
        }
        for listener in &mut self.listeners {
            while let Ok(trace) = listener.pop() {
                observer.trace(&trace);
            }
        }
    }

    fn status(&self) -> Status {
        let counters = &self.shared.counters;
        let drops = counters.drops();
        Status {
            frames: counters.frames.load(Ordering::Relaxed),
            dropped_frames: drops.frames(),
            drops,
            key_frames: counters.key_frames.load(Ordering::Relaxed),
            deadline_misses: counters.misses.load(Ordering::Relaxed),
            fresh: counters.fresh.load(Ordering::Relaxed),
            restarts: self.shared.restarts.count(),
        }
    }
}

/// Notices a task that stays in one stage.
struct Hang<'a> {
    progress: &'a Progress,
    /// Whom to blame, where it is not the stage.
    blame: Option<Blame>,
    place: Place,
    since: Instant,
}

impl<'a> Hang<'a> {
    fn of(progress: &'a Progress) -> Self {
        Self {
            progress,
            blame: None,
            place: progress.place(),
            since: Instant::now(),
        }
    }

    fn blaming(self, blame: Blame) -> Self {
        Self {
            blame: Some(blame),
            ..self
        }
    }

    fn noticed(&mut self) -> Option<Blame> {
        let place = self.progress.place();
        if place != self.place {
            self.place = place;
            self.since = Instant::now();
        }
        let stage = place.stage()?;
        let is_hanging = self.since.elapsed() > Duration::from_micros(HANG_MICROS);
        is_hanging.then_some(self.blame.unwrap_or(Blame::Stage(stage)))
    }
}
