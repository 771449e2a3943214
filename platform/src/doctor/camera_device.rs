//! The configured camera: opened as a run would, and watched for a moment.

use std::path::Path;

use freespace::port::{CameraAnswer, CameraPort as _, Clock as _, FrameBuffer};

use super::{Check, System};
use crate::camera::v4l2::{CameraCounts, V4l2Camera};
use crate::clock::MonotonicClock;
use crate::config::{DeviceFormat, DeviceSection, ImageSize};

const NAME: &str = "camera device";

/// Long enough for the slowest start of a USB camera, and for 20 frames at 10 Hz.
const WATCH_MICROS: u64 = 3_000_000;
/// Frames from which a rate is read.
const WATCHED: u64 = 20;
/// Below this share of the rate asked for, something slows the camera down.
const LOWEST_SHARE: f64 = 0.9;

/// What was seen of a camera.
#[derive(Clone, Copy, Debug, Default)]
struct Watched {
    frames: u64,
    first_stamp: u64,
    last_stamp: u64,
    /// Longest time from a stamp until the frame was here.
    latest_micros: u64,
}

impl Watched {
    #[expect(clippy::cast_precision_loss, reason = "seconds")]
    fn rate_hz(&self) -> Option<f64> {
        let micros = self.last_stamp.checked_sub(self.first_stamp)?;
        (self.frames > 1 && micros > 0).then(|| (self.frames - 1) as f64 * 1e6 / micros as f64)
    }
}

/// The configured camera.
#[must_use]
pub fn camera_device(system: &System, device: &DeviceSection, size: ImageSize, rate_hz: f64) -> Check {
    let mut camera = match V4l2Camera::open(device, size, rate_hz) {
        Ok(camera) => camera,
        Err(error) => return Check::fails(NAME, error.to_string(), error.fix()),
    };
    let watched = watch(&mut camera, size);
    let path = device.path.display();
    let counts = camera.status().counts();
    if watched.frames == 0 && counts.bad_stamps > 0 {
        return verdict(path.to_string(), &counts, 0.0, rate_hz, None, None);
    }
    let Some(mode) = camera.mode().filter(|_| watched.frames > 0) else {
        let mut told = camera.take_events();
        let why = told.as_mut().and_then(|events| events.next_event()).map_or_else(
            || "it is open, but gives no frames".to_owned(),
            |event| event.to_string(),
        );
        return Check::fails(
            NAME,
            format!("{path}: {why}"),
            "plug it in and close what uses it (fuser -v /dev/video*); `ls -l /dev/v4l/by-path` shows what is there; \
             a run waits for it",
        );
    };
    let measured = watched.rate_hz().unwrap_or(0.0);
    let seen = format!(
        "{path}: {mode}; {measured:.2} Hz measured, here {:.1} ms after the stamp at the latest",
        f64::from(u32::try_from(watched.latest_micros).unwrap_or(u32::MAX)) * 1e-3
    );
    verdict(
        seen,
        &counts,
        measured,
        rate_hz,
        Some(mode.format),
        stable_name(system, &device.path),
    )
}

fn watch(camera: &mut V4l2Camera, size: ImageSize) -> Watched {
    let clock = MonotonicClock::of_devices();
    let end = clock.now().plus(WATCH_MICROS);
    let mut buffer = FrameBuffer {
        bytes: Vec::with_capacity(3 * size.width * size.height),
        ..FrameBuffer::default()
    };
    let mut watched = Watched::default();
    while watched.frames < WATCHED && clock.now() < end {
        if camera.next_frame(&mut buffer) == CameraAnswer::Frame {
            if watched.frames == 0 {
                watched.first_stamp = buffer.stamp.0;
            }
            watched.last_stamp = buffer.stamp.0;
            watched.frames += 1;
            let age = clock.now().since(buffer.stamp);
            watched.latest_micros = watched.latest_micros.max(age);
        }
    }
    watched
}

fn verdict(
    seen: String,
    counts: &CameraCounts,
    measured: f64,
    rate_hz: f64,
    format: Option<DeviceFormat>,
    stable: Option<String>,
) -> Check {
    if counts.bad_stamps > 0 {
        let what = format!(
            "{seen}; {} stamps went back or lie in the future",
            counts.bad_stamps
        );
        return Check::fails(
            NAME,
            what,
            "for a USB camera: rmmod uvcvideo && modprobe uvcvideo hwtimestamps=0; where a driver always stamps ahead of time, \
             set stamp_offset_s of [camera.device] to that much below zero",
        );
    }
    if counts.lost() > 0 {
        return Check::warning(
            NAME,
            format!("{seen}; {} frames lost", counts.lost()),
            "try another cable, and a USB bus without other devices",
        );
    }
    if measured < LOWEST_SHARE * rate_hz {
        return Check::warning(
            NAME,
            seen,
            "forbid the camera to expose longer than a frame lasts: controls = { exposure_dynamic_framerate = false }",
        );
    }
    if format == Some(DeviceFormat::Mjpeg) {
        return Check::warning(
            NAME,
            format!("{seen}; decoding it allocates in the camera's thread"),
            "name uncompressed formats alone where the bus has room for them: formats = [\"yuyv\", \"nv12\", \"grey\"]",
        );
    }
    match stable {
        Some(link) => Check::warning(
            NAME,
            seen,
            format!("numbers of devices change from start to start: path = \"{link}\""),
        ),
        None => Check::ok(NAME, seen),
    }
}

/// A name of the same device that stays, where `path` is one that does not.
fn stable_name(system: &System, path: &Path) -> Option<String> {
    let name = path.strip_prefix("/dev").ok()?;
    if !name.to_str()?.starts_with("video") {
        return None;
    }
    let device = system
        .path(&format!("dev/{}", name.display()))
        .canonicalize()
        .ok()?;
    let folder = "dev/v4l/by-path";
    (system.list(folder).into_iter())
        .map(|link| format!("{folder}/{link}"))
        .find(|link| {
            system
                .path(link)
                .canonicalize()
                .is_ok_and(|target| target == device)
        })
        .map(|link| format!("/{link}"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::super::State;
    use super::*;

    #[test]
    fn a_number_is_replaced_by_the_name_that_stays() {
        let folder = tempfile::tempdir().unwrap();
        let links = folder.path().join("dev/v4l/by-path");
        fs::create_dir_all(&links).unwrap();
        for number in 0..2 {
            let node = format!("video{number}");
            fs::write(folder.path().join("dev").join(&node), "").unwrap();
            symlink(
                format!("../../{node}"),
                links.join(format!("usb-{number}-video-index0")),
            )
            .unwrap();
        }
        let system = System::at(folder.path());
        let stable = |path| stable_name(&system, Path::new(path));
        assert_eq!(
            stable("/dev/video1").as_deref(),
            Some("/dev/v4l/by-path/usb-1-video-index0")
        );
        assert_eq!(stable("/dev/v4l/by-path/usb-1-video-index0"), None);
        assert_eq!(stable("/dev/video7"), None);
    }

    #[test]
    fn what_is_wrong_comes_before_what_could_be_better() {
        let given = |counts: CameraCounts, measured, format, stable: Option<&str>| {
            verdict(
                String::new(),
                &counts,
                measured,
                30.0,
                Some(format),
                stable.map(str::to_owned),
            )
        };
        let of = |counts, measured, stable| given(counts, measured, DeviceFormat::Yuyv, stable);
        let sound = CameraCounts::default();
        assert_eq!(of(sound, 30.0, None).state, State::Ok);
        let named = of(sound, 30.0, Some("/dev/v4l/by-path/x"));
        assert!(named.fix.unwrap().contains("path = \"/dev/v4l/by-path/x\""));
        let compressed = given(sound, 30.0, DeviceFormat::Mjpeg, Some("x"));
        assert!(compressed.fix.unwrap().contains("yuyv"));
        let slow = of(sound, 15.0, Some("x"));
        assert!(slow.fix.unwrap().contains("exposure_dynamic_framerate"));
        let lost = CameraCounts { damaged: 1, ..sound };
        assert!(of(lost, 15.0, None).seen.contains("1 frames lost"));
        let stamps = CameraCounts {
            bad_stamps: 1,
            ..lost
        };
        assert_eq!(of(stamps, 15.0, None).state, State::Fails);
    }

    #[test]
    fn a_camera_that_is_not_there_fails_with_its_fix() {
        let device = DeviceSection {
            path: "/dev/no-such-camera".into(),
            formats: vec![crate::config::DeviceFormat::Yuyv],
            buffers: 4,
            controls: std::collections::BTreeMap::new(),
            stamp_offset_s: 0.0,
        };
        let size = ImageSize {
            width: 640,
            height: 480,
        };
        let check = camera_device(&System::default(), &device, size, 30.0);
        assert_eq!(check.state, State::Fails);
        assert!(check.seen.starts_with("/dev/no-such-camera: "), "{}", check.seen);
        assert!(check.fix.is_some());
    }
}
