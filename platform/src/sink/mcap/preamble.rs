//! What stands at the head of every part of a recorded drive: with it, each part replays by itself.
//!
//! Two attachments: `drive.json` (cadence, camera as it was calibrated, where the configuration lay) and `config.toml`, the
//! configuration as it was written. The camera is written out, for its lens may have come from a file of the drive. When they were
//! attached, their `create_time`, is the only date in a part: log times are of the drive's clock, which viewers show from 1970 on.

use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use foxglove::schemas::CameraCalibration;
use freespace::frame::{Camera, Lens};
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::space::{Micros, Mount};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::format::Topic;
use super::note::{Note, timestamp, transform};

/// Name of the attachment that describes the drive.
pub const DRIVE: &str = "drive.json";
/// Name of the attachment that holds the configuration.
pub const CONFIG: &str = "config.toml";
/// What this program writes, and alone reads.
pub const VERSION: u32 = 1;

/// The description of a drive.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DriveNote {
    /// Version of this layout.
    pub version: u32,
    /// Of this drive alone: by it parts are known that belong together.
    #[serde(default)]
    pub id: String,
    /// Time between key frames; none where each was asked for.
    pub cadence_micros: Option<u64>,
    /// Whether the pipeline had wheel encoders.
    pub has_wheels: bool,
    /// Where the configuration lay: its relative paths start there.
    pub config_path: PathBuf,
    camera: Value,
}

/// The camera as JSON; its parts are read by the core's own rules.
#[derive(Deserialize)]
struct CameraNote {
    width: usize,
    height: usize,
    lens: Lens,
    mount: Mount,
}

impl DriveNote {
    /// Of a pipeline whose configuration lies at `config_path`.
    #[must_use]
    pub fn new(pipeline: &PipelineConfig, config_path: &Path) -> Self {
        let path = std::path::absolute(config_path).unwrap_or_else(|_| config_path.to_owned());
        Self {
            version: VERSION,
            id: fresh_id(),
            cadence_micros: match pipeline.cadence {
                Cadence::Micros(micros) => Some(micros),
                Cadence::OnDemand => None,
            },
            has_wheels: pipeline.wheels.is_some(),
            config_path: path,
            camera: camera_json(&pipeline.camera),
        }
    }

    /// When a frame becomes a key frame.
    #[must_use]
    pub fn cadence(&self) -> Cadence {
        self.cadence_micros.map_or(Cadence::OnDemand, Cadence::Micros)
    }

    /// The camera; none where it is not whole.
    #[must_use]
    pub fn camera(&self) -> Option<Camera> {
        let note: CameraNote = serde_json::from_value(self.camera.clone()).ok()?;
        Some(Camera {
            lens: note.lens,
            width: note.width,
            height: note.height,
            mount: note.mount,
        })
    }
}

/// The computer's date, nanoseconds since 1970. Nothing is computed from it.
#[expect(clippy::cast_possible_truncation, reason = "until the year 2554")]
pub(super) fn unix_nanos() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default()
        .as_nanos() as u64
}

/// When it was made, and a number of its own for what was made at the same time.
fn fresh_id() -> String {
    // Keyed by the system's random numbers.
    let random = RandomState::new().build_hasher().finish();
    format!("{}-{random:016x}", unix_nanos() / 1_000)
}

fn camera_json(camera: &Camera) -> Value {
    let lens = match camera.lens {
        Lens::BrownConrady(lens) => json!({
            "model": "brown_conrady", "fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "k": lens.k, "p": lens.p,
        }),
        Lens::KannalaBrandt(lens) => json!({
            "model": "kannala_brandt", "fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "k": lens.k,
        }),
    };
    let mount = &camera.mount;
    json!({
        "width": camera.width,
        "height": camera.height,
        "lens": lens,
        "mount": {
            "height_m": mount.height_m, "ahead_m": mount.ahead_m, "left_m": mount.left_m,
            "pitch_rad": mount.pitch_rad, "yaw_rad": mount.yaw_rad, "roll_rad": mount.roll_rad,
        },
    })
}

/// Lens and place of the camera, for viewers.
pub(super) fn standing_notes(camera: &Camera) -> Vec<Note> {
    let mount = transform(
        "vehicle",
        "camera",
        &camera.mount.vehicle_from_camera(),
        Micros(0),
    );
    vec![
        Note::encoded(Topic::Calibration, Micros(0), &calibration(camera)),
        Note::encoded(Topic::Transform, Micros(0), &mount),
    ]
}

#[expect(clippy::cast_possible_truncation, reason = "image sizes")]
fn calibration(camera: &Camera) -> CameraCalibration {
    let (model, d, [fx, fy, cx, cy]) = match camera.lens {
        Lens::BrownConrady(lens) => (
            "plumb_bob",
            vec![lens.k[0], lens.k[1], lens.p[0], lens.p[1], lens.k[2]],
            [lens.fx, lens.fy, lens.cx, lens.cy],
        ),
        Lens::KannalaBrandt(lens) => (
            "kannala_brandt",
            lens.k.to_vec(),
            [lens.fx, lens.fy, lens.cx, lens.cy],
        ),
    };
    CameraCalibration {
        timestamp: timestamp(Micros(0)),
        frame_id: "camera".to_owned(),
        width: camera.width as u32,
        height: camera.height as u32,
        distortion_model: model.to_owned(),
        d,
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use freespace::frame::{BrownConrady, KannalaBrandt};

    #[test]
    fn a_camera_is_read_back_to_the_last_bit() {
        let numbers = [1.0 / 3.0, 717.123_456_789_012_3, 1e-17, -0.1 + 0.3];
        let mount = Mount {
            height_m: numbers[0],
            ahead_m: 0.1,
            left_m: numbers[2],
            pitch_rad: numbers[3],
            yaw_rad: 0.7 / 3.0,
            roll_rad: 0.0,
        };
        let brown = Lens::BrownConrady(BrownConrady {
            fx: numbers[1],
            fy: numbers[1] / 7.0,
            cx: numbers[0],
            cy: numbers[3],
            k: [numbers[2], numbers[0], numbers[3]],
            p: [numbers[3], numbers[0]],
        });
        let fisheye = Lens::KannalaBrandt(KannalaBrandt {
            fx: numbers[1],
            k: numbers,
            ..KannalaBrandt::default()
        });
        for lens in [brown, fisheye] {
            let camera = Camera {
                lens,
                width: 640,
                height: 480,
                mount,
            };
            let note = DriveNote {
                version: VERSION,
                id: fresh_id(),
                cadence_micros: None,
                has_wheels: false,
                config_path: PathBuf::new(),
                camera: camera_json(&camera),
            };
            let text = serde_json::to_vec(&note).unwrap();
            let read: DriveNote = serde_json::from_slice(&text).unwrap();
            assert_eq!(read.camera(), Some(camera));
        }
    }
}
