//! The frame task's thread: every frame through *frame* and *track*, and the jobs of key frames.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use freespace::deadline::Announcement;
use freespace::frame::FrameError;
use freespace::health::Blame;
use freespace::pipeline::{FrameOutcome, FrameTask, KeyFrameJob, Lesson, PipelineConfig};
use freespace::port::{Clock as _, FrameBuffer, WheelPort};
use freespace::stage::{Stage, StageProbe as _};
use rtrb::{Consumer, Producer};

use super::super::allocation::{RealTimeScope, outside_scopes};
use super::super::page_faults::FaultMeter;
use super::super::restart::{Panicked, guarded};
use super::super::trace::{Event, Teller};
use super::super::{FrameReport, WHEEL_LOOKAHEAD_MICROS};
use super::{Counters, Shared};

/// What the publisher hears of the frame task.
pub(super) enum FrameNews {
    /// A key frame was taken up.
    Announced(Announcement),
    /// A key frame gave way to a newer one, or found no free job: its work is not done.
    Dropped,
    /// The task panicked, and was started anew.
    Panicked(Blame),
    /// No frame will come any more.
    Ended,
}

/// Frames after which every buffer has been through.
const WARM_FRAMES: u32 = 60;

pub(super) struct FrameThread {
    pub(super) task: FrameTask,
    pub(super) config: PipelineConfig,
    pub(super) wheels: Option<Box<dyn WheelPort + Send>>,
    pub(super) shared: Arc<Shared>,
    /// Buffers on their way back to the camera.
    pub(super) returned: Producer<Box<FrameBuffer>>,
    /// The job being collected.
    pub(super) job: Box<KeyFrameJob>,
    /// Jobs at hand.
    pub(super) jobs: Vec<Box<KeyFrameJob>>,
    /// Jobs that come back from the publisher.
    pub(super) returned_jobs: Consumer<Box<KeyFrameJob>>,
    /// Lessons on their way back to the key-frame task.
    pub(super) learnt: Producer<Box<Lesson>>,
    pub(super) news: Producer<FrameNews>,
    pub(super) reports: Producer<FrameReport>,
    pub(super) teller: Teller,
    /// Learnt since the last report.
    pub(super) learnt_of: Option<u64>,
}

impl FrameThread {
    pub(super) fn run(mut self) {
        self.shared.frames.claim();
        let _scope = RealTimeScope::enter();
        let mut faults = FaultMeter::warm_after(WARM_FRAMES);
        while let Some(buffer) = self.shared.frames.wait() {
            faults.look(&self.shared.counters.page_faults);
            // From here on it is watched: lessons and wheels may hang, too.
            self.shared.frame_progress.enter(Stage::Frame);
            let is_wanted =
                buffer.key_frame_wanted | self.shared.key_frame_wanted.swap(false, Ordering::Relaxed);
            let outcome = self.step(&buffer, is_wanted);
            self.shared.frame_progress.rest();
            let (index, stamp) = (buffer.index, buffer.stamp);
            // There is room for every buffer.
            let _ = self.returned.push(buffer);
            let Some(outcome) = outcome else {
                Counters::add(&self.shared.counters.lost_frames, 1);
                // A wish for a key frame outlives the frame that carried it.
                self.shared
                    .key_frame_wanted
                    .fetch_or(is_wanted, Ordering::Relaxed);
                continue;
            };
            Counters::add(&self.shared.counters.frames, 1);
            (self.shared.counters.rejected_views).store(self.task.rejected_views(), Ordering::Relaxed);
            let report = FrameReport {
                index,
                stamp,
                outcome,
                learnt: self.learnt_of.take(),
            };
            if self.reports.push(report).is_err() {
                Counters::add(&self.shared.counters.unobserved, 1);
                Counters::add(&self.shared.counters.unreported, 1);
            }
            if outcome.is_key_frame {
                self.job.frame = index;
                self.hand_over();
            }
        }
        self.tell(FrameNews::Ended);
        self.shared.jobs.close();
    }

    fn step(&mut self, buffer: &FrameBuffer, is_wanted: bool) -> Option<FrameOutcome> {
        if self.shared.restarts.is_spent() {
            // The drive ends, and a task that panicked may be half done.
            return None;
        }
        let lesson = self.shared.lessons.take();
        let stepped = guarded(|| {
            if let Some(lesson) = &lesson {
                self.task.learn(lesson);
            }
            if let Some(wheels) = &mut self.wheels {
                let until = buffer.stamp.plus(WHEEL_LOOKAHEAD_MICROS);
                wheels.readings_until(until, &mut |reading| self.task.wheel(reading));
            }
            let shared = &self.shared;
            (self.task).step(
                &buffer.raw(),
                is_wanted,
                &mut self.job,
                &shared.clock,
                &shared.frame_progress,
            )
        });
        if let Some(lesson) = lesson {
            self.learnt_of = Some(lesson.frame);
            // There is room for every lesson.
            let _ = self.learnt.push(lesson);
        }
        match stepped {
            Ok(Ok(outcome)) => Some(outcome),
            Ok(Err(error)) => {
                let now = self.shared.clock.now();
                self.teller.tell(now, Event::FrameRefused(error));
                if error == FrameError::Broken {
                    self.start_anew(Stage::Track);
                }
                None
            }
            Err(Panicked) => {
                let stage = self.shared.frame_progress.place().stage();
                self.start_anew(stage.unwrap_or(Stage::Frame));
                None
            }
        }
    }

    fn start_anew(&mut self, stage: Stage) {
        let blame = Blame::Stage(stage);
        let now = self.shared.clock.now();
        if self.shared.restarts.may_restart() {
            self.teller.tell(now, Event::Panicked(blame));
            FrameTask::recycle(&mut self.job);
            // A new start: it may allocate.
            self.task = outside_scopes(|| self.task.renewed(&self.config));
        } else {
            self.teller.tell(now, Event::PanickedTooOften(blame));
        }
        self.tell(FrameNews::Panicked(blame));
    }

    /// Announces the key frame and hands its job over; where no other job is free, this one is collected anew.
    fn hand_over(&mut self) {
        let sequence = self.job.sequence;
        self.tell(FrameNews::Announced(self.job.announcement()));
        let now = self.shared.clock.now();
        let Some(mut next) = self.jobs.pop().or_else(|| self.returned_jobs.pop().ok()) else {
            self.teller.tell(now, Event::NoFreeJob(sequence));
            self.tell(FrameNews::Dropped);
            FrameTask::recycle(&mut self.job);
            return;
        };
        FrameTask::recycle(&mut next);
        let complete = std::mem::replace(&mut self.job, next);
        if let Some(displaced) = self.shared.jobs.post(complete) {
            // The publisher's timer answers for it.
            self.teller.tell(now, Event::JobDisplaced(displaced.sequence));
            self.tell(FrameNews::Dropped);
            self.jobs.push(displaced);
        }
    }

    fn tell(&mut self, news: FrameNews) {
        // There is room for every key frame until its deadline; the publisher answers for one that it does not hear of.
        let _ = self.news.push(news);
        self.shared.publisher_bell.ring();
    }
}
