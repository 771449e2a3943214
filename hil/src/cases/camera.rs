//! The camera misbehaves.

use freespace::health::{Faults, QualityLevel};

use crate::bench::{Bench, BenchError, Rig};
use crate::case::{Case, Seen};
use crate::drive::{Script, drive};
use crate::fault::CameraFault;

/// What a picture brings with it that shows nothing new.
const BLIND: Faults =
    Faults(Faults::TRACKING_LOST.0 | Faults::PLANE_HELD.0 | Faults::SCALE_HELD.0 | Faults::WHEELS_SLIP.0);
const FROZEN: Faults = Faults(Faults::IMAGE_FROZEN.0 | BLIND.0);

/// Cases of the camera.
pub(crate) const CASES: &[Case] = &[
    Case {
        name: "frame-drop",
        injected: "every second frame is lost for 4 s",
        required: "an answer for each key frame, no fault is named",
        is_quick: true,
        run: |rig| camera(rig, CameraFault::Drops, Script::default()),
    },
    Case {
        name: "frame-duplicate",
        injected: "every second frame is the one before it for 4 s",
        required: "an answer for each key frame; image_frozen and what follows of it are named, or nothing",
        is_quick: true,
        run: |rig| {
            let script = Script {
                allowed: FROZEN,
                ..Script::default()
            };
            camera(rig, CameraFault::Duplicates, script)
        },
    },
    Case {
        name: "frame-freeze",
        injected: "the same frame again and again for 4 s, the car drives",
        required: "image_frozen is named, no such answer is full",
        is_quick: true,
        run: |rig| {
            let script = Script {
                named: Faults::IMAGE_FROZEN,
                allowed: FROZEN,
                best: QualityLevel::NoFreshMap,
                ..Script::default()
            };
            camera(rig, CameraFault::Freezes, script)
        },
    },
    Case {
        name: "frame-black",
        injected: "black frames for 4 s",
        required: "image_black is named, no such answer is full",
        is_quick: true,
        run: |rig| {
            let script = Script {
                named: Faults::IMAGE_BLACK,
                allowed: BLIND,
                best: QualityLevel::NoFreshMap,
                ..Script::default()
            };
            camera(rig, CameraFault::Black, script)
        },
    },
    Case {
        name: "camera-silent",
        injected: "no frame for 4 s, the device stays",
        required: "camera_silent is named, an answer for each key frame",
        is_quick: true,
        run: |rig| camera(rig, CameraFault::Silent, silent()),
    },
    Case {
        name: "camera-wrong-size",
        injected: "the camera comes back with another size for 4 s",
        required: "no such frame is used, camera_silent is named",
        is_quick: true,
        run: |rig| {
            camera(
                rig,
                CameraFault::WrongSize,
                Script {
                    recovers_s: 6.0,
                    ..silent()
                },
            )
        },
    },
];

fn silent() -> Script {
    Script {
        named: Faults::CAMERA_SILENT,
        // It keeps a picture, which it gives to whoever opens it anew.
        allowed: FROZEN | Faults::DEADLINE_MISSED | Faults::KEY_FRAME_MISSING | Faults::GRID_STALE,
        best: QualityLevel::Moved,
        kept_pictures: 1,
        recovers_s: 5.0,
        ..Script::default()
    }
}

fn camera(rig: &Rig, fault: CameraFault, script: Script) -> Result<Seen, BenchError> {
    let begin = Box::new(move |bench: &mut Bench| set(bench, fault));
    let end = Box::new(|bench: &mut Bench| set(bench, CameraFault::None));
    drive(rig, &Script { begin, end, ..script })
}

fn set(bench: &mut Bench, fault: CameraFault) -> Result<(), BenchError> {
    bench.feed.switches.set_camera(fault);
    Ok(())
}
