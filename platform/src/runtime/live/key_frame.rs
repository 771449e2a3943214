//! The key-frame task's thread: each job through *map* to *grid*.

use std::sync::Arc;

use freespace::deadline::Cause;
use freespace::health::Blame;
use freespace::pipeline::{KeyFrameJob, KeyFrameOutput, KeyFrameTask, Lesson, Pace, PipelineConfig};
use freespace::port::Clock as _;
use freespace::stage::{Stage, StageProbe as _};
use rtrb::{Consumer, Producer};

use super::super::LateWork;
use super::super::ThreadedNetwork;
use super::super::allocation::{RealTimeScope, outside_scopes};
use super::super::page_faults::FaultMeter;
use super::super::restart::{Panicked, guarded};
use super::super::trace::{Event, Teller};
use super::Shared;
use super::slow::{Probe, SlowStage};

/// What the publisher hears of the key-frame task.
pub(super) enum KeyFrameNews {
    /// An answer.
    Answered(Box<KeyFrameJob>, Box<KeyFrameOutput>),
    /// No answer will come for this job, on which this much was done.
    GivenUp(Box<KeyFrameJob>, Blame, LateWork),
    /// No answer will come for this job.
    Failed(Box<KeyFrameJob>, Cause),
    /// No answer will come any more.
    Ended,
}

/// Key frames after which every box has been through.
const WARM_KEY_FRAMES: u32 = 8;

pub(super) struct KeyFrameThread {
    /// None while it is made anew, for there is no room for two.
    pub(super) task: Option<KeyFrameTask>,
    pub(super) config: PipelineConfig,
    pub(super) slow: Option<SlowStage>,
    pub(super) network: ThreadedNetwork,
    pub(super) shared: Arc<Shared>,
    /// The output being filled.
    pub(super) output: Option<Box<KeyFrameOutput>>,
    /// Outputs that come back from the publisher.
    pub(super) returned_outputs: Consumer<Box<KeyFrameOutput>>,
    /// Lessons at hand.
    pub(super) lessons: Vec<Box<Lesson>>,
    /// Lessons that come back from the frame task.
    pub(super) learnt: Consumer<Box<Lesson>>,
    pub(super) news: Producer<KeyFrameNews>,
    pub(super) teller: Teller,
}

impl KeyFrameThread {
    pub(super) fn run(mut self) {
        self.shared.jobs.claim();
        self.network.claim();
        let _scope = RealTimeScope::enter();
        let mut faults = FaultMeter::warm_after(WARM_KEY_FRAMES);
        while let Some(job) = self.shared.jobs.wait() {
            faults.look(&self.shared.counters.page_faults);
            let news = self.answer(job);
            self.shared.key_frame_progress.rest();
            self.tell(news);
        }
        self.tell(KeyFrameNews::Ended);
    }

    fn answer(&mut self, job: Box<KeyFrameJob>) -> KeyFrameNews {
        let output = self.output.take().or_else(|| self.returned_outputs.pop().ok());
        let lesson = self.lessons.pop().or_else(|| self.learnt.pop().ok());
        // There are enough of both for whatever is under way at one time.
        let (mut output, mut lesson) = match (output, lesson) {
            (Some(output), Some(lesson)) => (output, lesson),
            (output, lesson) => {
                self.output = output;
                self.lessons.extend(lesson);
                return KeyFrameNews::Failed(job, Cause::GivenUp(Blame::Stage(Stage::Emit)));
            }
        };
        match guarded(|| self.step(&job, &mut output, &mut lesson)) {
            Ok(Ok(())) => {
                if let Some(displaced) = self.shared.lessons.post(lesson) {
                    self.lessons.push(displaced);
                }
                KeyFrameNews::Answered(job, output)
            }
            Ok(Err(blame)) => {
                let now = self.shared.clock.now();
                self.teller.tell(now, Event::GivenUp(job.sequence, blame));
                let work = LateWork::of(&job, &output, now);
                self.lessons.push(lesson);
                self.output = Some(output);
                KeyFrameNews::GivenUp(job, blame, work)
            }
            Err(Panicked) => {
                self.lessons.push(lesson);
                self.output = Some(output);
                KeyFrameNews::Failed(job, Cause::Panicked(self.start_anew()))
            }
        }
    }

    fn step(
        &mut self,
        job: &KeyFrameJob,
        output: &mut KeyFrameOutput,
        lesson: &mut Lesson,
    ) -> Result<(), Blame> {
        let task = match &mut self.task {
            Some(task) if !self.shared.restarts.is_spent() => task,
            // The drive ends, and a task that panicked may be half done.
            _ => return Err(Blame::Stage(Stage::Map)),
        };
        task.step(
            job,
            &mut self.network,
            &self.shared.clock,
            &Probe {
                progress: &self.shared.key_frame_progress,
                slow: self.slow,
                clock: &self.shared.clock,
            },
            output,
            lesson,
        )
    }

    fn start_anew(&mut self) -> Blame {
        let stage = self.shared.key_frame_progress.place().stage();
        let blame = Blame::Stage(stage.unwrap_or(Stage::Map));
        let now = self.shared.clock.now();
        if self.shared.restarts.may_restart() {
            self.teller.tell(now, Event::Panicked(blame));
            // A new start: it may allocate. The old one goes first.
            outside_scopes(|| {
                drop(self.task.take());
                self.task = Some(KeyFrameTask::new(&self.config, Pace::Real));
            });
        } else {
            self.teller.tell(now, Event::PanickedTooOften(blame));
        }
        blame
    }

    fn tell(&mut self, news: KeyFrameNews) {
        // There is room for every job.
        let _ = self.news.push(news);
        self.shared.publisher_bell.ring();
    }
}
