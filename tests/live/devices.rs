//! Drives on the clock of devices: a camera that stamps its frames as it captures them, and is silent now and then.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use freespace::emit::CanFrame;
use freespace::health::{Faults, QualityLevel};
use freespace::port::{CameraAnswer, CameraPort, Clock as _, FrameBuffer, SinkMiss, SinkPort, WheelPort};
use freespace::space::Micros;
use freespace::track::WheelReading;
use freespace_platform::clock::MonotonicClock;
use freespace_platform::runtime::{FrameReport, KeyFrameReport, Observer, RunError, RunSummary, Setup};
use freespace_platform::statistics::Publication;

use super::simulated::{self, Triangle};
use super::{LastMessage, Log, run};

/// How long a camera waits for a frame before it says that none came.
const PATIENCE_MICROS: u64 = 100_000;

/// A simulated camera whose frames are captured when their time has come, on the clock of devices.
struct Captured {
    frames: Box<dyn CameraPort + Send>,
    clock: MonotonicClock,
    /// When the drive began: at the camera's first breath.
    start: Arc<OnceLock<Micros>>,
    /// Into the drive, from and until when it gives nothing.
    silence: std::ops::Range<u64>,
    /// The next frame, stamped as the drive has it.
    next: Option<FrameBuffer>,
}

impl Captured {
    /// The newest frame captured so far, or the one to come.
    fn fetch(&mut self, start: Micros) -> Option<FrameBuffer> {
        let elapsed = Micros(self.clock.now().since(start));
        if let Some(next) = self.next.take_if(|next| next.stamp >= elapsed) {
            return Some(next);
        }
        self.frames.skip_before(elapsed);
        let mut buffer = FrameBuffer::default();
        (self.frames.next_frame(&mut buffer) != CameraAnswer::End).then_some(buffer)
    }
}

impl CameraPort for Captured {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let start = *self.start.get_or_init(|| self.clock.now());
        let Some(mut next) = self.fetch(start) else {
            return CameraAnswer::End;
        };
        let begin = self.clock.now();
        if self.silence.contains(&next.stamp.0) || start.plus(next.stamp.0) > begin.plus(PATIENCE_MICROS) {
            self.clock.sleep_until(begin.plus(PATIENCE_MICROS));
            self.next = (!self.silence.contains(&next.stamp.0)).then_some(next);
            return CameraAnswer::Silent;
        }
        next.stamp = start.plus(next.stamp.0);
        self.clock.sleep_until(next.stamp);
        buffer.clone_from(&next);
        CameraAnswer::Frame
    }
}

/// Wheels of the drive, their stamps moved to the clock of devices.
struct Moved {
    inner: Box<dyn WheelPort + Send>,
    start: Arc<OnceLock<Micros>>,
}

impl WheelPort for Moved {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        let Some(start) = self.start.get().map(|start| start.0) else {
            return;
        };
        let until = Micros(until.0.saturating_sub(start));
        self.inner.readings_until(until, &mut |mut reading| {
            let (WheelReading::Counts { stamp, .. } | WheelReading::Speeds { stamp, .. }) = &mut reading;
            *stamp = stamp.plus(start);
            take(reading);
        });
    }
}

/// A drive of `seconds` on the clock of devices, whose camera is silent for a part of it.
pub(crate) fn on_devices(
    seconds: f64,
    silence: std::ops::Range<u64>,
    wheels: impl FnOnce(Box<dyn WheelPort + Send>) -> Box<dyn WheelPort + Send>,
) -> Setup {
    let (camera, frames, encoders) = simulated::devices(seconds);
    let clock = MonotonicClock::of_devices();
    let start = Arc::<OnceLock<Micros>>::default();
    let moved = Box::new(Moved {
        inner: encoders,
        start: Arc::clone(&start),
    });
    let frames = Box::new(Captured {
        frames,
        clock: clock.clone(),
        start,
        silence,
        next: None,
    });
    let mut setup = simulated::setup(camera, frames, Some(wheels(moved)), Triangle::new(0..0));
    setup.real_time.lock_memory = false;
    setup.clock = clock;
    setup
}

fn drive(setup: Setup, log: &mut Log) -> RunSummary {
    run(setup, &Arc::default(), log).unwrap()
}

/// Counts the messages that left.
#[derive(Clone, Default)]
struct Count(Arc<AtomicUsize>);

impl SinkPort for Count {
    fn publish(&mut self, _message: &[u8], _frames: &[CanFrame]) -> Result<(), SinkMiss> {
        self.0.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }
}

/// Stalls for five seconds with the second publication; how many messages left meanwhile.
#[derive(Default)]
struct Stalled {
    count: Count,
    seen: usize,
    left_meanwhile: usize,
}

impl Observer for Stalled {
    fn frame(&mut self, _report: &FrameReport) {}

    fn key_frame(&mut self, _report: &KeyFrameReport<'_>) {
        self.seen += 1;
        if self.seen == 2 {
            let before = self.count.0.load(Ordering::Relaxed);
            std::thread::sleep(Duration::from_secs(5));
            self.left_meanwhile = self.count.0.load(Ordering::Relaxed) - before;
        }
    }
}

#[test]
fn an_observer_that_stalls_holds_no_answer_back_while_the_camera_is_silent() {
    let mut observer = Stalled::default();
    let mut setup = on_devices(7.0, 300_000..7_000_000, |wheels| wheels);
    setup.devices.sinks.push(Box::new(observer.count.clone()));
    run(setup, &Arc::default(), &mut observer).unwrap();
    assert!(observer.left_meanwhile >= 8, "{} of 10", observer.left_meanwhile);
}

#[test]
fn a_camera_that_is_silent_in_mid_drive_is_answered_for_and_comes_back() {
    let mut log = Log::default();
    let summary = drive(on_devices(6.0, 2_000_000..4_000_000, |wheels| wheels), &mut log);
    assert!((11..=13).contains(&summary.key_frames), "{summary:?}");
    let silent: Vec<bool> = log
        .publications
        .iter()
        .map(|publication| publication.faults.contains(Faults::CAMERA_SILENT))
        .collect();
    let count = silent.iter().filter(|silent| **silent).count();
    assert!((2..=5).contains(&count), "{silent:?}");
    assert!(!silent[0] && !silent[silent.len() - 1], "{silent:?}");
    let fresh = log.publications.iter().filter(is_fresh).count();
    assert!(fresh >= 1, "{:?}", log.publications);
}

#[test]
fn a_camera_that_never_gives_a_frame_is_answered_for_from_the_start() {
    let mut log = Log::default();
    let summary = drive(on_devices(2.0, 0..2_000_000, |wheels| wheels), &mut log);
    assert!((3..=5).contains(&summary.key_frames), "{summary:?}");
    assert!(log.publications.iter().all(|publication| {
        publication.level == QualityLevel::Invalid && publication.faults.contains(Faults::CAMERA_SILENT)
    }));
}

fn is_fresh(publication: &&Publication) -> bool {
    publication.level < QualityLevel::Moved
}

fn hang() -> ! {
    loop {
        std::thread::sleep(Duration::from_secs(1));
    }
}

/// Never comes back, once it is asked for the tenth time.
struct HangingWheels {
    asked: u32,
}

impl WheelPort for HangingWheels {
    fn readings_until(&mut self, _until: Micros, _take: &mut dyn FnMut(WheelReading)) {
        self.asked += 1;
        if self.asked == 10 {
            hang();
        }
    }
}

#[test]
fn a_hang_is_answered_until_it_is_noticed_and_the_last_word_leaves() {
    let mut log = Log::default();
    let last = LastMessage::default();
    let mut setup = on_devices(60.0, 0..0, |_| Box::new(HangingWheels { asked: 0 }));
    setup.devices.sinks.push(Box::new(last.clone()));
    let error = run(setup, &Arc::default(), &mut log).unwrap_err();
    assert!(matches!(error, RunError::Hung(_)), "{error}");
    let (_, faults) = last.0.lock().unwrap().unwrap();
    assert!(faults.contains(Faults::SHUTTING_DOWN));
    // Noticed after 5 s: an answer each half second, and none for instants to come.
    let count = log.publications.len();
    assert!((8..=40).contains(&count), "{count}");
}

/// Waits for ever, once it has given its first frames.
struct HangingCamera(Box<dyn CameraPort + Send>, u32);

impl CameraPort for HangingCamera {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        self.1 += 1;
        if self.1 == 10 {
            hang();
        }
        self.0.next_frame(buffer)
    }
}

#[test]
fn a_camera_that_does_not_come_back_ends_the_drive() {
    let mut setup = on_devices(60.0, 0..0, |wheels| wheels);
    let (_, frames, _) = simulated::devices(60.0);
    setup.devices.camera = Box::new(HangingCamera(frames, 0));
    let error = run(setup, &Arc::default(), &mut Log::default()).unwrap_err();
    assert!(matches!(error, RunError::Hung("camera")), "{error}");
}

#[test]
fn a_network_that_does_not_come_back_ends_the_drive() {
    let mut setup = on_devices(60.0, 0..0, |wheels| wheels);
    setup.devices.segmenter = Box::new(Triangle::hanging_in(2));
    let error = run(setup, &Arc::default(), &mut Log::default()).unwrap_err();
    assert!(matches!(error, RunError::Hung("segmentation")), "{error}");
}

#[test]
fn a_stop_ends_a_drive_that_sleeps_across_a_gap_of_the_recording() {
    /// The second frame lies an hour after the first.
    struct Gap(Box<dyn CameraPort + Send>);
    impl CameraPort for Gap {
        fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
            let answer = self.0.next_frame(buffer);
            if buffer.index > 0 {
                buffer.stamp = buffer.stamp.plus(3_600_000_000);
            }
            answer
        }
    }
    let (camera, frames, wheels) = simulated::devices(3.0);
    let mut setup = simulated::setup(camera, Box::new(Gap(frames)), Some(wheels), Triangle::new(0..0));
    setup.real_time.lock_memory = false;
    let stop = Arc::<AtomicBool>::default();
    let theirs = Arc::clone(&stop);
    std::thread::spawn(move || {
        std::thread::sleep(Duration::from_secs(1));
        theirs.store(true, Ordering::Relaxed);
    });
    let last = LastMessage::default();
    setup.devices.sinks.push(Box::new(last.clone()));
    run(setup, &stop, &mut Log::default()).unwrap();
    let (_, faults) = last.0.lock().unwrap().unwrap();
    assert!(faults.contains(Faults::SHUTTING_DOWN));
}
