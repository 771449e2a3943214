//! The threads' work one step after the other, on a clock of its own: the same input gives the same output, byte for byte.
//!
//! In: a [`Setup`], and a [`TaskTime`] a task that says how long its work takes: none at all in a replay, or what a
//! [`FaultModel`] or a recorded drive says. Out: what a live run gives, by the same tasks. Invariant: whatever happens is handled in the order of its time;
//! equal times in the order in which they came to be known. The hand-overs are those of a live run: newest frame and newest job
//! win. Cost: the work itself; a handful of events wait at a time.

mod agenda;
mod engine;
mod model;
mod recorded;
mod time;

pub use model::{FaultKind, FaultModel, Injection, Victim};
pub use recorded::{KeyFrameTimes, RecordedTimes};

use freespace::pipeline::Pace;
use freespace::port::WheelPort;

use super::allocation::allocations;
use super::{InlineNetwork, Observer, RunSummary, Setup};
use engine::Engine;
use model::{Modelled, ModelledCamera, ModelledNetwork, ModelledWheels};
use recorded::{Recorded, RecordedNetwork};
use std::rc::Rc;
use time::Measured;

/// Runs until the camera ends. Work takes no time: a key frame is answered at its capture.
pub fn run_in_lockstep(setup: Setup, observer: &mut dyn Observer) -> RunSummary {
    let Setup { config, devices, .. } = setup;
    let network = InlineNetwork::new(devices.segmenter, &config, &devices.tiles);
    let times = [Measured::default(), Measured::default(), Measured::default()];
    let engine = Engine::new(
        &config,
        Pace::Reproducible,
        network,
        devices.wheels,
        devices.sinks,
        times,
    );
    let allocations_before = allocations();
    let mut summary = engine.run(devices.camera, observer);
    summary.allocations_after_start = allocations() - allocations_before;
    summary
}

/// Runs until the camera ends, on a simulated clock: stages take the time that `model` says, and fail as it says.
pub fn run_modelled(setup: Setup, model: &FaultModel, observer: &mut dyn Observer) -> RunSummary {
    let Setup { config, devices, .. } = setup;
    let network = InlineNetwork::new(devices.segmenter, &config, &devices.tiles);
    let times = [(); 3].map(|()| Modelled::new(model));
    let network = ModelledNetwork::new(network, &times[1], model);
    let camera = ModelledCamera::new(devices.camera, model);
    let wheels = (devices.wheels)
        .map(|wheels| -> Box<dyn WheelPort + Send> { Box::new(ModelledWheels::new(wheels, model)) });
    Engine::new(&config, Pace::Real, network, wheels, devices.sinks, times).run(Box::new(camera), observer)
}

/// Runs until the camera ends, on the clock of a drive that was recorded: frames and key frames take the time that they took then,
/// what it was too late for is left out again, and what was refined is refined as far.
pub fn run_recorded(setup: Setup, times: RecordedTimes, observer: &mut dyn Observer) -> RunSummary {
    let Setup { config, devices, .. } = setup;
    let network = InlineNetwork::new(devices.segmenter, &config, &devices.tiles);
    let drive = Rc::new(times);
    let times = [
        Recorded::frame(&drive),
        Recorded::key_frame(&drive),
        Recorded::publisher(&drive),
    ];
    let network = RecordedNetwork::new(network, &times[1]);
    Engine::new(&config, Pace::Real, network, devices.wheels, devices.sinks, times)
        .run(devices.camera, observer)
}
