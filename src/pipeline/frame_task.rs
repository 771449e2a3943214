//! The work of every frame: *frame*, *track*, and the views of the coming key frame.

use alloc::boxed::Box;

use super::{Cadence, Lesson, PipelineConfig};
use crate::deadline::Announcement;
use crate::frame::{FrameError, FrameStage, ImageFault, RawFrame, RgbImage};
use crate::health::{Faults, TrackingState};
use crate::map::{View, ViewBatch};
use crate::port::Clock;
use crate::space::{Micros, Plane, Pose};
use crate::stage::{Stage, StageProbe, StageTimes};
use crate::track::{FrameEstimate, Tracker, Travel, WheelOdometer, WheelReading};

/// Farther than this the pose does not move from a frame to the next, a correction by the map included.
const LARGEST_STEP_M: f64 = 60.0;
/// And than this for each second between them.
const LARGEST_SPEED_MPS: f64 = 120.0;

/// What a key frame is made of.
#[derive(Clone, Debug)]
pub struct KeyFrameJob {
    /// Number of the key frame, from 0.
    pub sequence: u32,
    /// Index of its frame.
    pub frame: u64,
    /// Capture stamp.
    pub stamp: Micros,
    /// The instant of the cadence that it serves; none where it was asked for out of turn.
    pub due: Option<Micros>,
    /// Pose as tracked.
    pub world_from_camera: Pose,
    /// Pose of the newest view, of this job or an earlier one, in the same chain.
    pub world_from_view: Option<Pose>,
    /// State of the tracker.
    pub tracking: TrackingState,
    /// Wheel travel at the stamp.
    pub travel: Option<Travel>,
    /// Speed over ground.
    pub speed_mps: f64,
    /// Faults noticed so far.
    pub faults: Faults,
    /// Views since the last key frame.
    pub batch: ViewBatch,
    /// The full-size picture; gray is replicated.
    pub image: RgbImage,
    /// Time spent in *frame* and *track*.
    pub times: StageTimes,
}

impl KeyFrameJob {
    /// An empty job for pictures of this size.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Box<Self> {
        Box::new(Self {
            sequence: 0,
            frame: 0,
            stamp: Micros::default(),
            due: None,
            world_from_camera: Pose::identity(),
            world_from_view: None,
            tracking: TrackingState::DeadReckoning,
            travel: None,
            speed_mps: 0.0,
            faults: Faults::NONE,
            batch: ViewBatch::new(),
            image: RgbImage::new(width, height),
            times: StageTimes::default(),
        })
    }

    /// What the publisher is told of it.
    #[must_use]
    pub const fn announcement(&self) -> Announcement {
        Announcement {
            sequence: self.sequence,
            frame: self.frame,
            stamp: self.stamp,
            due: self.due,
            world_from_camera: self.world_from_camera,
        }
    }

    fn clear(&mut self) {
        self.batch.clear();
        self.faults = Faults::NONE;
        self.times = StageTimes::default();
    }
}

/// What became of one frame.
#[derive(Clone, Copy, Debug)]
pub struct FrameOutcome {
    /// Pose and state.
    pub estimate: FrameEstimate,
    /// What is wrong with the picture, if anything.
    pub fault: Option<ImageFault>,
    /// Whether the job is complete: this frame is a key frame.
    pub is_key_frame: bool,
    /// Time that *frame* and *track* took.
    pub micros: u64,
}

/// The work of every frame.
pub struct FrameTask {
    stage: FrameStage,
    tracker: Tracker,
    wheels: Option<WheelOdometer>,
    /// A reading was taken since the last frame.
    is_wheel_heard: bool,
    cadence: Cadence,
    next_key_frame: Option<Micros>,
    plane_in_camera: Plane,
    frames: u64,
    sequence: u32,
    last: Option<FrameEstimate>,
    rejected_views: u64,
}

impl FrameTask {
    /// Allocates the stages *frame* and *track*.
    #[must_use]
    pub fn new(config: &PipelineConfig) -> Self {
        Self {
            stage: FrameStage::new(&config.camera),
            tracker: Tracker::new(&config.camera, &config.track),
            wheels: config.wheels.as_ref().map(|wheels| WheelOdometer::new(*wheels)),
            is_wheel_heard: false,
            cadence: config.cadence,
            next_key_frame: None,
            plane_in_camera: config.camera.mount.plane_in_camera(),
            frames: 0,
            sequence: 0,
            last: None,
            rejected_views: 0,
        }
    }

    /// A task to go on in place of this one after a panic: it keeps the count of frames, the cadence and the last pose, and
    /// nothing that the panic may have left half done.
    #[must_use]
    pub fn renewed(&self, config: &PipelineConfig) -> Self {
        let mut task = Self::new(config);
        task.next_key_frame = self.next_key_frame;
        task.frames = self.frames;
        task.sequence = self.sequence;
        task.rejected_views = self.rejected_views;
        let origin = self.last.map_or_else(
            || config.camera.mount.vehicle_from_camera(),
            |last| last.world_from_camera,
        );
        task.tracker = self.tracker.renewed(&config.track, origin);
        task.last = self.last;
        task.plane_in_camera = self.plane_in_camera;
        task
    }

    /// What is wrong with the wheels at a frame: they are silent, or they do tell, but of another time.
    fn wheel_faults(&mut self, stamp: Micros, has_travel: bool) -> Faults {
        let is_heard = core::mem::take(&mut self.is_wheel_heard);
        match &self.wheels {
            Some(wheels) if !has_travel => {
                if is_heard && wheels.is_apart(stamp) {
                    Faults::CLOCK_OFFSET
                } else {
                    Faults::WHEELS_SILENT
                }
            }
            _ => Faults::NONE,
        }
    }

    /// A wheel that the others contradict since the last key frame slips, is locked or stuck.
    fn judge_wheels(&mut self, job: &mut KeyFrameJob) {
        if self.wheels.as_mut().is_some_and(WheelOdometer::take_doubt) {
            job.faults.insert(Faults::WHEELS_SLIP);
        }
    }

    /// Takes a wheel reading; readings up to a frame's stamp, and better a little beyond, come before the frame.
    pub fn wheel(&mut self, reading: WheelReading) {
        if let Some(odometer) = &mut self.wheels {
            let newest = odometer.newest();
            odometer.push(reading);
            self.is_wheel_heard |= odometer.newest() != newest;
        }
    }

    /// Learns what the map found at an earlier key frame.
    pub fn learn(&mut self, lesson: &Lesson) {
        self.tracker.apply(&lesson.update);
        self.plane_in_camera = lesson.plane_in_camera;
    }

    /// Takes a frame; fills `job`, which is complete where the outcome says so.
    ///
    /// `key_frame_wanted` makes this frame a key frame whatever the cadence says.
    ///
    /// # Errors
    /// The frame does not fit the camera; nothing has changed then. [`FrameError::Broken`]: go on with [`Self::renewed`].
    pub fn step(
        &mut self,
        raw: &RawFrame<'_>,
        key_frame_wanted: bool,
        job: &mut KeyFrameJob,
        clock: &impl Clock,
        probe: &impl StageProbe,
    ) -> Result<FrameOutcome, FrameError> {
        let begin = clock.now();
        if !probe.enter(Stage::Frame) {
            return Err(FrameError::Refused);
        }
        let fault = self.stage.step(raw)?;
        let decoded = clock.now();
        let is_sound = probe.enter(Stage::Track);
        let travel = self
            .wheels
            .as_ref()
            .and_then(|wheels| wheels.travel_at(raw.stamp));
        let estimate = match fault {
            None if is_sound => self.tracker.step(
                self.stage.previous_pyramid(),
                self.stage.pyramid(),
                raw.stamp,
                travel,
                &self.plane_in_camera,
            ),
            _ => self.tracker.coast(raw.stamp, travel),
        };
        if !self.is_plausible(&estimate) {
            return Err(FrameError::Broken);
        }
        self.collect_view(job);
        if let Some(fault) = fault {
            job.faults.insert(fault.into());
        }
        job.faults |= self.wheel_faults(raw.stamp, travel.is_some());
        let due = self.due(raw.stamp);
        let is_key_frame = due.is_some() || key_frame_wanted;
        if is_key_frame {
            job.due = due;
            self.complete(raw, &estimate, job);
            self.judge_wheels(job);
        }
        let end = clock.now();
        job.times = StageTimes::default();
        job.times.add(Stage::Frame, decoded.since(begin));
        job.times.add(Stage::Track, end.since(decoded));
        self.frames += 1;
        self.last = Some(estimate);
        Ok(FrameOutcome {
            estimate,
            fault,
            is_key_frame,
            micros: end.since(begin),
        })
    }

    /// Prepares a job that came back for the views of the next key frame.
    pub fn recycle(job: &mut KeyFrameJob) {
        job.clear();
    }

    /// Views that found their batch full.
    #[must_use]
    pub const fn rejected_views(&self) -> u64 {
        self.rejected_views
    }

    fn collect_view(&mut self, job: &mut KeyFrameJob) {
        if !self.tracker.wants_view() {
            return;
        }
        if job.batch.is_full() {
            self.rejected_views += 1;
            return;
        }
        // A view is large: it is written in place, after an empty one was pushed.
        if job.batch.push(View::default()).is_ok()
            && let Some(view) = job.batch.last_mut()
        {
            self.tracker.view_into(view);
        }
    }

    /// The instant of the cadence that a frame at `stamp` serves.
    fn due(&mut self, stamp: Micros) -> Option<Micros> {
        let Cadence::Micros(period) = self.cadence else {
            return None;
        };
        let period = period.max(1);
        let next = *self.next_key_frame.get_or_insert(stamp);
        if stamp < next {
            return None;
        }
        // A gap in the frames may span several instants: the frame serves the last of them.
        let due = next.plus(stamp.since(next) / period * period);
        self.next_key_frame = Some(due.plus(period));
        Some(due)
    }

    fn complete(&mut self, raw: &RawFrame<'_>, estimate: &FrameEstimate, job: &mut KeyFrameJob) {
        job.sequence = self.sequence;
        self.sequence = self.sequence.wrapping_add(1);
        job.frame = self.frames;
        job.stamp = raw.stamp;
        job.world_from_camera = estimate.world_from_camera;
        job.world_from_view = self.tracker.world_from_view();
        job.tracking = estimate.state;
        job.travel = estimate.travel;
        job.speed_mps = self.speed_mps(estimate);
        if matches!(estimate.state, TrackingState::DeadReckoning) && self.frames > 0 {
            job.faults.insert(Faults::TRACKING_LOST);
        }
        // Cannot fail: the frame was taken above, and the job's picture has the camera's size.
        let _ = raw.rgb_into(&mut job.image);
    }

    /// Whether a pose is a place at all, and one that the car can have come to.
    fn is_plausible(&self, estimate: &FrameEstimate) -> bool {
        let pose = &estimate.world_from_camera;
        let is_finite = pose.to_homogeneous().iter().all(|value| value.is_finite());
        let is_near = self.last.is_none_or(|last| {
            let moved = pose.translation.vector - last.world_from_camera.translation.vector;
            let seconds = estimate.stamp.seconds_since(last.stamp).max(0.0);
            moved.norm() < LARGEST_STEP_M + LARGEST_SPEED_MPS * seconds
        });
        is_finite && is_near
    }

    fn speed_mps(&self, estimate: &FrameEstimate) -> f64 {
        let Some(last) = &self.last else { return 0.0 };
        let seconds = estimate.stamp.seconds_since(last.stamp);
        if seconds <= 0.0 {
            return 0.0;
        }
        (estimate.world_from_camera.translation.vector - last.world_from_camera.translation.vector).norm()
            / seconds
    }
}
