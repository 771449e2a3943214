#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::BTreeMap;
use std::path::PathBuf;

use freespace::frame::PixelFormat;
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use rustix::io::Errno;

use super::node::{ControlKind, Interval};
use super::reconnect::{Reconnecting, WAIT_MICROS};
use super::request::Request;
use super::script::{Act, SIZE, Script, Shot, control, fill, shot, yuyv};
use super::status::Teller;
use super::*;
use crate::config::ControlValue;
use crate::runtime::allocation::RealTimeScope;

/// A camera by script, and what it told.
struct Rig {
    script: Script,
    camera: Reconnecting<Script>,
    status: CameraStatus,
    events: CameraEvents,
    buffer: FrameBuffer,
}

fn section() -> DeviceSection {
    DeviceSection {
        path: PathBuf::from("/dev/video0"),
        formats: vec![DeviceFormat::Yuyv, DeviceFormat::Mjpeg],
        buffers: 4,
        controls: BTreeMap::new(),
        stamp_offset_s: -0.001,
    }
}

fn open(script: &Script, section: &DeviceSection) -> Result<Rig, OpenError> {
    let size = ImageSize {
        width: SIZE.0 as usize,
        height: SIZE.1 as usize,
    };
    let (teller, status, events) = Teller::new(&section.path);
    let request = Request::new(section, size, 30.0);
    Ok(Rig {
        script: script.clone(),
        camera: Reconnecting::open(script.clone(), request, section.stamp_offset_micros(), teller)?,
        status,
        events,
        buffer: FrameBuffer {
            bytes: Vec::with_capacity(3 * size.width * size.height),
            ..FrameBuffer::default()
        },
    })
}

fn rig(acts: impl IntoIterator<Item = Act>) -> Rig {
    let script = Script::default();
    script.acts(acts);
    open(&script, &section()).unwrap()
}

impl Rig {
    /// The next answer; the call may not take longer than its wait.
    fn next(&mut self) -> CameraAnswer {
        let before = self.script.0.borrow().now;
        let answer = self.camera.next_frame(&mut self.buffer);
        assert!(
            self.script.0.borrow().now - before <= WAIT_MICROS,
            "a bounded wait"
        );
        answer
    }

    /// The index of the next frame.
    fn frame(&mut self) -> u64 {
        assert_eq!(self.next(), CameraAnswer::Frame);
        self.buffer.index
    }

    fn counts(&self) -> CameraCounts {
        self.status.counts()
    }

    fn told(&mut self) -> Vec<CameraEvent> {
        std::iter::from_fn(|| self.events.next_event()).collect()
    }
}

#[test]
fn a_frame_comes_as_the_core_reads_it() {
    let mut rig = rig([fill(40)]);
    assert_eq!(rig.frame(), 0);
    let buffer = &rig.buffer;
    assert_eq!(
        (buffer.format, buffer.width, buffer.height),
        (PixelFormat::Yuyv, 8, 4)
    );
    assert_eq!(buffer.bytes.len(), 64, "four bytes of padding a row are gone");
    assert_eq!(buffer.stamp.0, 10_014_000, "20 ms on, 5 ms old, 1 ms of offset");
    let [CameraEvent::Connected(mode)] = rig.told()[..] else {
        panic!("it tells how it gives frames");
    };
    assert_eq!(
        mode.to_string(),
        "YUYV 8x4 at 30 Hz, stamped at the start of the exposure"
    );
}

#[test]
fn the_newest_frame_wins_and_the_others_go_back_at_once() {
    let at_once = |sequence| {
        Act::Fill(Shot {
            after_micros: 0,
            stamp: |now| now - 1,
            ..shot(sequence)
        })
    };
    let mut rig = rig([fill(0), at_once(1), at_once(2), fill(3), at_once(6)]);
    assert_eq!(rig.frame(), 2);
    assert_eq!(rig.camera.skip_before(rig.buffer.stamp), 2);
    assert_eq!(rig.frame(), 6);
    assert_eq!(
        rig.camera.skip_before(rig.buffer.stamp),
        3,
        "one overtaken, two missing"
    );
    let counts = rig.counts();
    assert_eq!((counts.frames, counts.superseded, counts.missing), (2, 3, 2));
    assert_eq!(rig.told()[1], CameraEvent::Lost(Loss::Gap));
}

#[test]
fn damaged_torn_and_wrongly_stamped_frames_are_lost_and_the_next_one_comes() {
    let frames = [
        Shot {
            is_damaged: true,
            ..shot(1)
        },
        Shot { torn: 5, ..shot(2) },
        Shot {
            stamp: |now| now + 1_001,
            ..shot(3)
        },
        Shot {
            stamp: |now| now - 100_000,
            ..shot(4)
        },
        Shot {
            stamp: |_| 0,
            ..shot(5)
        },
        Shot {
            clock: StampClock::Copied,
            ..shot(6)
        },
    ];
    let mut rig = rig([fill(0)]
        .into_iter()
        .chain(frames.map(Act::Fill))
        .chain([fill(7)]));
    assert_eq!(rig.frame(), 0);
    let before = rig.buffer.stamp;
    for _ in 1..=6 {
        assert_eq!(rig.next(), CameraAnswer::Lost);
        assert_eq!(rig.buffer.bytes.len(), 64, "the buffer stays usable");
    }
    assert_eq!(rig.frame(), 7);
    assert!(rig.buffer.stamp > before);
    assert_eq!(rig.camera.skip_before(before), 0, "each was answered for");
    let counts = rig.counts();
    assert_eq!((counts.damaged, counts.bad_stamps, counts.lost()), (2, 4, 6));
    let losses = [
        Loss::Damaged,
        Loss::StampAhead,
        Loss::StampBack,
        Loss::StampOld,
        Loss::StampClock,
    ];
    assert_eq!(rig.told()[1..], losses.map(CameraEvent::Lost), "each kind once");
}

#[test]
fn a_camera_that_was_pulled_out_comes_back_and_counts_on() {
    for gone in [
        Act::Fail(Errno::NODEV),
        Act::Fail(Errno::IO),
        Act::HangUp(Errno::IO),
    ] {
        let mut rig = rig([fill(10), gone]);
        assert_eq!(rig.frame(), 0);
        let before = rig.buffer.stamp;
        rig.script.0.borrow_mut().absent = Some(Errno::NOENT);
        assert_eq!(rig.next(), CameraAnswer::Silent);
        for _ in 0..100 {
            assert_eq!(rig.next(), CameraAnswer::Silent);
        }
        let opens = rig.script.0.borrow().opens.clone();
        let waits: Vec<u64> = opens.windows(2).map(|pair| (pair[1] - pair[0]) / 1_000).collect();
        assert_eq!(waits[1..6], [200, 400, 800, 1_600, 2_000], "rarer each time");
        rig.script.0.borrow_mut().absent = None;
        rig.script.acts([fill(0), fill(1)]);
        while rig.next() == CameraAnswer::Silent {}
        assert_eq!(rig.buffer.index, 1, "indices rise over connections");
        assert!(rig.buffer.stamp > before);
        let counts = rig.counts();
        assert_eq!((counts.connections, counts.disconnections), (2, 1));
        let told = rig.told();
        let reasons = if matches!(gone, Act::Fail(Errno::NODEV)) {
            1
        } else {
            2
        };
        assert_eq!(told.len(), 2 + reasons, "each reason once: {told:?}");
        assert!(matches!(told.last(), Some(CameraEvent::Connected(_))));
    }
}

#[test]
fn a_camera_that_is_not_there_at_the_start_is_waited_for() {
    for errno in [Errno::NOENT, Errno::NODEV, Errno::BUSY, Errno::IO] {
        let script = Script::default();
        script.0.borrow_mut().absent = Some(errno);
        script.acts([fill(0)]);
        let mut rig = open(&script, &section()).unwrap();
        assert_eq!(rig.camera.mode(), None);
        assert_eq!(rig.next(), CameraAnswer::Silent);
        script.0.borrow_mut().absent = None;
        while rig.next() == CameraAnswer::Silent {}
        let told = rig.told();
        assert_eq!((told.len(), told[0]), (2, CameraEvent::away(errno)), "said once");
    }
}

#[test]
fn a_camera_that_comes_back_otherwise_is_refused_once_and_tried_again() {
    let mut rig = rig([fill(0), Act::Fail(Errno::NODEV)]);
    assert_eq!(rig.frame(), 0);
    rig.script.0.borrow_mut().layouts = vec![yuyv(16, 8)];
    for _ in 0..200 {
        assert_eq!(rig.next(), CameraAnswer::Silent);
    }
    assert!(rig.counts().refusals > 5);
    let told = rig.told();
    assert_eq!(told[2..], [CameraEvent::Refused(Refusal::NoFormat)]);
    rig.script.0.borrow_mut().layouts = vec![yuyv(SIZE.0, SIZE.1)];
    rig.script.acts([fill(0)]);
    while rig.next() == CameraAnswer::Silent {}
    assert_eq!(rig.buffer.index, 1);
}

#[test]
fn a_camera_that_hangs_is_opened_anew_and_that_is_said_once() {
    let mut rig = rig([fill(0), Act::Pause(60_000_000), fill(1)]);
    assert_eq!(rig.frame(), 0);
    while rig.next() == CameraAnswer::Silent {}
    assert!((25..35).contains(&rig.counts().connections), "{:?}", rig.counts());
    assert_eq!(rig.told()[1], CameraEvent::Stuck);
    assert!(rig.told().is_empty());
}

#[test]
fn a_driver_that_lies_does_not_keep_the_thread_busy() {
    let mut rig = rig(std::iter::repeat_n(Act::False, 1_000));
    let before = rig.script.0.borrow().now;
    for _ in 0..100 {
        assert_eq!(rig.next(), CameraAnswer::Silent);
    }
    assert!(rig.script.0.borrow().now - before >= 1_000_000);
}

#[test]
fn an_uncompressed_frame_takes_no_memory() {
    let mut rig = rig((0..12).map(fill));
    rig.frame();
    let scope = RealTimeScope::enter();
    for _ in 0..10 {
        rig.frame();
    }
    // The script's own clock and queue take none either.
    assert_eq!(scope.allocations(), 0);
}

#[test]
fn the_first_format_that_comes_at_size_and_rate_is_taken() {
    let script = Script::default();
    let jpeg = super::node::Layout {
        format: super::node::FourCc(*b"MJPG"),
        bytes_per_line: 0,
        ..yuyv(SIZE.0, SIZE.1)
    };
    script.0.borrow_mut().layouts = vec![yuyv(16, 8), jpeg];
    let rig = open(&script, &section()).unwrap();
    assert_eq!(rig.camera.mode().unwrap().format, DeviceFormat::Mjpeg);
}

/// What opening fails with, where the script's world is changed so.
fn refused(change: impl FnOnce(&mut super::script::World)) -> OpenError {
    let script = Script::default();
    change(&mut script.0.borrow_mut());
    match open(&script, &section()) {
        Err(error) => error,
        Ok(_) => panic!("it was taken"),
    }
}

#[test]
fn what_no_waiting_heals_is_an_error_with_its_fix() {
    let cases = [
        (
            refused(|world| world.absent = Some(Errno::ACCESS)),
            "may not be opened",
            "group `video`",
        ),
        (
            refused(|world| world.absent = Some(Errno::NOSYS)),
            "built without",
            "libclang",
        ),
        (
            refused(|world| world.abilities.is_capture = false),
            "gives no pictures",
            "--list-devices",
        ),
        (
            refused(|world| world.stamps = StampClock::Unknown),
            "does not name",
            "uvcvideo",
        ),
        (
            refused(|world| world.layouts = vec![yuyv(16, 8)]),
            "YUYV comes as 16x8, MJPG becomes YUYV; it offers YUYV 16x8",
            "[camera]",
        ),
        (
            refused(|world| {
                world.interval = Some(Interval {
                    numerator: 1,
                    denominator: 10,
                })
            }),
            "does not give 8x4 at 30 Hz: YUYV comes at 10.00 Hz",
            "frame_rate_hz",
        ),
    ];
    for (error, message, fix) in cases {
        let text = error.to_string();
        assert!(
            text.starts_with("/dev/video0: ") && text.contains(message),
            "{text}"
        );
        assert!(error.fix().contains(fix), "{}", error.fix());
    }
}

fn with_controls(controls: &[(&str, ControlValue)]) -> Result<Vec<(u32, i32)>, OpenError> {
    let script = Script::default();
    script.0.borrow_mut().controls = vec![
        control(3, "Exposure Time, Absolute", ControlKind::Integer, 100),
        control(5, "Auto Exposure", ControlKind::Menu, 3),
        control(7, "White Balance, Automatic", ControlKind::Bool, 1),
    ];
    script.0.borrow_mut().menu = vec!["Auto Mode", "Manual Mode", "", "Aperture Priority Mode"];
    let controls = controls
        .iter()
        .map(|(name, value)| ((*name).to_owned(), value.clone()));
    let section = DeviceSection {
        controls: controls.collect(),
        ..section()
    };
    open(&script, &section)?;
    let set = script.0.borrow().set.clone();
    Ok(set)
}

#[test]
fn controls_are_set_by_name_modes_before_numbers() {
    let item = |name: &str| ControlValue::Item(name.to_owned());
    let set = with_controls(&[
        ("exposure_time_absolute", ControlValue::Integer(50)),
        ("auto_exposure", item("manual_mode")),
        ("white_balance_automatic", ControlValue::Bool(false)),
    ]);
    assert_eq!(set.unwrap(), [(5, 1), (7, 0), (3, 50)]);
    let cases = [
        (
            "exposure_absolute",
            ControlValue::Integer(50),
            "none of that name",
            "did you mean `exposure_time_absolute`",
        ),
        (
            "exposure_time_absolute",
            ControlValue::Integer(105),
            "105 is no value",
            "from 0 to 100 in steps of 5",
        ),
        (
            "exposure_time_absolute",
            ControlValue::Integer(52),
            "52 is no value",
            "in steps of 5",
        ),
        (
            "exposure_time_absolute",
            ControlValue::Bool(true),
            "true is no value",
            "whole number",
        ),
        (
            "auto_exposure",
            ControlValue::Integer(2),
            "2 is not in its menu",
            "1 \"Manual Mode\", 3 \"Aperture",
        ),
        (
            "auto_exposure",
            item("manuel"),
            "\"manuel\" is not in its menu",
            "0 \"Auto Mode\"",
        ),
    ];
    for (name, value, message, fix) in cases {
        let error = with_controls(&[(name, value)]).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
        assert!(error.fix().contains(fix), "{}", error.fix());
    }
}

#[test]
fn the_port_keeps_its_promises_through_every_fault() {
    let faults = [
        Act::Fill(Shot {
            is_damaged: true,
            ..shot(2)
        }),
        Act::Pause(250_000),
        Act::Fill(Shot {
            stamp: |now| now + 1_001,
            ..shot(4)
        }),
        Act::Fail(Errno::NODEV),
        fill(0),
        Act::HangUp(Errno::IO),
        Act::False,
        Act::Pause(2_500_000),
    ];
    let acts = faults
        .into_iter()
        .flat_map(|fault| [fill(5), fault, fill(6), fill(8)]);
    let mut rig = rig(acts);
    let got = crate::camera::conformance::keeps_its_promises("v4l2 by script", &mut rig.camera, 1_000);
    assert_eq!(got, 25);
}
