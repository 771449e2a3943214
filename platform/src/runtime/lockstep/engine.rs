//! The tasks of a live run on one thread: each as busy as its time says, hand-overs in between.

use freespace::deadline::{Cause, Verdict};
use freespace::frame::FrameError;
use freespace::health::{Blame, Faults};
use freespace::pipeline::{
    FrameTask, KeyFrameJob, KeyFrameOutput, KeyFrameTask, Lesson, Pace, PipelineConfig, PublishTask, Workers,
};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer, RoadNetwork, SinkPort, WheelPort};
use freespace::space::Micros;
use freespace::stage::Stage;

use super::super::allocation::{RealTimeScope, outside_scopes};
use super::super::restart::{Panicked, guarded};
use super::super::{FrameReport, KeyFrameReport, LateWork, Observer, RunSummary, WHEEL_LOOKAHEAD_MICROS};
use super::agenda::{Agenda, Event};
use super::time::{Learning, TaskTime};
use crate::statistics::Publication;

/// When a task is free again; never, where it hangs.
type FreeAt = Option<Micros>;

/// Boxes of each kind that circulate.
const BOXES: usize = 8;

/// Lessons that wait at most.
const TAUGHT: usize = 4;

/// How long a part takes to start anew after a panic.
const RESTART_MICROS: u64 = 100_000;

pub(super) struct Engine<'a, N, T> {
    config: &'a PipelineConfig,
    pace: Pace,
    frame_task: FrameTask,
    key_frame_task: KeyFrameTask,
    publish_task: PublishTask,
    network: N,
    wheels: Option<Box<dyn WheelPort + Send>>,
    sinks: Vec<Box<dyn SinkPort + Send>>,
    frame_time: T,
    key_frame_time: T,
    publish_time: T,
    frame_free: FreeAt,
    key_frame_free: FreeAt,
    publish_free: FreeAt,
    /// Stamp of the newest frame.
    captured: Option<Micros>,
    waiting_frame: Option<Box<FrameBuffer>>,
    waiting_job: Option<(Micros, Box<KeyFrameJob>)>,
    agenda: Agenda,
    job: Box<KeyFrameJob>,
    #[expect(clippy::vec_box, reason = "boxes circulate, as between threads")]
    buffers: Vec<Box<FrameBuffer>>,
    jobs: Vec<Box<KeyFrameJob>>,
    outputs: Vec<Box<KeyFrameOutput>>,
    lessons: Vec<Box<Lesson>>,
    /// Lessons of a recorded drive that wait for the frame before which they were learnt.
    taught: Vec<Box<Lesson>>,
    /// The key frame whose lesson was to be learnt last, there or not yet.
    awaited: Option<u64>,
    /// Learnt since the last frame.
    learnt: Option<u64>,
    now: Micros,
    summary: RunSummary,
}

/// The next thing to happen.
enum Next {
    Frame,
    Job,
    Event,
    Timer,
}

impl<'a, N: RoadNetwork, T: TaskTime> Engine<'a, N, T> {
    pub(super) fn new(
        config: &'a PipelineConfig,
        pace: Pace,
        network: N,
        wheels: Option<Box<dyn WheelPort + Send>>,
        sinks: Vec<Box<dyn SinkPort + Send>>,
        [frame_time, key_frame_time, publish_time]: [T; 3],
    ) -> Self {
        let (width, height) = (config.camera.width, config.camera.height);
        let boxes = 0..BOXES;
        Self {
            config,
            pace,
            frame_task: FrameTask::new(config),
            key_frame_task: KeyFrameTask::new(config, pace),
            publish_task: PublishTask::new(config, Faults::NONE),
            network,
            wheels,
            sinks,
            frame_time,
            key_frame_time,
            publish_time,
            frame_free: Some(Micros(0)),
            key_frame_free: Some(Micros(0)),
            publish_free: Some(Micros(0)),
            captured: None,
            waiting_frame: None,
            waiting_job: None,
            agenda: Agenda::default(),
            job: KeyFrameJob::new(width, height),
            buffers: (0..2).map(|_| Box::default()).collect(),
            jobs: boxes.clone().map(|_| KeyFrameJob::new(width, height)).collect(),
            outputs: boxes.clone().map(|_| KeyFrameOutput::new(config)).collect(),
            lessons: boxes.map(|_| Lesson::new()).collect(),
            taught: Vec::with_capacity(TAUGHT + 1),
            awaited: None,
            learnt: None,
            now: Micros(0),
            summary: RunSummary::default(),
        }
    }

    /// Runs until the camera ends, and what it gave is answered.
    pub(super) fn run(
        mut self,
        mut camera: Box<dyn CameraPort + Send>,
        observer: &mut dyn Observer,
    ) -> RunSummary {
        // One buffer is being filled, the other may wait.
        let mut spare = self.buffers.pop();
        while let Some(mut buffer) = spare.take().or_else(|| self.buffers.pop()) {
            match camera.next_frame(&mut buffer) {
                CameraAnswer::End => break,
                CameraAnswer::Silent => spare = Some(buffer),
                CameraAnswer::Lost => {
                    self.summary.dropped_frames += 1;
                    spare = Some(buffer);
                }
                CameraAnswer::Frame => {
                    let stamp = buffer.stamp;
                    self.advance(Micros(stamp.0.saturating_sub(1)), observer);
                    spare = self.arrive(buffer);
                    self.advance(stamp, observer);
                }
            }
        }
        self.publish_task.expect_no_more();
        self.advance(Micros(u64::MAX), observer);
        self.summary.fresh = self.publish_task.fresh();
        self.summary
    }

    /// A frame arrives; gives back the one that it displaces.
    fn arrive(&mut self, buffer: Box<FrameBuffer>) -> Option<Box<FrameBuffer>> {
        self.captured = Some(buffer.stamp);
        let displaced = self.waiting_frame.replace(buffer);
        if let (Some(older), Some(newer)) = (&displaced, &mut self.waiting_frame) {
            self.summary.dropped_frames += 1;
            newer.key_frame_wanted |= older.key_frame_wanted;
        }
        displaced
    }

    /// Lets everything happen that happens until `until`.
    fn advance(&mut self, until: Micros, observer: &mut dyn Observer) {
        while let Some((at, next)) = self.next().filter(|(at, _)| *at <= until) {
            // What was overdue happens now.
            self.now = self.now.max(at);
            let at = self.now;
            match next {
                Next::Frame => self.frame(at, observer),
                Next::Job => self.key_frame(at),
                Next::Event => self.event(observer),
                Next::Timer => self.fall_back(at, observer),
            }
        }
    }

    /// What happens next: hand-overs before the work that they may bring, timers last.
    fn next(&self) -> Option<(Micros, Next)> {
        let frame = (self.waiting_frame.as_ref())
            .zip(self.frame_free)
            .map(|(buffer, free)| (free.max(buffer.stamp), Next::Frame));
        let job = (self.waiting_job.as_ref())
            .zip(self.key_frame_free)
            .map(|((handed, _), free)| (free.max(*handed), Next::Job));
        let event = self.agenda.next_at().map(|at| (at, Next::Event));
        let timer = (self.publish_task.next_timer())
            .zip(self.publish_free)
            .map(|(at, free)| (at.max(free), Next::Timer));
        [event, job, frame, timer]
            .into_iter()
            .flatten()
            .min_by_key(|(at, _)| *at)
    }

    fn event(&mut self, observer: &mut dyn Observer) {
        let Some((at, event)) = self.agenda.pop() else {
            return;
        };
        match event {
            Event::Announced(announcement) => self.publish_task.announce(announcement),
            Event::FramePanicked(blame) => self.publish_task.panicked(blame, at),
            Event::Job(job) => {
                if let Some((_, displaced)) = self.waiting_job.replace((at, job)) {
                    self.publish_task.report(Faults::HANDOVER_DROPPED);
                    self.jobs.push(displaced);
                }
            }
            Event::Lesson(lesson) => self.learn(lesson),
            Event::Answered(job, output) => self.answer(at, job, output, observer),
            Event::GivenUp(job, blame, work) => {
                observer.late_work(&work);
                self.publish_task.fail(job.sequence, Cause::GivenUp(blame));
                self.jobs.push(job);
            }
            Event::Failed(job, cause) => {
                self.publish_task.fail(job.sequence, cause);
                self.jobs.push(job);
            }
        }
    }

    /// The frame task takes the waiting frame.
    fn frame(&mut self, at: Micros, observer: &mut dyn Observer) {
        let Some(buffer) = self.waiting_frame.take() else {
            return;
        };
        self.frame_time.begin(at, Some(buffer.index));
        if let Learning::AsRecorded(Some(key_frame)) = self.frame_time.learning() {
            self.awaited = Some(key_frame);
            self.learn_awaited();
        }
        let stepped = {
            let _scope = RealTimeScope::enter();
            guarded(|| {
                if let Some(wheels) = &mut self.wheels {
                    let until = buffer.stamp.plus(WHEEL_LOOKAHEAD_MICROS);
                    wheels.readings_until(until, &mut |reading| self.frame_task.wheel(reading));
                }
                let wanted = buffer.key_frame_wanted;
                let time = &self.frame_time;
                self.frame_task
                    .step(&buffer.raw(), wanted, &mut self.job, time, time)
            })
        };
        self.frame_free = self.frame_time.end(at);
        let (index, stamp) = (buffer.index, buffer.stamp);
        self.buffers.push(buffer);
        let Some(done) = self.frame_free else { return };
        match stepped {
            Ok(Ok(outcome)) => {
                self.summary.frames += 1;
                observer.frame(&FrameReport {
                    index,
                    stamp,
                    outcome,
                    learnt: self.learnt.take(),
                });
                if outcome.is_key_frame {
                    self.job.frame = index;
                    self.hand_over(done);
                }
            }
            Ok(Err(error)) if error != FrameError::Broken => self.summary.dropped_frames += 1,
            Ok(Err(_)) | Err(Panicked) => {
                self.summary.dropped_frames += 1;
                self.summary.restarts += 1;
                let blame = Blame::Stage(self.frame_time.stage().unwrap_or(Stage::Frame));
                self.frame_task = outside_scopes(|| self.frame_task.renewed(self.config));
                FrameTask::recycle(&mut self.job);
                self.frame_free = Some(done.plus(RESTART_MICROS));
                self.agenda.add(done, Event::FramePanicked(blame));
            }
        }
    }

    fn teach(&mut self, done: Micros, lesson: Box<Lesson>) {
        if self.frame_time.learning() == Learning::AsItComes {
            self.agenda.add(done, Event::Lesson(lesson));
            return;
        }
        self.taught.push(lesson);
        self.learn_awaited();
        if self.taught.len() > TAUGHT {
            // It was displaced by a newer one, which holds all that it taught.
            self.lessons.push(self.taught.remove(0));
        }
    }

    /// Learns the lesson that is awaited, where it is there; what is older was displaced by it.
    fn learn_awaited(&mut self) {
        while let Some(key_frame) = self.awaited
            && self
                .taught
                .first()
                .is_some_and(|lesson| lesson.frame <= key_frame)
        {
            let lesson = self.taught.remove(0);
            if lesson.frame == key_frame {
                self.learn(lesson);
                self.awaited = None;
            } else {
                self.lessons.push(lesson);
            }
        }
    }

    fn learn(&mut self, lesson: Box<Lesson>) {
        self.frame_task.learn(&lesson);
        self.learnt = Some(lesson.frame);
        self.lessons.push(lesson);
    }

    fn hand_over(&mut self, done: Micros) {
        self.agenda.add(done, Event::Announced(self.job.announcement()));
        let Some(mut next) = self.jobs.pop() else {
            self.publish_task.report(Faults::HANDOVER_DROPPED);
            FrameTask::recycle(&mut self.job);
            return;
        };
        FrameTask::recycle(&mut next);
        let complete = std::mem::replace(&mut self.job, next);
        self.agenda.add(done, Event::Job(complete));
    }

    /// The key-frame task takes the waiting job.
    fn key_frame(&mut self, at: Micros) {
        let Some((_, job)) = self.waiting_job.take() else {
            return;
        };
        let (Some(mut output), Some(mut lesson)) = (self.outputs.pop(), self.lessons.pop()) else {
            self.jobs.push(job);
            return;
        };
        self.key_frame_time.begin(at, Some(job.frame));
        let stepped = {
            let _scope = RealTimeScope::enter();
            let time = &self.key_frame_time;
            guarded(|| {
                self.key_frame_task
                    .step(&job, &mut self.network, time, time, &mut output, &mut lesson)
            })
        };
        self.key_frame_free = self.key_frame_time.end(at);
        let Some(done) = self.key_frame_free else {
            // It hangs, and holds what it was given.
            return;
        };
        if let Ok(Ok(())) = stepped {
            self.teach(done, lesson);
            self.agenda.add(done, Event::Answered(job, output));
            return;
        }
        if let Ok(Err(blame)) = stepped {
            let work = LateWork::of(&job, &output, done);
            self.agenda.add(done, Event::GivenUp(job, blame, work));
        } else {
            self.summary.restarts += 1;
            self.key_frame_task = outside_scopes(|| KeyFrameTask::new(self.config, self.pace));
            self.key_frame_free = Some(done.plus(RESTART_MICROS));
            let blame = Blame::Stage(self.key_frame_time.stage().unwrap_or(Stage::Map));
            self.agenda.add(done, Event::Failed(job, Cause::Panicked(blame)));
        }
        self.outputs.push(output);
        self.lessons.push(lesson);
    }

    fn answer(
        &mut self,
        at: Micros,
        job: Box<KeyFrameJob>,
        mut output: Box<KeyFrameOutput>,
        observer: &mut dyn Observer,
    ) {
        let Some(free) = self.publish_free else { return };
        let at = at.max(free);
        self.publish_time.begin(at, None);
        let verdict = {
            let _scope = RealTimeScope::enter();
            guarded(|| {
                self.publish_time.enter(Stage::Emit);
                let now = self.publish_time.end(at).unwrap_or(at);
                self.publish_task.answer(now, &mut output, &self.publish_time)
            })
        };
        self.publish_free = self.publish_time.end(at);
        match verdict {
            _ if self.publish_free.is_none() => {}
            Ok(verdict) => {
                match verdict {
                    Verdict::Publish => self.show(Some(&job), &output, observer),
                    Verdict::Late => observer.late_work(&LateWork::of(&job, &output, at)),
                }
                self.publish_task.keep(&output);
            }
            Err(Panicked) => self.note_emit_panic(at),
        }
        self.jobs.push(job);
        self.outputs.push(output);
    }

    fn fall_back(&mut self, at: Micros, observer: &mut dyn Observer) {
        let workers = Workers {
            frame: self.at_work(self.frame_free, &self.frame_time, at),
            key_frame: self.at_work(self.key_frame_free, &self.key_frame_time, at),
            captured: self.captured,
        };
        let Some(mut output) = self.outputs.pop() else {
            return;
        };
        self.publish_time.begin(at, None);
        let fell_back = {
            let _scope = RealTimeScope::enter();
            guarded(|| {
                self.publish_time.enter(Stage::Emit);
                let now = self.publish_time.end(at).unwrap_or(at);
                self.publish_task
                    .fall_back(at, now, &workers, &mut output, &self.publish_time)
            })
        };
        self.publish_free = self.publish_time.end(at);
        match fell_back {
            Ok(true) if self.publish_free.is_some() => self.show(None, &output, observer),
            Ok(_) => {}
            Err(Panicked) => self.note_emit_panic(at),
        }
        self.outputs.push(output);
    }

    fn note_emit_panic(&mut self, at: Micros) {
        self.summary.restarts += 1;
        self.publish_task.panicked(Blame::Stage(Stage::Emit), at);
        self.publish_free = Some(at);
    }

    /// The stage that a task is in at a time; none where it waits for work.
    fn at_work(&self, free: FreeAt, time: &T, at: Micros) -> Option<Stage> {
        free.is_none_or(|free| free > at)
            .then(|| time.stage_at(at))
            .flatten()
    }

    fn show(&mut self, job: Option<&KeyFrameJob>, output: &KeyFrameOutput, observer: &mut dyn Observer) {
        for sink in &mut self.sinks {
            let message = &output.message[..output.message_len];
            if sink.publish(message, &output.can_frames).is_err() {
                self.publish_task.report(sink.fault());
            }
        }
        self.summary.key_frames += 1;
        self.summary.deadline_misses += u64::from(output.is_miss());
        observer.publication(&Publication::of(output));
        observer.key_frame(&KeyFrameReport {
            index: output.frame,
            job,
            output,
        });
    }
}
