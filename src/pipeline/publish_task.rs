//! The work of the publisher: what leaves for each key frame, when, and with what it says of itself.
//!
//! In: announcements, answers and failures of the two tasks, and the time. Out: outputs filled, marked and emitted, in boxes
//! of the caller. Invariant: for every key frame exactly one publication leaves (see [`Publisher`]). Cost: one encoding; a
//! fallback also moves one grid.

use alloc::boxed::Box;

use nalgebra::{Translation3, UnitQuaternion};

use super::{Cadence, EmitTask, KeyFrameOutput, PipelineConfig};
use crate::budget::STALE_MICROS;
use crate::deadline::{Announcement, Cause, Due, Publisher, Verdict};
use crate::frame::Camera;
use crate::grid::GridStage;
use crate::health::{Blame, Faults, QualityLevel, TrackingState};
use crate::port::Clock;
use crate::space::{Micros, Pose};
use crate::stage::Stage;

/// Faults of a message and its way out, not of the answer in it: an answer that is moved later does not say them again.
const OF_THE_MESSAGE: Faults = Faults(
    Faults::CAN_SEND_FAILED.0
        | Faults::HANDOVER_DROPPED.0
        | Faults::STAGE_PANICKED.0
        | Faults::RIGHTS_LACKING.0
        | Faults::DEADLINE_MISSED.0,
);

/// What the tasks are at, for the blame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Workers {
    /// Stage that the frame task is in; none while it waits for frames.
    pub frame: Option<Stage>,
    /// Stage that the key-frame task is in; none while it waits for jobs.
    pub key_frame: Option<Stage>,
    /// Stamp of the newest frame that the camera gave, whatever became of it.
    pub captured: Option<Micros>,
}

/// The last answer, and the grid stage that moves it.
struct LastAnswer {
    output: Box<KeyFrameOutput>,
    carrier: GridStage,
    is_known: bool,
    is_adopted: bool,
}

/// The publisher's work.
pub struct PublishTask {
    publisher: Publisher,
    emit: EmitTask,
    camera: Camera,
    deadline_micros: u64,
    last: LastAnswer,
    /// The last two announced poses, oldest first.
    motion: [Option<(Micros, Pose)>; 2],
    publications: u64,
    fresh: u64,
    standing: Faults,
    passing: Faults,
}

impl PublishTask {
    /// Allocates the last answer. `standing` faults are said by every message.
    #[must_use]
    pub fn new(config: &PipelineConfig, standing: Faults) -> Self {
        let period_micros = match config.cadence {
            Cadence::Micros(period) => Some(period),
            Cadence::OnDemand => None,
        };
        let (width, height) = config.working_size;
        Self {
            publisher: Publisher::new(&config.slices, period_micros),
            emit: EmitTask::new(&config.camera, &config.slices),
            camera: config.camera,
            deadline_micros: config.slices.deadline_micros,
            last: LastAnswer {
                output: KeyFrameOutput::new(config),
                carrier: GridStage::new(&config.camera, config.grid, width, height),
                is_known: false,
                is_adopted: false,
            },
            motion: [None; 2],
            publications: 0,
            fresh: 0,
            standing,
            passing: Faults::NONE,
        }
    }

    /// Faults that every message says from now on, besides those of the start.
    pub fn say_always(&mut self, faults: Faults) {
        self.standing |= faults;
    }

    /// Takes note of a key frame.
    pub fn announce(&mut self, announcement: Announcement) {
        self.publisher.announce(announcement);
        self.motion = [
            self.motion[1],
            Some((announcement.stamp, announcement.world_from_camera)),
        ];
    }

    /// Takes an answer. [`Verdict::Publish`]: it is emitted, and leaves; [`Verdict::Late`]: a fallback left in its place.
    pub fn answer(&mut self, now: Micros, output: &mut KeyFrameOutput, clock: &impl Clock) -> Verdict {
        let verdict = self.publisher.answer(output.sequence);
        if verdict == Verdict::Publish {
            self.emit(now, output, clock);
            self.fresh += 1;
        }
        verdict
    }

    /// Keeps an answer, late or not, as the base of the next fallback: to be called once it has left.
    pub fn keep(&mut self, output: &KeyFrameOutput) {
        if !self.last.is_known || output.stamp > self.last.output.stamp {
            self.last.output.copy_from(output);
            self.last.output.faults.remove(OF_THE_MESSAGE);
            self.last.is_known = true;
            self.last.is_adopted = false;
        }
    }

    /// The key-frame task gave a key frame up, or panicked over it.
    pub fn fail(&mut self, sequence: u32, cause: Cause) {
        self.publisher.fail(sequence, cause);
    }

    /// A part that works on no key frame panicked.
    pub fn panicked(&mut self, blame: Blame, now: Micros) {
        self.publisher.panicked(blame, now);
    }

    /// Answers for key frames from `stamp` on, should none come.
    pub fn expect_from(&mut self, stamp: Micros) {
        self.publisher.expect_from(stamp);
    }

    /// The camera has come to its end.
    pub fn expect_no_more(&mut self) {
        self.publisher.expect_no_more();
    }

    /// Faults that the next message reports, once.
    pub fn report(&mut self, faults: Faults) {
        self.passing |= faults;
    }

    /// The instant at which [`PublishTask::fall_back`] must be asked again.
    #[must_use]
    pub fn next_timer(&self) -> Option<Micros> {
        self.publisher.next_timer()
    }

    /// Fills and emits, `now`, a fallback that must leave until `until`; false where none must. Call until none is left.
    pub fn fall_back(
        &mut self,
        until: Micros,
        now: Micros,
        workers: &Workers,
        output: &mut KeyFrameOutput,
        clock: &impl Clock,
    ) -> bool {
        let Some(due) = self.publisher.expire(until) else {
            return false;
        };
        self.fill(&due, workers, output);
        self.emit(now, output, clock);
        true
    }

    /// Fills and emits the last message of a drive.
    pub fn shut_down(&mut self, now: Micros, output: &mut KeyFrameOutput, clock: &impl Clock) {
        output.clear();
        output.stamp = now;
        output.has_frame = false;
        output.faults = Faults::SHUTTING_DOWN;
        self.emit(now, output, clock);
    }

    /// Messages that held the answer they were meant to hold.
    #[must_use]
    pub const fn fresh(&self) -> u64 {
        self.fresh
    }

    /// Key frames that nothing answered, for the publisher itself did not run.
    #[must_use]
    pub const fn unanswered(&self) -> u64 {
        self.publisher.unanswered()
    }

    /// Answers and announcements that came after their fallback.
    #[must_use]
    pub const fn late(&self) -> u64 {
        self.publisher.late()
    }

    fn fill(&mut self, due: &Due, workers: &Workers, output: &mut KeyFrameOutput) {
        let blame = blame(due, workers);
        let (pose, tracking) = match &due.announcement {
            Some(announced) => (announced.world_from_camera, self.last.output.tracking),
            None => (self.foretold_pose(due.stamp), TrackingState::DeadReckoning),
        };
        let is_stale = due.stamp.since(self.last.output.stamp) > STALE_MICROS;
        if !self.last.is_known || is_stale || matches!(due.cause, Cause::Panicked(_)) {
            output.clear();
            output.faults = Faults::NONE.with(Faults::GRID_STALE, self.last.is_known && is_stale);
        } else {
            self.last.move_into(&self.camera, &pose, due.stamp, output);
        }
        output.faults |= cause_faults(due.cause, blame);
        output.blame = Some(blame);
        output.stamp = due.stamp;
        output.world_from_camera = pose;
        output.tracking = tracking;
        output.has_frame = due.announcement.is_some();
        output.sequence = due.announcement.map_or(0, |announced| announced.sequence);
        output.frame = due.announcement.map_or(0, |announced| announced.frame);
        output.times = crate::stage::StageTimes::default();
        output.cuts = crate::stage::Cuts::default();
    }

    /// Where the car is if it goes on as it went between the last two key frames.
    fn foretold_pose(&self, stamp: Micros) -> Pose {
        let (Some((newer_stamp, newer)), older) = (self.motion[1], self.motion[0]) else {
            return self.camera.mount.vehicle_from_camera();
        };
        let Some((older_stamp, older)) = older.filter(|(older_stamp, _)| *older_stamp < newer_stamp) else {
            return newer;
        };
        let share = stamp.seconds_since(newer_stamp) / newer_stamp.seconds_since(older_stamp);
        // Farther ahead than a fallback is ever moved, the past says nothing.
        let share = share.clamp(0.0, 10.0);
        let motion = older.inv_mul(&newer);
        newer
            * Pose::from_parts(
                Translation3::from(motion.translation.vector * share),
                UnitQuaternion::from_scaled_axis(motion.rotation.scaled_axis() * share),
            )
    }

    fn emit(&mut self, now: Micros, output: &mut KeyFrameOutput, clock: &impl Clock) {
        output.latency_micros = now.since(output.stamp);
        output.faults |= self.standing | self.passing;
        self.passing = Faults::NONE;
        let is_miss = output.level >= QualityLevel::Moved || output.latency_micros > self.deadline_micros;
        output.faults = output.faults.with(Faults::DEADLINE_MISSED, is_miss);
        output.publication = self.publications;
        self.publications += 1;
        self.emit.step(output, now, clock);
    }
}

impl LastAnswer {
    fn move_into(&mut self, camera: &Camera, pose: &Pose, stamp: Micros, output: &mut KeyFrameOutput) {
        let last = &self.output;
        if !self.is_adopted {
            let then = camera.world_from_vehicle(&last.world_from_camera);
            self.carrier.adopt(&last.grid, &then, last.stamp);
            self.is_adopted = true;
        }
        self.carrier.carry(&camera.world_from_vehicle(pose), stamp);
        output.copy_from(last);
        output.grid.copy_from(self.carrier.grid());
        output.boundary = *self.carrier.boundary();
        output.level = QualityLevel::Moved;
    }
}

const fn cause_faults(cause: Cause, blame: Blame) -> Faults {
    match (cause, blame) {
        (Cause::Late | Cause::GivenUp(_), _) => Faults::NONE,
        (Cause::Panicked(_), _) => Faults::STAGE_PANICKED,
        (Cause::Missing, Blame::Camera) => Faults(Faults::KEY_FRAME_MISSING.0 | Faults::CAMERA_SILENT.0),
        (Cause::Missing, Blame::Stage(_)) => Faults::KEY_FRAME_MISSING,
    }
}

/// Whoever is at work when time is up; where nobody is, the hand-over to the last stage. The camera is to blame where it gave
/// no frame since the instant; a frame that it gave went astray on its way to *frame*.
fn blame(due: &Due, workers: &Workers) -> Blame {
    let is_captured = workers.captured.is_some_and(|captured| captured >= due.stamp);
    match due.cause {
        Cause::GivenUp(blame) | Cause::Panicked(blame) => blame,
        Cause::Late => Blame::Stage(workers.key_frame.unwrap_or(Stage::Emit)),
        Cause::Missing => match workers.frame {
            Some(stage) => Blame::Stage(stage),
            None if is_captured => Blame::Stage(Stage::Frame),
            None => Blame::Camera,
        },
    }
}
