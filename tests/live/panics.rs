//! Devices that panic: the drive goes on as long as it may, and ends in order once it may not.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use freespace::emit::CanFrame;
use freespace::health::Faults;
use freespace::pipeline::Cadence;
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer, SinkMiss, SinkPort};
use freespace::space::Micros;
use freespace_platform::runtime::RunError;

use super::simulated::{self, Triangle};
use super::{KEY_FRAMES, LastMessage, Log, PanickingWheels, drive, run, setup};

fn panic() -> ! {
    std::panic::resume_unwind(Box::new("injected"))
}

/// Panics so many times from its second message on.
struct PanickingSink {
    asked: AtomicU32,
    times: u32,
}

impl PanickingSink {
    fn boxed(times: u32) -> Box<Self> {
        Box::new(Self {
            asked: AtomicU32::new(0),
            times,
        })
    }
}

impl SinkPort for PanickingSink {
    fn publish(&mut self, _message: &[u8], _frames: &[CanFrame]) -> Result<(), SinkMiss> {
        let asked = self.asked.fetch_add(1, Ordering::Relaxed);
        if (1..=self.times).contains(&asked) {
            panic();
        }
        Ok(())
    }
}

#[test]
fn a_sink_that_panics_once_is_said_and_survived() {
    let mut log = Log::default();
    let mut setup = setup(Triangle::new(0..0), |wheels| wheels);
    setup.devices.sinks.push(PanickingSink::boxed(1));
    let summary = drive(setup, &mut log);
    assert_eq!((summary.restarts, summary.key_frames), (1, KEY_FRAMES));
    let said: Vec<bool> = log
        .publications
        .iter()
        .map(|publication| (publication.faults).contains(Faults::STAGE_PANICKED | Faults::CAN_SEND_FAILED))
        .collect();
    assert_eq!(said.iter().filter(|said| **said).count(), 1, "{said:?}");
    assert!(said[2], "{said:?}");
}

#[test]
fn a_sink_that_always_panics_ends_the_drive_in_order() {
    let mut setup = setup(Triangle::new(0..0), |wheels| wheels);
    let last = LastMessage::default();
    setup.devices.sinks.push(PanickingSink::boxed(u32::MAX - 1));
    setup.devices.sinks.push(Box::new(last.clone()));
    let error = run(setup, &Arc::default(), &mut Log::default()).unwrap_err();
    assert!(matches!(error, RunError::PanickedTooOften), "{error}");
    let (_, faults) = last.0.lock().unwrap().unwrap();
    assert!(faults.contains(Faults::SHUTTING_DOWN));
}

/// Panics when it is to skip frames.
struct PanickingSkip(Box<dyn CameraPort + Send>);

impl CameraPort for PanickingSkip {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        self.0.next_frame(buffer)
    }

    fn skip_before(&mut self, _now: Micros) -> u64 {
        panic()
    }
}

#[test]
fn a_camera_that_always_panics_ends_the_drive_in_order() {
    let (camera, frames, wheels) = simulated::devices(super::SECONDS);
    let frames = Box::new(PanickingSkip(frames));
    let mut setup = simulated::setup(camera, frames, Some(wheels), Triangle::new(0..0));
    setup.real_time.lock_memory = false;
    let last = LastMessage::default();
    setup.devices.sinks.push(Box::new(last.clone()));
    let error = run(setup, &Arc::default(), &mut Log::default()).unwrap_err();
    assert!(matches!(error, RunError::PanickedTooOften), "{error}");
    let (_, faults) = last.0.lock().unwrap().unwrap();
    assert!(faults.contains(Faults::SHUTTING_DOWN));
}

/// Wants the tenth frame to become a key frame.
struct Wishing(Box<dyn CameraPort + Send>, u32);

impl CameraPort for Wishing {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let answer = self.0.next_frame(buffer);
        self.1 += 1;
        buffer.key_frame_wanted = self.1 == 10;
        answer
    }
}

#[test]
fn a_wish_for_a_key_frame_outlives_the_frame_that_carried_it() {
    let (camera, frames, inner) = simulated::devices(super::SECONDS);
    let wheels = Box::new(PanickingWheels { inner, asked: 0 });
    let mut setup = simulated::setup(
        camera,
        Box::new(Wishing(frames, 0)),
        Some(wheels),
        Triangle::new(0..0),
    );
    setup.real_time.lock_memory = false;
    setup.config.cadence = Cadence::OnDemand;
    let mut log = Log::default();
    let summary = drive(setup, &mut log);
    // The message of the panic, and the key frame.
    assert_eq!((summary.restarts, summary.key_frames), (1, 2));
}
