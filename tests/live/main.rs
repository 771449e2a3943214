//! Short drives on the real threads, with devices that fail: every key frame is answered, and what failed is said.
//!
//! How late an answer is depends on the machine; that there is one for each key frame does not.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod devices;
mod panics;
#[path = "../simulated/mod.rs"]
mod simulated;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use freespace::emit::CanFrame;
use freespace::health::{Faults, QualityLevel};
use freespace::port::{SinkMiss, SinkPort, WheelPort};
use freespace::space::Micros;
use freespace::track::WheelReading;
use freespace_platform::runtime::allocation::CountingAllocator;
use freespace_platform::runtime::{
    Event, FrameReport, KeyFrameReport, Observer, RunError, RunSummary, Setup, Status, Trace, run_live,
};
use freespace_platform::statistics::Publication;
use simulated::Triangle;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const SECONDS: f64 = 3.0;
const KEY_FRAMES: u64 = 6;

#[derive(Default)]
pub(crate) struct Log {
    pub(crate) publications: Vec<Publication>,
    pub(crate) events: Vec<Event>,
    stop_after: Option<(u64, Arc<AtomicBool>)>,
}

impl Observer for Log {
    fn frame(&mut self, _report: &FrameReport) {}

    fn publication(&mut self, publication: &Publication) {
        self.publications.push(*publication);
    }

    fn key_frame(&mut self, _report: &KeyFrameReport<'_>) {}

    fn trace(&mut self, trace: &Trace) {
        self.events.push(trace.event);
    }

    fn status(&mut self, status: &Status) {
        if let Some((key_frames, stop)) = &self.stop_after
            && status.key_frames >= *key_frames
        {
            stop.store(true, Ordering::Relaxed);
        }
    }
}

fn setup(
    network: Triangle,
    wheels: impl FnOnce(Box<dyn WheelPort + Send>) -> Box<dyn WheelPort + Send>,
) -> Setup {
    let (camera, frames, encoders) = simulated::devices(SECONDS);
    let mut setup = simulated::setup(camera, frames, Some(wheels(encoders)), network);
    // Tests run side by side in one process: its memory is not theirs to lock.
    setup.real_time.lock_memory = false;
    setup
}

fn drive(setup: Setup, log: &mut Log) -> RunSummary {
    let stop = Arc::new(AtomicBool::new(false));
    if let Some((_, theirs)) = &mut log.stop_after {
        *theirs = Arc::clone(&stop);
    }
    run(setup, &stop, log).unwrap()
}

/// Allocations are counted over the whole process: whoever counts them wants to be alone.
static ALONE: RwLock<()> = RwLock::new(());

/// A run beside others.
fn run(setup: Setup, stop: &Arc<AtomicBool>, observer: &mut dyn Observer) -> Result<RunSummary, RunError> {
    let _beside_others = ALONE.read().unwrap_or_else(PoisonError::into_inner);
    run_live(setup, stop, observer)
}

#[test]
fn a_live_drive_answers_every_key_frame_and_allocates_nothing() {
    let mut log = Log::default();
    let _alone = ALONE.write().unwrap_or_else(PoisonError::into_inner);
    let setup = setup(Triangle::new(0..0), |wheels| wheels);
    let summary = run_live(setup, &Arc::default(), &mut log).unwrap();
    assert_eq!(summary.key_frames, KEY_FRAMES);
    assert_eq!(log.publications.len() as u64, KEY_FRAMES);
    assert_eq!((summary.allocations_after_start, summary.restarts), (0, 0));
}

/// Panics once, when it is asked for the tenth time.
pub(crate) struct PanickingWheels {
    pub(crate) inner: Box<dyn WheelPort + Send>,
    pub(crate) asked: u32,
}

impl WheelPort for PanickingWheels {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        self.asked += 1;
        if self.asked == 10 {
            std::panic::resume_unwind(Box::new("injected"));
        }
        self.inner.readings_until(until, take);
    }
}

#[test]
fn a_panic_is_answered_by_an_invalid_message_and_survived() {
    let mut log = Log::default();
    let setup = setup(Triangle::new(0..0), |inner| {
        Box::new(PanickingWheels { inner, asked: 0 })
    });
    let summary = drive(setup, &mut log);
    assert_eq!(summary.restarts, 1);
    let invalid: Vec<_> = log
        .publications
        .iter()
        .filter(|publication| publication.faults.contains(Faults::STAGE_PANICKED))
        .collect();
    assert_eq!(invalid.len(), 1);
    assert_eq!(invalid[0].level, QualityLevel::Invalid);
    assert!(log.events.iter().any(|event| matches!(event, Event::Panicked(_))));
    // The message of the panic comes besides those of the key frames.
    assert_eq!(summary.key_frames, KEY_FRAMES + 1);
}

#[test]
fn a_network_that_fails_lowers_the_level_and_no_more() {
    let mut log = Log::default();
    let summary = drive(setup(Triangle::new(1..100), |wheels| wheels), &mut log);
    assert_eq!(summary.key_frames, KEY_FRAMES);
    let failed = log
        .publications
        .iter()
        .filter(|publication| publication.faults.contains(Faults::NETWORK_FAILED));
    assert!(failed.count() >= 1);
    assert!(log.publications.iter().all(|publication| {
        publication.level != QualityLevel::Full || !publication.faults.contains(Faults::NETWORK_FAILED)
    }));
}

struct Refusing;

impl SinkPort for Refusing {
    fn publish(&mut self, _message: &[u8], _frames: &[CanFrame]) -> Result<(), SinkMiss> {
        Err(SinkMiss::Refused)
    }
}

#[test]
fn a_sink_that_refuses_is_said_in_the_next_message() {
    let mut log = Log::default();
    let mut setup = setup(Triangle::new(0..0), |wheels| wheels);
    setup.devices.sinks.push(Box::new(Refusing));
    drive(setup, &mut log);
    let said: Vec<bool> = log
        .publications
        .iter()
        .map(|publication| publication.faults.contains(Faults::CAN_SEND_FAILED))
        .collect();
    assert!(!said[0] && said[1..].iter().all(|said| *said), "{said:?}");
}

/// Keeps the level and the faults of the last message.
#[derive(Clone, Default)]
pub(crate) struct LastMessage(pub(crate) Arc<std::sync::Mutex<Option<(QualityLevel, Faults)>>>);

impl SinkPort for LastMessage {
    fn publish(&mut self, message: &[u8], _frames: &[CanFrame]) -> Result<(), SinkMiss> {
        let header = freespace::emit::FreeSpaceMessage::decode(message).unwrap().header;
        *self.0.lock().unwrap() = Some((header.level, header.faults));
        Ok(())
    }
}

#[test]
fn a_stop_ends_the_drive_with_a_last_invalid_message() {
    let mut log = Log {
        stop_after: Some((2, Arc::default())),
        ..Log::default()
    };
    let last = LastMessage::default();
    let mut setup = setup(Triangle::new(0..0), |wheels| wheels);
    setup.devices.sinks.push(Box::new(last.clone()));
    let summary = drive(setup, &mut log);
    assert!((2..KEY_FRAMES).contains(&summary.key_frames), "{summary:?}");
    let (level, faults) = last.0.lock().unwrap().unwrap();
    assert_eq!(level, QualityLevel::Invalid);
    assert!(faults.contains(Faults::SHUTTING_DOWN));
}
