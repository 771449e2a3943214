//! Everything that a live run needs, made before its threads start.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;

use freespace::health::Faults;
use freespace::pipeline::{FrameTask, KeyFrameJob, KeyFrameOutput, KeyFrameTask, Lesson, Pace, PublishTask};
use freespace::port::FrameBuffer;
use rtrb::RingBuffer;

use super::super::memory::MemoryPlan;
use super::super::rights::{self, RealTimeConfig, ThreadRole};
use super::super::trace::traces;
use super::super::{RunError, Setup, ThreadedNetwork};
use super::Shared;
use super::camera::CameraThread;
use super::frame::FrameThread;
use super::key_frame::KeyFrameThread;
use super::observe::ObserverThread;
use super::publisher::{LENT, PublisherThread, SPARE};

/// Frames between camera and frame task: one being filled, one waiting, one being worked on, one on its way back.
const FRAME_BUFFERS: usize = 4;
/// Jobs: one being collected, its successor, one waiting, one being worked on, one with the publisher, two lent to the observer.
const JOBS: usize = 7;
/// Outputs: one being filled, one with the publisher, those for fallbacks, those lent to the observer.
const OUTPUTS: usize = 2 + SPARE + LENT;
/// Lessons: one being written, one waiting, one being learnt.
const LESSONS: usize = 3;
/// Frame reports that wait for the observer: 2 s at 60 frames a second.
const FRAME_REPORTS: usize = 128;

/// Publications, in numbers, that wait for the observer: a minute's.
const PUBLICATIONS: usize = 128;
/// News that wait for the publisher: all that circulates, and what a few periods without its running bring.
const NEWS: usize = 32;

/// The threads, ready to start.
pub(super) struct Threads {
    camera: CameraThread,
    frame: FrameThread,
    key_frame: KeyFrameThread,
    publisher: PublisherThread,
    observer: ObserverThread,
    real_time: RealTimeConfig,
}

impl Threads {
    /// Makes all that the threads own, and notes in `plan` what it holds. The network, and the threads of its library, were made
    /// before.
    ///
    /// # Errors
    /// The network's thread could not be started.
    pub(super) fn build(
        setup: Setup,
        standing: Faults,
        stop: &Arc<AtomicBool>,
        shared: &Arc<Shared>,
        plan: &mut MemoryPlan,
    ) -> Result<Self, RunError> {
        let Setup {
            config,
            devices,
            real_time,
            slow,
            ..
        } = setup;
        let (width, height) = (config.camera.width, config.camera.height);
        let (returned_to, returned) = RingBuffer::new(FRAME_BUFFERS);
        let (free_jobs, returned_jobs) = RingBuffer::new(JOBS);
        let (mut free_outputs, returned_outputs) = RingBuffer::new(OUTPUTS);
        let (learnt_to, learnt) = RingBuffer::new(LESSONS);
        let (frame_news_to, frame_news) = RingBuffer::new(NEWS);
        let (key_frame_news_to, key_frame_news) = RingBuffer::new(NEWS);
        let (reports_to, reports) = RingBuffer::new(FRAME_REPORTS);
        let (publications_to, publications) = RingBuffer::new(PUBLICATIONS);
        let (late_to, late) = RingBuffer::new(PUBLICATIONS);
        let (seen_to, seen) = RingBuffer::new(LENT);
        let (seen_back_to, seen_back) = RingBuffer::new(LENT);
        let (camera_teller, camera_traces) = traces();
        let (frame_teller, frame_traces) = traces();
        let (key_frame_teller, key_frame_traces) = traces();
        let (publisher_teller, publisher_traces) = traces();

        let buffers = plan.measure("frame buffers", || {
            filled(FRAME_BUFFERS, || frame_buffer(width, height))
        });
        let mut jobs = plan.measure("jobs", || filled(JOBS, || KeyFrameJob::new(width, height)));
        let mut outputs = plan.measure("outputs", || filled(OUTPUTS, || KeyFrameOutput::new(&config)));
        let lessons = plan.measure("lessons", || filled(LESSONS, Lesson::new));
        let frame_task = plan.measure("frame and track", || FrameTask::new(&config));
        let key_frame_task = plan.measure("map to grid", || KeyFrameTask::new(&config, Pace::Real));
        let publish_task = plan.measure("publisher", || PublishTask::new(&config, standing));
        let network = plan.measure("network's pictures", || {
            ThreadedNetwork::spawn(
                devices.segmenter,
                &config,
                &devices.tiles,
                shared.clock.clone(),
                real_time,
            )
        })?;
        let network_progress = network.progress();
        let (Some(job), Some(output)) = (jobs.pop(), outputs.pop()) else {
            unreachable!("there is one of each at least")
        };
        for output in outputs.drain(SPARE..) {
            // There is room for all of them.
            let _ = free_outputs.push(output);
        }
        Ok(Self {
            camera: CameraThread {
                camera: devices.camera,
                shared: Arc::clone(shared),
                stop: Arc::clone(stop),
                returned,
                buffers,
                teller: camera_teller,
            },
            frame: FrameThread {
                task: frame_task,
                config: config.clone(),
                wheels: devices.wheels,
                shared: Arc::clone(shared),
                returned: returned_to,
                job,
                jobs,
                returned_jobs,
                learnt: learnt_to,
                news: frame_news_to,
                reports: reports_to,
                teller: frame_teller,
                learnt_of: None,
            },
            key_frame: KeyFrameThread {
                task: Some(key_frame_task),
                config,
                slow,
                network,
                shared: Arc::clone(shared),
                output: Some(output),
                returned_outputs,
                lessons,
                learnt,
                news: key_frame_news_to,
                teller: key_frame_teller,
            },
            publisher: PublisherThread {
                task: publish_task,
                sinks: devices.sinks,
                shared: Arc::clone(shared),
                frame_news,
                key_frame_news,
                outputs,
                free_jobs,
                free_outputs,
                publications: publications_to,
                late: late_to,
                seen: seen_to,
                returned: seen_back,
                lent: 0,
                teller: publisher_teller,
            },
            observer: ObserverThread {
                shared: Arc::clone(shared),
                network_progress,
                reports,
                publications,
                late,
                seen,
                returned: seen_back_to,
                listeners: vec![camera_traces, frame_traces, key_frame_traces, publisher_traces],
            },
            real_time,
        })
    }

    /// Every message will say these faults too.
    pub(super) fn say_always(&mut self, faults: Faults) {
        self.publisher.task.say_always(faults);
    }

    /// Starts the threads, those first that others hand over to; each sets itself up for its role before it takes part.
    ///
    /// # Errors
    /// A thread could not be started.
    pub(super) fn start(self) -> Result<(Vec<JoinHandle<()>>, ObserverThread), RunError> {
        let Self {
            camera,
            frame,
            key_frame,
            publisher,
            observer,
            real_time,
        } = self;
        let starter = Starter {
            shared: Arc::clone(&observer.shared),
            real_time,
        };
        let handles = vec![
            starter.start(ThreadRole::Publisher, move || publisher.run())?,
            starter.start(ThreadRole::KeyFrame, move || key_frame.run())?,
            starter.start(ThreadRole::Frame, move || frame.run())?,
            starter.start(ThreadRole::Camera, move || camera.run())?,
        ];
        Ok((handles, observer))
    }
}

struct Starter {
    shared: Arc<Shared>,
    real_time: RealTimeConfig,
}

impl Starter {
    fn start(
        &self,
        role: ThreadRole,
        body: impl FnOnce() + Send + 'static,
    ) -> Result<JoinHandle<()>, RunError> {
        let real_time = self.real_time;
        let last_resort = LastResort {
            role,
            shared: Arc::clone(&self.shared),
        };
        let thread = rights::thread_builder(role, &real_time).spawn(move || {
            let _last_resort = last_resort;
            // What is refused was told when the rights were tried, before the start.
            let _ = rights::enter(role, &real_time);
            body();
        });
        thread.map_err(RunError::Thread)
    }
}

/// A thread that panics outside its guarded steps takes the drive with it, so that no other thread waits for it for ever.
struct LastResort {
    role: ThreadRole,
    shared: Arc<Shared>,
}

impl Drop for LastResort {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.shared.abandon(self.role == ThreadRole::Publisher);
        }
    }
}

fn filled<T>(count: usize, make: impl Fn() -> T) -> Vec<T> {
    (0..count).map(|_| make()).collect()
}

/// A buffer with room for the largest format, three bytes a pixel.
fn frame_buffer(width: usize, height: usize) -> Box<FrameBuffer> {
    Box::new(FrameBuffer {
        bytes: Vec::with_capacity(width * height * 3),
        ..FrameBuffer::default()
    })
}
