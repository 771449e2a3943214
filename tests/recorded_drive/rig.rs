//! A camera that gives frames as fast as they are recorded, and where recordings go.

use std::path::PathBuf;
use std::time::Duration;

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace_platform::eval::grid::GridLayout;
use freespace_platform::runtime::Setup;
use freespace_platform::sink::mcap::{DriveRecorder, RecordingMeter, RecordingPlan, Split};

/// A path for one test's recording, with nothing of an earlier run there.
pub(crate) fn path(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
        .join("recorded_drive")
        .join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder.join("drive.mcap")
}

/// What is to be recorded of a drive.
pub(crate) fn plan<'a>(path: &'a std::path::Path, setup: &'a Setup, split: Split) -> RecordingPlan<'a> {
    let (rows, columns, cell_m) = setup.config.grid.size();
    RecordingPlan {
        path,
        split,
        pipeline: &setup.config,
        layout: GridLayout {
            rows,
            columns,
            cell_m: f64::from(cell_m),
            origin_in_vehicle_m: [0.0, 0.0],
        },
        config_path: std::path::Path::new("drive.toml"),
        config_text: "# a drive\n".to_owned(),
    }
}

/// The same drive, recorded: its camera waits until the recorder has written what it was given.
pub(crate) fn recorded(mut setup: Setup, recorder: &mut DriveRecorder) -> Setup {
    let tapped = recorder.tap_camera(setup.devices.camera);
    setup.devices.camera = Box::new(Patient {
        inner: tapped,
        meter: recorder.meter(),
        given: 0,
    });
    setup.devices.wheels = setup.devices.wheels.map(|wheels| recorder.tap_wheels(wheels));
    setup
}

/// Waits for the recorder, as a drive never does.
pub(crate) struct Patient {
    pub(crate) inner: Box<dyn CameraPort + Send>,
    pub(crate) meter: RecordingMeter,
    pub(crate) given: u64,
}

impl CameraPort for Patient {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        while self.meter.counts().frames < self.given {
            std::thread::sleep(Duration::from_millis(1));
        }
        let answer = self.inner.next_frame(buffer);
        self.given += u64::from(answer == CameraAnswer::Frame);
        answer
    }
}

/// Every frame of a camera: index, stamp and bytes.
pub(crate) fn frames(camera: &mut dyn CameraPort) -> Vec<(u64, u64, Vec<u8>)> {
    let mut buffer = FrameBuffer::default();
    let mut frames = Vec::new();
    while camera.next_frame(&mut buffer) == CameraAnswer::Frame {
        frames.push((buffer.index, buffer.stamp.0, buffer.bytes.clone()));
    }
    frames
}
