//! A simulated clock: what each stage costs, and the faults that are put into it.
//!
//! In: a [`FaultModel`]. Out: clock, probe and ports that behave by it. Invariant: nothing depends on the machine, so the same
//! model and input give the same answers at the same times.

use std::cell::Cell;
use std::rc::Rc;

use freespace::frame::RgbImage;
use freespace::port::{CameraAnswer, CameraPort, Clock, FrameBuffer, NetworkMiss, RoadNetwork, WheelPort};
use freespace::segmentation::RoadProbability;
use freespace::space::Micros;
use freespace::stage::{Stage, StageProbe};
use freespace::track::WheelReading;

use super::time::TaskTime;

/// Whom a fault hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Victim {
    /// A stage of a task.
    Stage(Stage),
    /// The network, beside the tasks.
    Network,
    /// The camera.
    Camera,
    /// The wheel encoders.
    Wheels,
}

/// How it is hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultKind {
    /// Ten times slower; a camera gives one frame in ten.
    Slow,
    /// Never returns again; a camera or encoders are silent for the time of the fault.
    Hang,
    /// Fails at once.
    Fail,
    /// Panics.
    Panic,
}

/// One fault, and the time in which it is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Injection {
    /// Whom it hits.
    pub victim: Victim,
    /// How.
    pub kind: FaultKind,
    /// First instant.
    pub from: Micros,
    /// End.
    pub until: Micros,
}

/// What stages cost, and what goes wrong.
#[derive(Clone, Copy, Debug)]
pub struct FaultModel {
    /// Microseconds of each stage, and of each of its quanta, the readings of the clock inside it, where it is slowed.
    pub costs_micros: [(u64, u64); Stage::ALL.len()],
    /// Microseconds of the network.
    pub network_micros: u64,
    /// What goes wrong.
    pub injection: Option<Injection>,
}

impl Default for FaultModel {
    /// About what two cores take at 640x480.
    fn default() -> Self {
        Self {
            costs_micros: [
                (200, 0),
                (5_000, 0),
                (4_000, 500),
                (3_000, 0),
                (3_000, 0),
                (5_000, 400),
                (1_000, 0),
                (200, 0),
            ],
            network_micros: 18_000,
            injection: None,
        }
    }
}

const SLOWER: u64 = 10;
/// Longer than any drive.
const FOR_EVER_MICROS: u64 = 1 << 50;

impl FaultModel {
    /// What hits a victim at a time.
    fn fault(&self, victim: Victim, at: Micros) -> Option<FaultKind> {
        self.injection
            .filter(|injection| injection.victim == victim)
            .filter(|injection| (injection.from..injection.until).contains(&at))
            .map(|injection| injection.kind)
    }

    fn slowed(&self, victim: Victim, at: Micros, micros: u64) -> u64 {
        match self.fault(victim, at) {
            Some(FaultKind::Slow) => micros * SLOWER,
            _ => micros,
        }
    }
}

/// The time of one task, shared with what works beside it.
#[derive(Clone)]
pub(super) struct Modelled(Rc<TaskState>);

struct TaskState {
    model: FaultModel,
    now: Cell<Micros>,
    began: Cell<Micros>,
    stage: Cell<Option<Stage>>,
    hangs: Cell<bool>,
    has_panicked: Cell<bool>,
}

impl Modelled {
    pub(super) fn new(model: &FaultModel) -> Self {
        Self(Rc::new(TaskState {
            model: *model,
            now: Cell::default(),
            began: Cell::default(),
            stage: Cell::default(),
            hangs: Cell::default(),
            has_panicked: Cell::default(),
        }))
    }

    fn spend(&self, micros: u64) -> Micros {
        let now = self.0.now.get();
        self.0.now.set(now.plus(micros));
        now
    }
}

impl Clock for Modelled {
    fn now(&self) -> Micros {
        // A stage at its usual pace is charged as a whole when it is entered: how many quanta it makes of it does not matter.
        let quantum = self.0.stage.get().map_or(0, |stage| {
            let is_slow =
                self.0.model.fault(Victim::Stage(stage), self.0.began.get()) == Some(FaultKind::Slow);
            let (_, micros) = self.0.model.costs_micros[stage as usize];
            if is_slow { micros * SLOWER } else { 0 }
        });
        self.spend(quantum)
    }
}

impl StageProbe for Modelled {
    fn enter(&self, stage: Stage) -> bool {
        // What hangs never gets any further.
        if self.0.hangs.get() {
            return false;
        }
        self.0.stage.set(Some(stage));
        // A fault holds for a whole key frame or frame: that at whose beginning it was there.
        let (victim, began) = (Victim::Stage(stage), self.0.began.get());
        let (micros, _) = self.0.model.costs_micros[stage as usize];
        self.spend(self.0.model.slowed(victim, began, micros));
        match self.0.model.fault(victim, began) {
            None | Some(FaultKind::Slow) => true,
            Some(FaultKind::Fail) => false,
            Some(FaultKind::Hang) => {
                self.0.hangs.set(true);
                self.spend(FOR_EVER_MICROS);
                true
            }
            // The publisher's own panics are its supervisor's when they go on: it is hit once.
            Some(FaultKind::Panic) if stage == Stage::Emit && self.0.has_panicked.replace(true) => true,
            // Without the message that a panic prints.
            Some(FaultKind::Panic) => std::panic::resume_unwind(Box::new("injected")),
        }
    }

    fn rest(&self) {}
}

impl TaskTime for Modelled {
    fn begin(&self, at: Micros, _frame: Option<u64>) {
        self.0.now.set(at);
        self.0.began.set(at);
        self.0.stage.set(None);
    }

    fn end(&self, _began: Micros) -> Option<Micros> {
        (!self.0.hangs.get()).then(|| self.0.now.get())
    }

    fn stage(&self) -> Option<Stage> {
        self.0.stage.get()
    }
}

/// A network beside the key-frame task.
pub(super) struct ModelledNetwork<N> {
    inner: N,
    model: FaultModel,
    task: Modelled,
    /// When the run that was begun last is over; none where the network was busy.
    done: Option<Micros>,
    free: Micros,
}

impl<N: RoadNetwork> ModelledNetwork<N> {
    pub(super) fn new(inner: N, task: &Modelled, model: &FaultModel) -> Self {
        Self {
            inner,
            model: *model,
            task: task.clone(),
            done: None,
            free: Micros(0),
        }
    }
}

impl<N: RoadNetwork> RoadNetwork for ModelledNetwork<N> {
    fn begin(&mut self, image: &RgbImage) {
        let now = self.task.0.now.get();
        self.done = None;
        if now >= self.free {
            self.inner.begin(image);
            let micros = match self.model.fault(Victim::Network, now) {
                Some(FaultKind::Hang) => FOR_EVER_MICROS,
                Some(FaultKind::Slow) => self.model.network_micros * SLOWER,
                _ => self.model.network_micros,
            };
            self.free = now.plus(micros);
            self.done = Some(self.free);
        }
    }

    fn finish(&mut self, until: Option<Micros>, out: &mut RoadProbability) -> Result<u64, NetworkMiss> {
        let done = self.done.ok_or(NetworkMiss::Busy)?;
        let now = self.task.0.now.get();
        if until.is_some_and(|until| done > until) {
            self.task.0.now.set(now.max(until.unwrap_or(now)));
            return Err(NetworkMiss::Late);
        }
        self.task.0.now.set(now.max(done));
        match self.model.fault(Victim::Network, self.task.0.began.get()) {
            Some(FaultKind::Fail | FaultKind::Panic) => Err(NetworkMiss::Failed),
            _ => {
                self.inner.finish(None, out)?;
                Ok(self.model.network_micros)
            }
        }
    }
}

/// A camera that falls silent, or loses frames.
pub(super) struct ModelledCamera {
    inner: Box<dyn CameraPort + Send>,
    model: FaultModel,
}

impl ModelledCamera {
    pub(super) fn new(inner: Box<dyn CameraPort + Send>, model: &FaultModel) -> Self {
        Self { inner, model: *model }
    }
}

impl CameraPort for ModelledCamera {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        loop {
            let answer = self.inner.next_frame(buffer);
            if answer != CameraAnswer::Frame {
                return answer;
            }
            match self.model.fault(Victim::Camera, buffer.stamp) {
                None => return CameraAnswer::Frame,
                Some(FaultKind::Slow) if buffer.index.is_multiple_of(SLOWER) => return CameraAnswer::Frame,
                Some(FaultKind::Fail | FaultKind::Panic) => return CameraAnswer::Lost,
                Some(FaultKind::Slow | FaultKind::Hang) => {}
            }
        }
    }
}

/// Encoders that fall silent.
pub(super) struct ModelledWheels {
    inner: Box<dyn WheelPort + Send>,
    model: FaultModel,
}

impl ModelledWheels {
    pub(super) fn new(inner: Box<dyn WheelPort + Send>, model: &FaultModel) -> Self {
        Self { inner, model: *model }
    }
}

impl WheelPort for ModelledWheels {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        let model = self.model;
        self.inner.readings_until(until, &mut |reading| {
            if model.fault(Victim::Wheels, reading.stamp()).is_none() {
                take(reading);
            }
        });
    }
}
