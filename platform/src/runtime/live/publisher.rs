//! The publisher's thread: answers as they come, fallbacks when time is up.
//!
//! It owns what circulates: jobs and outputs come here from everywhere and go back from here.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use freespace::deadline::{Cause, Verdict};
use freespace::health::{Blame, Faults};
use freespace::pipeline::{KeyFrameJob, KeyFrameOutput, PublishTask, Workers};
use freespace::port::{Clock as _, SinkPort};
use freespace::space::Micros;
use freespace::stage::{Stage, StageProbe as _};
use rtrb::{Consumer, Producer};

use crate::statistics::Publication;

use super::super::LateWork;
use super::super::allocation::RealTimeScope;
use super::super::handover::wait;
use super::super::page_faults::FaultMeter;
use super::super::restart::{Panicked, guarded};
use super::super::trace::{Event, Teller};
use super::frame::FrameNews;
use super::key_frame::KeyFrameNews;
use super::observe::Observation;
use super::{Counters, Shared};

/// Publications that the observer may hold at a time.
pub(super) const LENT: usize = 2;
/// Outputs kept here for fallbacks: one more than can be lent, so that an observer that stalls never holds the last one.
pub(super) const SPARE: usize = LENT + 1;

/// Rounds after which every box has been through: an announcement, an answer and a return are a round each.
const WARM_ROUNDS: u32 = 24;

pub(super) struct PublisherThread {
    pub(super) task: PublishTask,
    pub(super) sinks: Vec<Box<dyn SinkPort + Send>>,
    pub(super) shared: Arc<Shared>,
    pub(super) frame_news: Consumer<FrameNews>,
    pub(super) key_frame_news: Consumer<KeyFrameNews>,
    /// Outputs at hand.
    pub(super) outputs: Vec<Box<KeyFrameOutput>>,
    pub(super) free_jobs: Producer<Box<KeyFrameJob>>,
    pub(super) free_outputs: Producer<Box<KeyFrameOutput>>,
    /// Every publication in numbers.
    pub(super) publications: Producer<Publication>,
    /// Work whose answer a fallback did not wait for.
    pub(super) late: Producer<LateWork>,
    /// Publications on loan to the observer.
    pub(super) seen: Producer<Observation>,
    /// Publications that come back from the observer.
    pub(super) returned: Consumer<Observation>,
    pub(super) lent: usize,
    pub(super) teller: Teller,
}

impl PublisherThread {
    pub(super) fn run(mut self) {
        self.shared.publisher_bell.claim();
        let _scope = RealTimeScope::enter();
        let mut faults = FaultMeter::warm_after(WARM_ROUNDS);
        let mut is_over = false;
        if self.shared.clock.is_of_devices() {
            // A camera that never gives a frame is answered for from the start.
            self.task.expect_from(self.shared.clock.now());
        }
        loop {
            faults.look(&self.shared.counters.page_faults);
            self.take_back();
            self.hear_frames();
            while let Ok(news) = self.key_frame_news.pop() {
                // A key frame is announced before its job is handed over: what was heard of it may lie behind this answer only.
                self.hear_frames();
                is_over |= self.hear_key_frame(news);
            }
            is_over |= self.shared.is_given_up.load(Ordering::Relaxed);
            let until = if is_over {
                // No answer can come any more: what is still awaited leaves now, and nothing new is expected.
                self.task.expect_no_more();
                Micros(u64::MAX)
            } else {
                self.shared.clock.now()
            };
            self.fall_back(until);
            self.count();
            if is_over {
                break;
            }
            // Only after a look: what was told before this thread claimed its bell rang for nobody.
            wait(&self.shared.clock, self.task.next_timer());
        }
        self.shut_down();
    }

    fn hear_frames(&mut self) {
        while let Ok(news) = self.frame_news.pop() {
            self.hear_frame(&news);
        }
    }

    fn hear_frame(&mut self, news: &FrameNews) {
        match news {
            FrameNews::Announced(announcement) => self.task.announce(*announcement),
            FrameNews::Dropped => self.task.report(Faults::HANDOVER_DROPPED),
            FrameNews::Panicked(blame) => self.task.panicked(*blame, self.shared.clock.now()),
            FrameNews::Ended => self.task.expect_no_more(),
        }
    }

    /// Whether this was the last news.
    fn hear_key_frame(&mut self, news: KeyFrameNews) -> bool {
        match news {
            KeyFrameNews::Answered(job, output) => self.take_answer(job, output),
            KeyFrameNews::GivenUp(job, blame, work) => {
                self.note_late(work);
                self.task.fail(job.sequence, Cause::GivenUp(blame));
                self.free(Some(job), None);
            }
            KeyFrameNews::Failed(job, cause) => {
                self.task.fail(job.sequence, cause);
                self.free(Some(job), None);
            }
            KeyFrameNews::Ended => return true,
        }
        false
    }

    fn take_answer(&mut self, job: Box<KeyFrameJob>, mut output: Box<KeyFrameOutput>) {
        let sequence = output.sequence;
        self.shared.publisher_progress.enter(Stage::Emit);
        self.prepare();
        let clock = &self.shared.clock;
        let verdict = guarded(|| self.task.answer(clock.now(), &mut output, clock));
        match verdict {
            Ok(Verdict::Publish) => {
                self.send(&output);
                self.shared.publisher_progress.rest();
                self.keep(&output);
                self.show(Some(job), output);
            }
            Ok(Verdict::Late) => {
                self.shared.publisher_progress.rest();
                let now = clock.now();
                let work = LateWork::of(&job, &output, now);
                (self.teller).tell(now, Event::AnsweredLate(sequence, work.micros));
                self.note_late(work);
                self.keep(&output);
                self.free(Some(job), Some(output));
            }
            Err(Panicked) => {
                self.note_panic();
                self.free(Some(job), Some(output));
            }
        }
    }

    fn note_late(&mut self, work: LateWork) {
        let is_lost = self.late.push(work).is_err();
        Counters::add(&self.shared.counters.unreported, u64::from(is_lost));
    }

    fn keep(&mut self, output: &KeyFrameOutput) {
        let task = &mut self.task;
        if guarded(|| task.keep(output)).is_err() {
            self.note_panic();
        }
    }

    fn fall_back(&mut self, until: Micros) {
        loop {
            let workers = Workers {
                frame: self.shared.frame_progress.place().stage(),
                key_frame: self.shared.key_frame_progress.place().stage(),
                captured: self.shared.captured.get(),
            };
            // One is kept for this: the last one is never lent.
            let Some(mut output) = self.outputs.pop() else {
                return;
            };
            let clock = &self.shared.clock;
            let now = clock.now();
            self.shared.publisher_progress.enter(Stage::Emit);
            let fell_back = guarded(|| self.task.fall_back(until, now, &workers, &mut output, clock));
            match fell_back {
                Ok(true) => {
                    self.send(&output);
                    self.shared.publisher_progress.rest();
                    self.show(None, output);
                }
                Ok(false) => {
                    self.shared.publisher_progress.rest();
                    self.outputs.push(output);
                    return;
                }
                Err(Panicked) => {
                    self.outputs.push(output);
                    self.note_panic();
                }
            }
        }
    }

    /// *emit* panicked: the next message is an invalid one.
    fn note_panic(&mut self) {
        self.shared.publisher_progress.rest();
        if self.count_panic() {
            let now = self.shared.clock.now();
            self.task.panicked(Blame::Stage(Stage::Emit), now);
        }
    }

    /// Whether the drive survives it.
    fn count_panic(&mut self) -> bool {
        let blame = Blame::Stage(Stage::Emit);
        let may_restart = self.shared.restarts.may_restart();
        let event = if may_restart {
            Event::Panicked
        } else {
            Event::PanickedTooOften
        };
        self.teller.tell(self.shared.clock.now(), event(blame));
        may_restart
    }

    fn shut_down(&mut self) {
        if let Some(mut output) = self.outputs.pop() {
            let clock = &self.shared.clock;
            let task = &mut self.task;
            self.shared.publisher_progress.enter(Stage::Emit);
            let is_made = guarded(|| task.shut_down(clock.now(), &mut output, clock)).is_ok();
            if is_made {
                self.send(&output);
            }
            self.shared.publisher_progress.rest();
            if is_made {
                // It is not waited for: an observer that holds all it may hold does not see it.
                let _ = self.seen.push(Observation {
                    is_last_word: true,
                    job: None,
                    output,
                });
            }
        }
        self.shared.is_published.store(true, Ordering::Release);
        self.shared.observer_bell.ring();
    }

    fn prepare(&mut self) {
        for sink in &mut self.sinks {
            // What is wrong with it shows when it publishes.
            let _ = guarded(|| sink.prepare());
        }
    }

    fn send(&mut self, output: &KeyFrameOutput) {
        let message = &output.message[..output.message_len];
        for index in 0..self.sinks.len() {
            let sink = &mut self.sinks[index];
            match guarded(|| sink.publish(message, &output.can_frames)) {
                Ok(Ok(())) => {}
                Ok(Err(_)) => {
                    self.task.report(sink.fault());
                    self.teller.tell(self.shared.clock.now(), Event::SinkRefused);
                }
                // A sink cannot be started anew, and this message is as good as it was: the next one says it.
                Err(Panicked) => {
                    self.task.report(sink.fault() | Faults::STAGE_PANICKED);
                    self.count_panic();
                }
            }
        }
    }

    fn count(&self) {
        let counters = &self.shared.counters;
        (counters.unanswered).store(self.task.unanswered(), Ordering::Relaxed);
        counters.late.store(self.task.late(), Ordering::Relaxed);
    }

    /// Counts a publication and lends it to the observer, if that holds few enough and another output is at hand.
    fn show(&mut self, job: Option<Box<KeyFrameJob>>, output: Box<KeyFrameOutput>) {
        let counters = &self.shared.counters;
        Counters::add(&counters.key_frames, 1);
        Counters::add(&counters.misses, u64::from(output.is_miss()));
        counters.fresh.store(self.task.fresh(), Ordering::Relaxed);
        let is_told = self.publications.push(Publication::of(&output)).is_ok();
        let observation = Observation {
            is_last_word: false,
            job,
            output,
        };
        let kept = self.lend(observation);
        // Once, whatever of it was not seen.
        let is_unobserved = !is_told || kept.is_some();
        Counters::add(&self.shared.counters.unobserved, u64::from(is_unobserved));
        Counters::add(&self.shared.counters.unreported, u64::from(!is_told));
        if let Some(observation) = kept {
            self.free(observation.job, Some(observation.output));
        }
    }

    /// Gives back what is not lent.
    fn lend(&mut self, observation: Observation) -> Option<Observation> {
        if self.lent == LENT || self.outputs.is_empty() {
            return Some(observation);
        }
        if let Err(rtrb::PushError::Full(back)) = self.seen.push(observation) {
            return Some(back);
        }
        self.lent += 1;
        self.shared.observer_bell.ring();
        None
    }

    fn take_back(&mut self) {
        while let Ok(observation) = self.returned.pop() {
            self.lent -= 1;
            self.free(observation.job, Some(observation.output));
        }
    }

    /// Boxes go back to where they are needed; some outputs stay here for fallbacks.
    fn free(&mut self, job: Option<Box<KeyFrameJob>>, output: Option<Box<KeyFrameOutput>>) {
        if let Some(job) = job {
            // There is room for every job.
            let _ = self.free_jobs.push(job);
        }
        if let Some(output) = output {
            if self.outputs.len() < SPARE {
                self.outputs.push(output);
            } else if let Err(rtrb::PushError::Full(output)) = self.free_outputs.push(output) {
                self.outputs.push(output);
            }
        }
    }
}
