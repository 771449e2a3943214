//! Recordings that are cut off, split, or meet a disk that is slow or full.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::space::Micros;
use freespace_platform::camera::replay::drive::{DriveFrames, RecordedDrive};
use freespace_platform::runtime::{Event, FrameReport, KeyFrameReport, Observer, Trace};
use freespace_platform::sink::mcap::{DriveRecorder, Medium, Split, later_part_of, part_path};

use crate::rig::{self, Patient};
use crate::simulated::{self, Triangle};

type Frames = Vec<(u64, u64, Vec<u8>)>;

/// Records `seconds` at 10 Hz without a pipeline; the frames.
fn record(path: &Path, split: Split, seconds: f64) -> Frames {
    let (camera, frames, _) = simulated::devices(seconds);
    let setup = simulated::setup(camera, frames, None, Triangle::new(0..0));
    let mut recorder = DriveRecorder::open(rig::plan(path, &setup, split)).unwrap();
    let mut camera = rig::recorded(setup, &mut recorder).devices.camera;
    rig::frames(&mut *camera)
}

fn read(drive: &RecordedDrive) -> Frames {
    rig::frames(&mut DriveFrames::all(drive))
}

#[test]
fn a_file_cut_off_anywhere_is_read_up_to_its_last_whole_chunk() {
    let path = rig::path("cut");
    let frames = record(&path, Split::default(), 5.0);
    let bytes = std::fs::read(&path).unwrap();
    let mut seen = Vec::new();
    for percent in [99, 80, 60, 40, 2] {
        std::fs::write(&path, &bytes[..bytes.len() * percent / 100]).unwrap();
        match RecordedDrive::open(&path) {
            Ok(drive) => {
                assert_eq!(drive.cut.len(), 1);
                let read = read(&drive);
                assert!(
                    read == frames[..read.len()],
                    "{percent} %: another frame than was recorded"
                );
                seen.push(read.len());
            }
            Err(fault) => {
                assert!(
                    fault.message().contains("holds no whole frame"),
                    "{}",
                    fault.message()
                );
                seen.push(0);
            }
        }
    }
    assert!(seen.is_sorted_by(|more, less| more >= less), "{seen:?}");
    assert!(seen[0] > 30 && seen[4] == 0, "{seen:?}");
}

#[test]
fn damage_within_a_chunk_is_noticed_and_ends_the_part() {
    let path = rig::path("damaged");
    let frames = record(&path, Split::default(), 5.0);
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    std::fs::write(&path, bytes).unwrap();
    let drive = RecordedDrive::open(&path).unwrap();
    assert_eq!(drive.cut.len(), 1);
    let read = read(&drive);
    assert!(read.len() < frames.len() && read == frames[..read.len()]);
}

#[test]
fn what_is_no_recording_is_refused_with_its_name() {
    let path = rig::path("stranger");
    std::fs::write(&path, b"no recording at all").unwrap();
    let fault = RecordedDrive::open(&path).unwrap_err();
    assert!(
        fault.message().contains("drive.mcap: is no recorded drive"),
        "{}",
        fault.message()
    );
}

#[test]
fn a_recording_is_split_and_read_as_one() {
    let path = rig::path("split");
    let split = Split {
        bytes: Some(3_000_000),
        after: None,
    };
    let frames = record(&path, split, 5.0);
    assert!(part_path(&path, 1).is_file());
    assert!(read(&RecordedDrive::open(&path).unwrap()) == frames);
    // A part replays by itself.
    let second = read(&RecordedDrive::open(&part_path(&path, 1)).unwrap());
    assert!(frames.windows(second.len()).any(|some| some == second));
}

#[test]
fn a_later_part_knows_its_first_one() {
    let first = Path::new("drives/night.mcap");
    for part in [1, 7, 1234] {
        assert_eq!(
            later_part_of(&part_path(first, part)),
            Some((part, first.to_owned()))
        );
    }
    for other in [
        "night.mcap",
        "night.01.mcap",
        "night.000.mcap",
        "night.old.mcap",
        "night.001",
    ] {
        assert_eq!(later_part_of(Path::new(other)), None);
    }
}

#[test]
fn a_part_that_is_missing_is_told_by_name() {
    let path = rig::path("gap");
    let split = Split {
        bytes: Some(2_000_000),
        after: None,
    };
    let frames = record(&path, split, 5.0);
    assert!(part_path(&path, 2).is_file());
    std::fs::remove_file(part_path(&path, 1)).unwrap();
    let fault = RecordedDrive::open(&path).unwrap_err();
    assert!(
        fault.message().contains("drive.001.mcap: is missing"),
        "{}",
        fault.message()
    );
    // The parts before it are a drive of their own once the later ones lie elsewhere.
    for part in 2.. {
        if std::fs::remove_file(part_path(&path, part)).is_err() {
            break;
        }
    }
    let rest = read(&RecordedDrive::open(&path).unwrap());
    assert!(!rest.is_empty() && rest == frames[..rest.len()]);
}

#[test]
fn an_earlier_recording_is_not_written_over() {
    let path = rig::path("earlier");
    record(&path, Split::default(), 0.3);
    let (camera, frames, _) = simulated::devices(0.3);
    let setup = simulated::setup(camera, frames, None, Triangle::new(0..0));
    let refused = DriveRecorder::open(rig::plan(&path, &setup, Split::default()));
    assert!(refused.err().unwrap().message().contains("earlier recording"));
}

#[test]
fn any_part_of_an_earlier_recording_keeps_a_new_one_from_its_name() {
    let path = rig::path("earlier_part");
    let (camera, frames, _) = simulated::devices(0.3);
    let setup = simulated::setup(camera, frames, None, Triangle::new(0..0));
    for part in [2, 7, 1234] {
        let earlier = part_path(&path, part);
        std::fs::write(&earlier, b"").unwrap();
        let refused = DriveRecorder::open(rig::plan(&path, &setup, Split::default()));
        let fault = refused.err().unwrap();
        let name = earlier.file_name().unwrap().to_str().unwrap();
        assert!(fault.message().contains(name), "{}", fault.message());
        std::fs::remove_file(earlier).unwrap();
    }
    // Neighbours of other names are no parts of it.
    for name in ["drives.001.mcap", "drive.old.mcap", "drive.01.mcap"] {
        std::fs::write(path.with_file_name(name), b"").unwrap();
    }
    DriveRecorder::open(rig::plan(&path, &setup, Split::default())).unwrap();
}

#[test]
fn a_part_of_another_drive_is_refused_by_name() {
    let (path, other) = (rig::path("mixed"), rig::path("mixed_other"));
    record(&path, Split::default(), 0.5);
    record(&other, Split::default(), 0.5);
    std::fs::copy(&other, part_path(&path, 1)).unwrap();
    let fault = RecordedDrive::open(&path).unwrap_err();
    assert!(
        fault
            .message()
            .contains("drive.001.mcap: is a part of another drive"),
        "{}",
        fault.message()
    );
}

/// A file that refuses to grow, or keeps its writer waiting.
struct Disk {
    file: File,
    room: Arc<AtomicU64>,
    is_stuck: Arc<AtomicBool>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        while self.is_stuck.load(Ordering::Acquire) {
            std::thread::sleep(Duration::from_millis(1));
        }
        let room = self.room.load(Ordering::Relaxed);
        if room == 0 {
            return Err(io::Error::from(io::ErrorKind::StorageFull));
        }
        let length = usize::try_from(room).unwrap_or(usize::MAX).min(bytes.len());
        let count = self.file.write(&bytes[..length])?;
        self.room.fetch_sub(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Disk {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.file.seek(position)
    }
}

fn record_on(
    path: &Path,
    room: u64,
    is_stuck: &Arc<AtomicBool>,
    seconds: f64,
) -> (DriveRecorder, Box<dyn CameraPort + Send>) {
    let (camera, frames, _) = simulated::devices(seconds);
    let setup = simulated::setup(camera, frames, None, Triangle::new(0..0));
    let room = Arc::new(AtomicU64::new(room));
    let stuck = Arc::clone(is_stuck);
    let open = Box::new(move |path: &Path| -> io::Result<Box<dyn Medium>> {
        Ok(Box::new(Disk {
            file: File::create(path)?,
            room: Arc::clone(&room),
            is_stuck: Arc::clone(&stuck),
        }))
    });
    let mut recorder = DriveRecorder::open_with(rig::plan(path, &setup, Split::default()), open).unwrap();
    let camera = recorder.tap_camera(setup.devices.camera);
    (recorder, camera)
}

#[test]
fn a_full_disk_is_told_and_the_drive_goes_on() {
    let path = rig::path("full");
    record(&path, Split::default(), 8.0);
    let size = std::fs::metadata(&path).unwrap().len();
    let (mut recorder, camera) = record_on(&path, size * 6 / 10, &Arc::default(), 8.0);
    let lines = recorder.take_lines().unwrap();
    let meter = recorder.meter();
    let mut camera = Patient {
        inner: camera,
        meter: meter.clone(),
        given: 0,
    };
    let mut buffer = FrameBuffer::default();
    let mut given = Vec::new();
    // What the disk lost is not waited for.
    while meter.counts().lost_messages == 0 {
        assert_eq!(camera.next_frame(&mut buffer), CameraAnswer::Frame);
        given.push((buffer.index, buffer.stamp.0, buffer.bytes.clone()));
        while meter.counts().frames + meter.counts().lost_messages < given.len() as u64 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    let mut camera = camera.inner;
    let rest = rig::frames(&mut *camera);
    assert_eq!(given.len() + rest.len(), 80);
    let counts = recorder.finish();
    assert!(counts.lost_messages > 0, "{counts:?}");
    let told: Vec<String> = lines.try_iter().collect();
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("the drive goes on"), "{told:?}");
    let drive = RecordedDrive::open(&path).unwrap();
    let read = read(&drive);
    assert!(!read.is_empty() && read == given[..read.len()]);
    // What the chunk held that did not leave is lost, too.
    assert_eq!(counts.frames, read.len() as u64);
    assert_eq!(counts.frames + counts.lost_messages, 80);
}

#[test]
fn a_disk_that_takes_its_time_loses_the_newest_frames_counted() {
    let path = rig::path("slow");
    let is_stuck = Arc::new(AtomicBool::new(false));
    let (recorder, mut camera) = record_on(&path, u64::MAX, &is_stuck, 8.0);
    is_stuck.store(true, Ordering::Release);
    let given = rig::frames(&mut *camera);
    assert_eq!(given.len(), 80);
    is_stuck.store(false, Ordering::Release);
    let counts = recorder.finish();
    assert!(counts.dropped_frames > 0, "{counts:?}");
    assert_eq!(counts.frames + counts.dropped_frames, 80);
    let drive = RecordedDrive::open(&path).unwrap();
    let losses = drive.losses.unwrap();
    assert_eq!(
        (losses.dropped_frames, losses.dropped_messages),
        (counts.dropped_frames, 0)
    );
    // Times and answers stand in notes, which are whole.
    drive.check_notes().unwrap();
    let read = read(&drive);
    assert_eq!(read.len() as u64, counts.frames);
    assert!(read.iter().all(|frame| given.contains(frame)));
}

struct Nobody;

impl Observer for Nobody {
    fn frame(&mut self, _: &FrameReport) {}
    fn key_frame(&mut self, _: &KeyFrameReport<'_>) {}
}

#[test]
fn a_drive_whose_notes_were_dropped_says_so_and_is_not_taken_for_whole() {
    let path = rig::path("dropped_notes");
    let is_stuck = Arc::new(AtomicBool::new(false));
    let (recorder, mut camera) = record_on(&path, u64::MAX, &is_stuck, 1.0);
    rig::frames(&mut *camera);
    while recorder.counts().frames == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    is_stuck.store(true, Ordering::Release);
    let mut nobody = Nobody;
    while recorder.counts().dropped_messages < 10 {
        recorder.noted(&mut nobody).trace(&Trace {
            at: Micros(1),
            event: Event::JobDisplaced(1),
        });
    }
    is_stuck.store(false, Ordering::Release);
    // It is told while the drive goes on: a process that is killed leaves the count, too.
    let so_far = path.with_file_name("so_far.mcap");
    loop {
        std::fs::copy(&path, &so_far).unwrap();
        if RecordedDrive::open(&so_far).is_ok_and(|drive| drive.check_notes().is_err()) {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let counts = recorder.finish();
    let drive = RecordedDrive::open(&path).unwrap();
    assert_eq!(drive.losses, Some(counts.losses()));
    assert_eq!(counts.lost_messages, 0);
    let fault = drive.check_notes().unwrap_err();
    assert!(
        fault.message().contains("drive.mcap: while it was recorded"),
        "{}",
        fault.message()
    );
    assert!(fault.fix().contains("--timing own"));
}
