//! A process that is killed while it records.

use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use freespace::port::FrameBuffer;
use freespace_platform::camera::replay::drive::{DriveFrames, RecordedDrive};
use freespace_platform::sink::mcap::{DriveRecorder, Split};

use crate::rig;
use crate::simulated::{self, Triangle};

/// Where the child records to.
const PATH: &str = "FREESPACE_TEST_RECORD_TO";
/// Frames of a chunk, of the recorder's queue, and one on its way: 320x240 in colour.
const MOST_LOST: usize = 19 + 16 + 2;

#[test]
#[ignore = "the child of the test below: it records until it is killed"]
fn records_until_it_is_killed() {
    let path = PathBuf::from(std::env::var_os(PATH).unwrap());
    let (camera, frames, _) = simulated::devices(600.0);
    let setup = simulated::setup(camera, frames, None, Triangle::new(0..0));
    let mut recorder = DriveRecorder::open(rig::plan(&path, &setup, Split::default())).unwrap();
    let mut camera = rig::recorded(setup, &mut recorder).devices.camera;
    let mut buffer = FrameBuffer::default();
    for given in 1.. {
        camera.next_frame(&mut buffer);
        println!("\ngiven {given}");
    }
}

#[test]
fn a_killed_process_loses_its_last_chunk_at_most() {
    let path = rig::path("killed");
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "killed::records_until_it_is_killed",
            "--ignored",
            "--nocapture",
        ])
        .env(PATH, &path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut given = 0;
    let mut lines = BufReader::new(child.stdout.take().unwrap())
        .lines()
        .map_while(Result::ok);
    let count = |line: String| {
        line.strip_prefix("given ")
            .and_then(|count| count.parse::<usize>().ok())
    };
    for line in lines.by_ref() {
        given = count(line).unwrap_or(given);
        if given >= 100 {
            break;
        }
    }
    // SIGKILL.
    child.kill().unwrap();
    child.wait().unwrap();
    given = lines.filter_map(count).last().unwrap_or(given);
    let drive = RecordedDrive::open(&path).unwrap();
    assert_eq!(drive.cut.len(), 1);
    let read = rig::frames(&mut DriveFrames::all(&drive));
    assert!(
        read.len() + MOST_LOST >= given,
        "{} of {given} frames",
        read.len()
    );
    let (_, mut frames, _) = simulated::devices(600.0);
    let mut buffer = FrameBuffer::default();
    for (index, stamp, bytes) in read {
        frames.next_frame(&mut buffer);
        assert!((buffer.index, buffer.stamp.0) == (index, stamp) && buffer.bytes == bytes);
    }
}
