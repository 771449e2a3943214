//! A camera of the kernel through the faults that vehicles have: needs a kernel with `vivid` or `v4l2loopback`, and `v4l2-ctl`.
//!
//! `FREESPACE_TEST_VIVID` names a device of vivid, `FREESPACE_TEST_LOOPBACK` one of v4l2loopback that nothing writes to. Without
//! them the tests are skipped by name.
#![cfg(feature = "v4l2")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

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
    let mut section = section(&path);
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

/// A program that writes a test picture to a loopback; ended when dropped.
struct Writer(Child);

impl Writer {
    fn of(device: &Path, width: usize, height: usize) -> Self {
        let format = format!("width={width},height={height},pixelformat=YUYV");
        let child = Command::new("v4l2-ctl")
            .arg("-d")
            .arg(device)
            .args(["-x", &format, "--stream-out-mmap", "--stream-out-pattern=0"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        std::thread::sleep(std::time::Duration::from_millis(300));
        Self(child.unwrap())
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn loopback_whose_writer_stops_and_comes_back_otherwise() {
    let Some(path) = device("FREESPACE_TEST_LOOPBACK") else {
        return;
    };
    let section = section(&path);
    let writer = Writer::of(&path, SIZE.width, SIZE.height);
    let mut watched = Watched::open(&section);
    watched.frames(10);
    drop(writer);
    watched.until(CameraAnswer::Silent);
    for _ in 0..30 {
        watched.next();
    }
    let other = Writer::of(&path, 320, 240);
    for _ in 0..40 {
        let answer = watched.next();
        assert_ne!(answer, CameraAnswer::Frame, "a frame of another size is no frame");
    }
    drop(other);
    let _writer = Writer::of(&path, SIZE.width, SIZE.height);
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
    let mut wrong = section(&path);
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
    let error = V4l2Camera::open(&section(&path), size, 30.0)
        .map(drop)
        .unwrap_err();
    eprintln!("  {error}\n  fix: {}", error.fix());
    assert!(matches!(error, OpenError::NoFormat { .. }));
}
