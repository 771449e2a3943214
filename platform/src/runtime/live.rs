//! Threads and the deadline: camera, frame task, key-frame task (the network beside it), publisher; the observer stays on the
//! caller's thread.
//!
//! Every hand-over is a bounded channel. Camera to frame task: newest frame wins, the displaced one is counted. Frame task
//! to key-frame task: a job waits for at most one other; where no job box is free the key frame is announced all the same and
//! the publisher answers it with a fallback. Publisher to observer: what finds the channel full goes straight back to the
//! pool, and is counted. Boxes circulate: all are allocated before the start.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use freespace::deadline::{Announcement, Publisher, Verdict};
use freespace::frame::Camera;
use freespace::grid::GridStage;
use freespace::pipeline::{EmitTask, FrameTask, KeyFrameJob, KeyFrameOutput, KeyFrameTask, Lesson, Pace};
use freespace::port::{CameraAnswer, CameraPort, Clock, FrameBuffer, WheelPort};
use freespace::space::Micros;

use super::allocation::{RealTimeScope, allocations};
use super::{
    CIRCULATING, FrameReport, KeyFrameReport, Observer, RunSummary, Setup, ThreadedNetwork,
    WHEEL_LOOKAHEAD_MICROS,
};
use crate::clock::MonotonicClock;

/// Frames between camera and frame task: one being worked on, one waiting, one being filled.
const FRAME_BUFFERS: usize = 3;

/// What the publisher hears.
enum News {
    Announced(Announcement),
    Answered(Box<KeyFrameJob>, Box<KeyFrameOutput>),
}

/// What the observer hears.
enum Observation {
    Frame(FrameReport),
    KeyFrame {
        job: Option<Box<KeyFrameJob>>,
        output: Box<KeyFrameOutput>,
        latency_micros: u64,
        is_miss: bool,
    },
}

/// Counters that several threads add to.
#[derive(Default)]
struct Counters {
    dropped_frames: AtomicU64,
    frames: AtomicU64,
    key_frames: AtomicU64,
    misses: AtomicU64,
    unobserved: AtomicU64,
}

/// A pool of boxes: a bounded channel that is filled before the start.
struct Pool<T> {
    give: Sender<Box<T>>,
    take: Receiver<Box<T>>,
}

impl<T> Clone for Pool<T> {
    fn clone(&self) -> Self {
        Self {
            give: self.give.clone(),
            take: self.take.clone(),
        }
    }
}

impl<T> Pool<T> {
    fn filled(count: usize, make: impl Fn() -> Box<T>) -> Self {
        let (give, take) = bounded(count);
        warm_up(&take);
        for _ in 0..count {
            // The channel has room for exactly `count`.
            let _ = give.try_send(make());
        }
        Self { give, take }
    }

    /// Gives a box back; there is room for every box that was made.
    fn put(&self, item: Box<T>) {
        let _ = self.give.try_send(item);
    }
}

/// Runs until the camera ends or `stop` is set; the first frame sets the clock.
///
/// # Errors
/// A thread could not be started, or ended by a panic.
pub fn run_live(
    setup: Setup,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
) -> std::io::Result<RunSummary> {
    let Setup { config, devices } = setup;
    let clock = MonotonicClock::default();
    let counters = Counters::default();
    let buffers = Pool::filled(FRAME_BUFFERS, Box::<FrameBuffer>::default);
    let jobs = Pool::filled(CIRCULATING, || {
        KeyFrameJob::new(config.camera.width, config.camera.height)
    });
    let outputs = Pool::filled(CIRCULATING, || KeyFrameOutput::new(&config));
    let lessons = Pool::filled(2, Lesson::new);
    let (frame_to, frames) = bounded::<Box<FrameBuffer>>(1);
    let (job_to, job_queue) = bounded::<Box<KeyFrameJob>>(1);
    let (lesson_to, lesson_queue) = bounded::<Box<Lesson>>(2);
    let (news_to, news) = bounded::<News>(2 * CIRCULATING);
    let (seen_to, seen) = bounded::<Observation>(256);
    warm_up(&frames);
    warm_up(&job_queue);
    warm_up(&lesson_queue);
    warm_up(&news);
    let network = ThreadedNetwork::spawn(devices.segmenter, &config, &devices.tiles, clock.clone())?;
    let frame_task = FrameTask::new(&config);
    let key_frame_task = KeyFrameTask::new(&config, Pace::Real);
    let publisher = PublisherThread {
        publisher: Publisher::new(&config.slices),
        emit: EmitTask::new(&config.camera, &config.slices),
        camera: config.camera,
        carrier: GridStage::new(
            &config.camera,
            config.grid,
            config.working_size.0,
            config.working_size.1,
        ),
        last: KeyFrameOutput::new(&config),
        has_last: false,
        deadline_micros: config.slices.deadline_micros,
        clock: clock.clone(),
        counters: &counters,
        jobs: jobs.clone(),
        outputs: outputs.clone(),
        seen: seen_to.clone(),
    };
    let allocations_before = allocations();
    thread::scope(|scope| -> std::io::Result<()> {
        let camera = CameraThread {
            camera: devices.camera,
            clock: clock.clone(),
            stop: Arc::clone(stop),
            counters: &counters,
            buffers: buffers.clone(),
            to: frame_to,
            displaced: frames.clone(),
        };
        spawn(scope, "camera", move || camera.run())?;
        let framer = FrameThread {
            task: frame_task,
            wheels: devices.wheels,
            clock: clock.clone(),
            counters: &counters,
            buffers: buffers.clone(),
            jobs: jobs.clone(),
            lessons: lessons.clone(),
            frames,
            lesson_queue,
            job_to,
            news: news_to.clone(),
            seen: seen_to,
        };
        spawn(scope, "frame", move || framer.run())?;
        let key_framer = KeyFrameThread {
            task: key_frame_task,
            network,
            clock: clock.clone(),
            jobs: jobs.clone(),
            outputs: outputs.clone(),
            lessons: lessons.clone(),
            queue: job_queue,
            lesson_to,
            news: news_to,
        };
        spawn(scope, "key-frame", move || key_framer.run())?;
        spawn(scope, "publisher", move || publisher.run(&news))?;
        observe(&seen, &jobs, &outputs, observer);
        Ok(())
    })?;
    Ok(RunSummary {
        frames: counters.frames.load(Ordering::Relaxed),
        dropped_frames: counters.dropped_frames.load(Ordering::Relaxed),
        key_frames: counters.key_frames.load(Ordering::Relaxed),
        deadline_misses: counters.misses.load(Ordering::Relaxed),
        unobserved_key_frames: counters.unobserved.load(Ordering::Relaxed),
        allocations_after_start: allocations() - allocations_before,
    })
}

fn spawn<'scope, 'env>(
    scope: &'scope thread::Scope<'scope, 'env>,
    name: &str,
    body: impl FnOnce() + Send + 'scope,
) -> std::io::Result<()> {
    thread::Builder::new()
        .name(name.to_owned())
        .stack_size(4 << 20)
        .spawn_scoped(scope, body)
        .map(drop)
}

/// Long enough that a wait parks, for only then is all allocated that a wait needs; a wait yields several times before, and on a
/// busy machine each yield may cost a time slice.
const WARM_UP: Duration = Duration::from_millis(100);

/// Lets a thread allocate what its first blocking wait needs, before it counts as real-time.
fn warm_up_waiting() {
    let (_keep, never) = bounded::<()>(1);
    warm_up(&never);
}

/// Lets a channel allocate its list of waiting threads, before any thread counts as real-time; it must be empty.
pub(super) fn warm_up<T>(receiver: &Receiver<T>) {
    let _ = receiver.recv_timeout(WARM_UP);
}

fn observe(
    seen: &Receiver<Observation>,
    jobs: &Pool<KeyFrameJob>,
    outputs: &Pool<KeyFrameOutput>,
    observer: &mut dyn Observer,
) {
    for observation in seen {
        match observation {
            Observation::Frame(report) => observer.frame(&report),
            Observation::KeyFrame {
                job,
                output,
                latency_micros,
                is_miss,
            } => {
                observer.key_frame(&KeyFrameReport {
                    index: output.frame,
                    job: job.as_deref(),
                    output: &output,
                    latency_micros,
                    is_miss,
                });
                if let Some(mut job) = job {
                    FrameTask::recycle(&mut job);
                    jobs.put(job);
                }
                outputs.put(output);
            }
        }
    }
}

struct CameraThread<'a> {
    camera: Box<dyn CameraPort + Send>,
    clock: MonotonicClock,
    stop: Arc<AtomicBool>,
    counters: &'a Counters,
    buffers: Pool<FrameBuffer>,
    to: Sender<Box<FrameBuffer>>,
    /// The receiving end of `to`, to take a frame back that a newer one displaces.
    displaced: Receiver<Box<FrameBuffer>>,
}

impl CameraThread<'_> {
    fn run(mut self) {
        let mut is_first = true;
        while !self.stop.load(Ordering::Relaxed) {
            // Three buffers: one with the frame task, one waiting, so that one is here.
            let Ok(mut buffer) = self.buffers.take.recv() else {
                return;
            };
            match self.camera.next_frame(&mut buffer) {
                CameraAnswer::End => return,
                CameraAnswer::Lost => {
                    self.counters.dropped_frames.fetch_add(1, Ordering::Relaxed);
                    self.buffers.put(buffer);
                }
                CameraAnswer::Frame => {
                    if is_first {
                        self.clock.start_at(buffer.stamp);
                        is_first = false;
                    }
                    self.clock.sleep_until(buffer.stamp);
                    self.hand_over(buffer);
                }
            }
        }
    }

    fn hand_over(&self, mut buffer: Box<FrameBuffer>) {
        loop {
            match self.to.try_send(buffer) {
                Ok(()) => return,
                Err(TrySendError::Disconnected(_)) => return,
                Err(TrySendError::Full(newer)) => {
                    buffer = newer;
                    if let Ok(older) = self.displaced.try_recv() {
                        // A wish for a key frame outlives the frame that carried it.
                        buffer.key_frame_wanted |= older.key_frame_wanted;
                        self.counters.dropped_frames.fetch_add(1, Ordering::Relaxed);
                        self.buffers.put(older);
                    }
                }
            }
        }
    }
}

struct FrameThread<'a> {
    task: FrameTask,
    wheels: Option<Box<dyn WheelPort + Send>>,
    clock: MonotonicClock,
    counters: &'a Counters,
    buffers: Pool<FrameBuffer>,
    jobs: Pool<KeyFrameJob>,
    lessons: Pool<Lesson>,
    frames: Receiver<Box<FrameBuffer>>,
    lesson_queue: Receiver<Box<Lesson>>,
    job_to: Sender<Box<KeyFrameJob>>,
    news: Sender<News>,
    seen: Sender<Observation>,
}

impl FrameThread<'_> {
    fn run(mut self) {
        let Ok(mut job) = self.jobs.take.recv() else {
            return;
        };
        warm_up_waiting();
        let _scope = RealTimeScope::enter();
        while let Ok(buffer) = self.frames.recv() {
            while let Ok(lesson) = self.lesson_queue.try_recv() {
                self.task.learn(&lesson);
                self.lessons.put(lesson);
            }
            if let Some(wheels) = &mut self.wheels {
                let until = buffer.stamp.plus(WHEEL_LOOKAHEAD_MICROS);
                wheels.readings_until(until, &mut |reading| self.task.wheel(reading));
            }
            let stepped = self
                .task
                .step(&buffer.raw(), buffer.key_frame_wanted, &mut job, &self.clock);
            let (index, stamp) = (buffer.index, buffer.stamp);
            self.buffers.put(buffer);
            let Ok(outcome) = stepped else {
                self.counters.dropped_frames.fetch_add(1, Ordering::Relaxed);
                continue;
            };
            self.counters.frames.fetch_add(1, Ordering::Relaxed);
            // A full channel means a stalled observer: the frame's report is lost, the drive goes on.
            let _ = self.seen.try_send(Observation::Frame(FrameReport {
                index,
                stamp,
                outcome,
            }));
            if outcome.is_key_frame {
                job.frame = index;
                job = self.hand_over(job);
            }
        }
    }

    /// Announces the key frame and hands its job over; where the key-frame task is behind, the same box is used again.
    fn hand_over(&self, mut job: Box<KeyFrameJob>) -> Box<KeyFrameJob> {
        let announcement = Announcement {
            sequence: job.sequence,
            frame: job.frame,
            stamp: job.stamp,
            world_from_camera: job.world_from_camera,
        };
        let _ = self.news.try_send(News::Announced(announcement));
        let Ok(next) = self.jobs.take.try_recv() else {
            FrameTask::recycle(&mut job);
            return job;
        };
        match self.job_to.try_send(job) {
            Ok(()) => next,
            Err(TrySendError::Full(mut job) | TrySendError::Disconnected(mut job)) => {
                self.jobs.put(next);
                FrameTask::recycle(&mut job);
                job
            }
        }
    }
}

struct KeyFrameThread {
    task: KeyFrameTask,
    network: ThreadedNetwork,
    clock: MonotonicClock,
    jobs: Pool<KeyFrameJob>,
    outputs: Pool<KeyFrameOutput>,
    lessons: Pool<Lesson>,
    queue: Receiver<Box<KeyFrameJob>>,
    lesson_to: Sender<Box<Lesson>>,
    news: Sender<News>,
}

impl KeyFrameThread {
    fn run(mut self) {
        warm_up_waiting();
        let _scope = RealTimeScope::enter();
        while let Ok(mut job) = self.queue.recv() {
            let (Ok(mut output), Ok(mut lesson)) = (self.outputs.take.try_recv(), self.lessons.take.recv())
            else {
                // Every output is still with the observer: the publisher's timer answers this key frame.
                FrameTask::recycle(&mut job);
                self.jobs.put(job);
                continue;
            };
            self.task
                .step(&job, &mut self.network, &self.clock, &mut output, &mut lesson);
            if let Err(TrySendError::Full(lesson) | TrySendError::Disconnected(lesson)) =
                self.lesson_to.try_send(lesson)
            {
                self.lessons.put(lesson);
            }
            if self.news.send(News::Answered(job, output)).is_err() {
                return;
            }
        }
    }
}

struct PublisherThread<'a> {
    publisher: Publisher,
    emit: EmitTask,
    camera: Camera,
    /// Holds the last grid, to be moved for a fallback.
    carrier: GridStage,
    /// The last answer, the base of a fallback.
    last: Box<KeyFrameOutput>,
    has_last: bool,
    deadline_micros: u64,
    clock: MonotonicClock,
    counters: &'a Counters,
    jobs: Pool<KeyFrameJob>,
    outputs: Pool<KeyFrameOutput>,
    seen: Sender<Observation>,
}

impl PublisherThread<'_> {
    fn run(mut self, news: &Receiver<News>) {
        warm_up_waiting();
        let _scope = RealTimeScope::enter();
        loop {
            let heard = match self.publisher.next_timer() {
                Some(timer) => news.recv_timeout(self.clock.until(timer)),
                None => news.recv().map_err(|_| RecvTimeoutError::Disconnected),
            };
            match heard {
                Ok(News::Announced(announcement)) => {
                    if let Some(displaced) = self.publisher.announce(announcement) {
                        self.publish_fallback(&displaced);
                    }
                }
                Ok(News::Answered(job, output)) => self.take_answer(job, output),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    // No answer can come any more: what is still awaited leaves now.
                    while let Some(pending) = self.publisher.expire(Micros(u64::MAX)) {
                        self.publish_fallback(&pending);
                    }
                    return;
                }
            }
            while let Some(pending) = self.publisher.expire(self.clock.now()) {
                self.publish_fallback(&pending);
            }
        }
    }

    fn take_answer(&mut self, mut job: Box<KeyFrameJob>, output: Box<KeyFrameOutput>) {
        self.last.copy_from(&output);
        let world_from_vehicle = self.camera.world_from_vehicle(&output.world_from_camera);
        self.carrier
            .adopt(&output.grid, &world_from_vehicle, output.stamp);
        self.has_last = true;
        match self.publisher.answer(output.sequence) {
            Verdict::Publish => self.publish(Some(job), output),
            Verdict::Late => {
                FrameTask::recycle(&mut job);
                self.jobs.put(job);
                self.outputs.put(output);
            }
        }
    }

    fn publish_fallback(&mut self, pending: &Announcement) {
        let Ok(mut output) = self.outputs.take.try_recv() else {
            // Nothing to write the fallback into: the observer holds every box. It still counts as a miss.
            self.counters.misses.fetch_add(1, Ordering::Relaxed);
            self.counters.key_frames.fetch_add(1, Ordering::Relaxed);
            self.counters.unobserved.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let last = self.has_last.then_some(&*self.last);
        output.fall_back(last, pending, &self.camera, &mut self.carrier);
        self.publish(None, output);
    }

    /// Emits an output and shows it to the observer; it counts as a miss where it is a fallback or late all the same.
    fn publish(&mut self, job: Option<Box<KeyFrameJob>>, mut output: Box<KeyFrameOutput>) {
        let now = self.clock.now();
        self.emit.step(&mut output, now, &self.clock);
        let latency_micros = self.clock.now().since(output.stamp);
        let is_miss = job.is_none() || latency_micros > self.deadline_micros;
        self.counters.key_frames.fetch_add(1, Ordering::Relaxed);
        self.counters
            .misses
            .fetch_add(u64::from(is_miss), Ordering::Relaxed);
        let observation = Observation::KeyFrame {
            job,
            output,
            latency_micros,
            is_miss,
        };
        if let Err(TrySendError::Full(lost) | TrySendError::Disconnected(lost)) =
            self.seen.try_send(observation)
        {
            self.counters.unobserved.fetch_add(1, Ordering::Relaxed);
            if let Observation::KeyFrame { job, output, .. } = lost {
                if let Some(mut job) = job {
                    FrameTask::recycle(&mut job);
                    self.jobs.put(job);
                }
                self.outputs.put(output);
            }
        }
    }
}
