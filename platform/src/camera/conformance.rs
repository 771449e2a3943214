//! What every camera promises to whoever fetches its frames, tried on each.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use freespace::frame::{Camera, GrayImage, Lens};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::space::{Micros, Mount};

use super::SimFrames;
use super::replay::{KeyFrameRule, KeyFrameSchedule, ReplayCamera, ReplayFrames};
use super::v4l2::{OpenError, V4l2Camera};
use crate::config::{ControlValue, DeviceFormat, DeviceSection, ImageSize};
use crate::world::{Sensor, Textures, World, WorldConfig};

/// Answers in a row without a frame after which a camera counts as one that gives none.
const PATIENCE: usize = 100;

/// Fetches `frames` frames or until the end; checks each answer. Returns the frames that came.
pub(super) fn keeps_its_promises(name: &str, camera: &mut dyn CameraPort, frames: usize) -> usize {
    let mut buffer = FrameBuffer::default();
    let mut last: Option<(u64, Micros)> = None;
    let (mut got, mut without) = (0, 0);
    while got < frames && without < PATIENCE {
        let answer = camera.next_frame(&mut buffer);
        let len = buffer.format.byte_len(buffer.width, buffer.height);
        assert_eq!(
            buffer.bytes.len(),
            len,
            "{name}: after {answer:?}, bytes fit the format"
        );
        match answer {
            CameraAnswer::End => break,
            CameraAnswer::Lost | CameraAnswer::Silent => without += 1,
            CameraAnswer::Frame => {
                let mut luma = GrayImage::new(buffer.width, buffer.height);
                assert_eq!(
                    buffer.raw().luma_into(&mut luma),
                    Ok(()),
                    "{name}: the core takes it"
                );
                if let Some((index, stamp)) = last {
                    assert!(
                        buffer.index > index,
                        "{name}: indices rise: {index}, {}",
                        buffer.index
                    );
                    assert!(
                        buffer.stamp > stamp,
                        "{name}: stamps rise: {stamp:?}, {:?}",
                        buffer.stamp
                    );
                }
                last = Some((buffer.index, buffer.stamp));
                (got, without) = (got + 1, 0);
                // Frames that nobody waited for may be left out, never come back.
                if got.is_multiple_of(3) {
                    camera.skip_before(buffer.stamp.plus(1));
                }
            }
        }
    }
    if got < frames && without < PATIENCE {
        for _ in 0..3 {
            assert_eq!(
                camera.next_frame(&mut buffer),
                CameraAnswer::End,
                "{name}: the end is final"
            );
        }
    }
    got
}

#[test]
fn the_simulated_camera_keeps_its_promises() {
    let camera = Camera {
        lens: Lens::pinhole(60.0, 60.0, 31.5, 23.5),
        width: 64,
        height: 48,
        mount: Mount {
            height_m: 1.5,
            ahead_m: 1.0,
            left_m: 0.0,
            pitch_rad: 0.0,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        },
    };
    for is_gray in [false, true] {
        let world = Arc::new(World::new(&WorldConfig::default(), &Arc::new(Textures::new())));
        let mut camera = SimFrames::new(world, &camera, &Sensor::default(), is_gray, 30.0, 0.3);
        assert_eq!(keeps_its_promises("sim", &mut camera, 100), 9);
    }
}

#[test]
fn a_replayed_folder_keeps_its_promises_with_frames_missing_and_broken() {
    let folder = tempfile::tempdir().unwrap();
    for number in [0, 1, 3, 4, 5] {
        let path = folder.path().join(format!("{number:06}.png"));
        image::GrayImage::new(64, 48).save(&path).unwrap();
        if number == 4 {
            let mut bytes = fs::read(&path).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 0xff;
            fs::write(path, bytes).unwrap();
        }
    }
    let camera = ReplayCamera::open(folder.path(), 10.0, None).unwrap();
    let schedule = KeyFrameSchedule::new(&KeyFrameRule::Interval, 0.5, 10.0, &camera).unwrap();
    let mut frames = ReplayFrames::new(camera, schedule);
    assert!(keeps_its_promises("replay", &mut frames, 100) >= 3);
}

/// vivid stamps the end of a frame before it is there; the start of the exposure it stamps soundly.
fn controls() -> BTreeMap<String, ControlValue> {
    std::env::var_os("FREESPACE_TEST_CAMERA_IS_VIVID")
        .map(|_| ("timestamp_source".to_owned(), ControlValue::Integer(1)))
        .into_iter()
        .collect()
}

/// `FREESPACE_TEST_CAMERA` names a device: each of its formats is tried at 640x480.
#[test]
fn a_camera_of_this_computer_keeps_its_promises() {
    let Some(path) = std::env::var_os("FREESPACE_TEST_CAMERA").map(PathBuf::from) else {
        eprintln!("SKIPPED: no camera device: FREESPACE_TEST_CAMERA is not set");
        return;
    };
    use DeviceFormat::{Grey, Mjpeg, Nv12, Rgb24, Yuyv};
    let mut tried = 0;
    for format in [Yuyv, Nv12, Rgb24, Grey, Mjpeg] {
        let device = DeviceSection {
            path: path.clone(),
            formats: vec![format],
            buffers: 4,
            controls: controls(),
            stamp_offset_s: 0.0,
        };
        let size = ImageSize {
            width: 640,
            height: 480,
        };
        let mut camera = match V4l2Camera::open(&device, size, 30.0) {
            Ok(camera) => camera,
            Err(error @ OpenError::NoFormat { .. }) => {
                eprintln!("SKIPPED: {format:?}: {error}");
                continue;
            }
            Err(error) => panic!("{error}"),
        };
        let got = keeps_its_promises("v4l2", &mut camera, 30);
        let mut events = camera.take_events().unwrap();
        while let Some(event) = events.next_event() {
            eprintln!("{event}");
        }
        assert_eq!(got, 30, "{format:?}: {:?}", camera.status().counts());
        eprintln!(
            "{format:?}: {}, {:?}",
            camera.mode().unwrap(),
            camera.status().counts()
        );
        tried += 1;
    }
    assert!(tried > 0, "it has none of the formats");
}
