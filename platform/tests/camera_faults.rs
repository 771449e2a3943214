//! A camera of the kernel through the faults that vehicles have: needs a kernel with `vivid` or `v4l2loopback`, and `v4l2-ctl`.
//!
//! `FREESPACE_TEST_VIVID` names a device of vivid, `FREESPACE_TEST_LOOPBACK` one of v4l2loopback that nothing writes to. Without
//! them the tests are skipped by name.
#![cfg(feature = "v4l2")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use freespace::port::{CameraAnswer, CameraPort as _, Clock as _, FrameBuffer};
use freespace_platform::camera::v4l2::{CameraEvent, Loss, OpenError, Refusal, V4l2Camera};
use freespace_platform::clock::MonotonicClock;
use freespace_platform::config::{ControlValue, DeviceFormat, DeviceSection, ImageSize};

/// Calls of which one must answer as a test waits for: 20 s of a silent camera.
const CALLS: usize = 200;

fn device(variable: &str) -> Option<PathBuf> {
    let device = std::env::var_os(variable).map(PathBuf::from);
    if device.is_none() {
        eprintln!("SKIPPED: {variable} names no device");
    }
    device
}

fn section(path: &Path) -> DeviceSection {
    DeviceSection {
        path: path.to_owned(),
        formats: vec![DeviceFormat::Yuyv],
        buffers: 4,
        controls: BTreeMap::new(),
        stamp_offset_s: 0.0,
    }
}

/// It stamps the end of a frame before it is there; the start of the exposure it stamps soundly.
fn vivid(path: &Path) -> DeviceSection {
    let mut section = section(path);
    (section.controls).insert("timestamp_source".to_owned(), ControlValue::Integer(1));
    section
}

const SIZE: ImageSize = ImageSize {
    width: 640,
    height: 480,
};

struct Watched {
    camera: V4l2Camera,
    buffer: FrameBuffer,
    last: Option<(u64, u64)>,
}

impl Watched {
    fn open(section: &DeviceSection) -> Self {
        Self {
            camera: V4l2Camera::open(section, SIZE, 30.0).unwrap(),
            buffer: FrameBuffer::default(),
            last: None,
        }
    }

    fn next(&mut self) -> CameraAnswer {
        let answer = self.camera.next_frame(&mut self.buffer);
        if answer == CameraAnswer::Frame {
            let now = MonotonicClock::of_devices().now();
            let (index, stamp) = (self.buffer.index, self.buffer.stamp.0);
            assert!(stamp <= now.0, "no stamp lies in the future");
            if let Some((last_index, last_stamp)) = self.last {
                assert!(index > last_index && stamp > last_stamp, "both rise");
            }
            self.last = Some((index, stamp));
        }
        answer
    }

    /// Fetches until that answer comes.
    fn until(&mut self, wanted: CameraAnswer) {
        let found = (0..CALLS).any(|_| self.next() == wanted);
        assert!(
            found,
            "{wanted:?} did not come: {:?}",
            self.camera.status().counts()
        );
    }

    fn frames(&mut self, count: usize) {
        for _ in 0..count {
            self.until(CameraAnswer::Frame);
        }
    }

    fn events(&mut self) -> Vec<CameraEvent> {
        let mut events = self.camera.take_events().unwrap();
        let told: Vec<CameraEvent> = std::iter::from_fn(|| events.next_event()).collect();
        for event in &told {
            eprintln!("  {}: {event}", events.device().display());
        }
        told
    }
}

fn set(device: &Path, control: &str) {
    let done = Command::new("v4l2-ctl")
        .arg("-d")
        .arg(device)
        .args(["-c", control])
        .status();
    assert!(done.unwrap().success(), "{control}");
}

#[test]
fn vivid_through_its_faults() {
    let Some(path) = device("FREESPACE_TEST_VIVID") else {
        return;
    };
    let mut section = vivid(&path);
    section
        .controls
        .insert("brightness".to_owned(), ControlValue::Integer(100));
    let mut watched = Watched::open(&section);
    watched.frames(10);

    set(&path, "inject_v4l2_buf_flag_error=1");
    watched.until(CameraAnswer::Lost);
    watched.frames(5);

    set(&path, "percentage_of_dropped_buffers=50");
    watched.frames(30);
    set(&path, "percentage_of_dropped_buffers=0");

    set(&path, "disconnect=1");
    watched.until(CameraAnswer::Silent);
    watched.frames(10);

    // Each of these ends the stream, or keeps the next one from beginning, in another way.
    for fault in ["inject_fatal_streaming_error=1", "inject_vidioc_qbuf_error=1"] {
        set(&path, fault);
        watched.until(CameraAnswer::Silent);
        watched.frames(10);
    }
    for fault in ["inject_vidioc_reqbufs_error=1", "inject_vidioc_streamon_error=1"] {
        set(&path, fault);
        set(&path, "disconnect=1");
        watched.until(CameraAnswer::Silent);
        watched.frames(10);
    }

    let counts = watched.camera.status().counts();
    eprintln!("  {counts:?}");
    assert!(counts.damaged >= 1 && counts.connections >= 3 && counts.disconnections >= 2);
    assert!(counts.missing >= 1, "dropped buffers show in the driver's count");
    let told = watched.events();
    assert!(told.contains(&CameraEvent::Lost(Loss::Damaged)));
    assert_eq!(counts.bad_stamps, 0);
}

/// Writes grey pictures to a loopback, 30 a second, until it is dropped.
struct Writer {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Writer {
    /// None while a reader holds the loopback to another size.
    fn begin(device: &Path, width: usize, height: usize) -> Option<Self> {
        let format = format!("width={width},height={height},pixelformat=YUYV");
        for keep in ["keep_format=0", "keep_format=1"] {
            let set = Command::new("v4l2-ctl")
                .arg("-d")
                .arg(device)
                .args(["-x", &format, "-c", keep])
                .output();
            if !set.unwrap().status.success() {
                return None;
            }
        }
        let set = Command::new("v4l2-ctl")
            .arg("-d")
            .arg(device)
            .arg("--get-fmt-video-out")
            .output()
            .unwrap();
        if !String::from_utf8_lossy(&set.stdout).contains(&format!("{width}/{height}")) {
            return None;
        }
        let mut file = std::fs::OpenOptions::new().write(true).open(device).ok()?;
        let stop = Arc::new(AtomicBool::new(false));
        let is_to_stop = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let picture = vec![128; 2 * width * height];
            while !is_to_stop.load(Ordering::Relaxed) && file.write_all(&picture).is_ok() {
                std::thread::sleep(Duration::from_millis(33));
            }
        });
        Some(Self {
            stop,
            thread: Some(thread),
        })
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

impl Watched {
    /// A writer of that size, as soon as the reader lets the loopback go; no frame may come meanwhile.
    fn silent_until_writer(&mut self, device: &Path, width: usize, height: usize) -> Writer {
        for _ in 0..CALLS {
            if let Some(writer) = Writer::begin(device, width, height) {
                return writer;
            }
            assert_ne!(self.next(), CameraAnswer::Frame, "nobody writes");
        }
        panic!("the reader held the loopback all the time");
    }
}

#[test]
fn loopback_whose_writer_stops_and_comes_back_otherwise() {
    let Some(path) = device("FREESPACE_TEST_LOOPBACK") else {
        return;
    };
    let section = section(&path);
    let writer = Writer::begin(&path, SIZE.width, SIZE.height).unwrap();
    let mut watched = Watched::open(&section);
    watched.frames(10);
    drop(writer);
    watched.until(CameraAnswer::Silent);
    let other = watched.silent_until_writer(&path, 320, 240);
    for _ in 0..40 {
        let answer = watched.next();
        assert_ne!(answer, CameraAnswer::Frame, "a frame of another size is no frame");
    }
    drop(other);
    let _writer = watched.silent_until_writer(&path, SIZE.width, SIZE.height);
    watched.frames(10);
    eprintln!("  {:?}", watched.camera.status().counts());
    let told = watched.events();
    assert!(
        told.contains(&CameraEvent::Refused(Refusal::NoFormat)),
        "{told:?}"
    );
}

#[test]
fn vivid_is_refused_where_it_cannot_do_what_is_asked() {
    let Some(path) = device("FREESPACE_TEST_VIVID") else {
        return;
    };
    let mut wrong = vivid(&path);
    wrong
        .controls
        .insert("brightnes".to_owned(), ControlValue::Integer(100));
    let error = V4l2Camera::open(&wrong, SIZE, 30.0).map(drop).unwrap_err();
    eprintln!("  {error}\n  fix: {}", error.fix());
    assert!(error.fix().contains("did you mean `brightness`"));
    let size = ImageSize {
        width: 642,
        height: 480,
    };
    let error = V4l2Camera::open(&vivid(&path), size, 30.0).map(drop).unwrap_err();
    eprintln!("  {error}\n  fix: {}", error.fix());
    assert!(matches!(error, OpenError::NoFormat { .. }));
}

#[test]
fn a_driver_that_stamps_ahead_of_time_is_noticed_and_set_right_by_the_offset() {
    let Some(path) = device("FREESPACE_TEST_VIVID") else {
        return;
    };
    let mut ahead = section(&path);
    (ahead.controls).insert("timestamp_source".to_owned(), ControlValue::Integer(0));
    let mut watched = Watched::open(&ahead);
    for _ in 0..10 {
        assert_ne!(
            watched.next(),
            CameraAnswer::Frame,
            "a stamp of the future is never passed on"
        );
    }
    assert!(watched.events().contains(&CameraEvent::Lost(Loss::StampAhead)));
    drop(watched);
    ahead.stamp_offset_s = -0.040;
    Watched::open(&ahead).frames(10);
}
