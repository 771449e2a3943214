//! Mount and metres a count on the simulated road, whose truth is known.
#![allow(clippy::unwrap_used, clippy::cast_precision_loss, reason = "tests")]

use std::sync::Arc;

use freespace::crf::CrfConfig;
use freespace::deadline::Slices;
use freespace::frame::{Camera, Lens};
use freespace::grid::GridConfig;
use freespace::map::MapConfig;
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer, WheelPort};
use freespace::priors::PriorsConfig;
use freespace::segmentation::ColourConfig;
use freespace::space::{Micros, Mount};
use freespace::track::{TrackConfig, WheelConfig, WheelReading};

use super::mount::{calibrate, open_minded, straight_stretches};
use super::survey::{Survey, survey};
use super::ticks::from_stretches;
use crate::camera::SimFrames;
use crate::wheels::SimEncoders;
use crate::world::{Drive, Encoders, Kind, Sensor, Textures, World, WorldConfig};

const SECONDS: f64 = 24.0;
const TRUTH: Mount = Mount {
    height_m: 1.4,
    ahead_m: 1.6,
    left_m: 0.0,
    pitch_rad: 0.04,
    yaw_rad: 0.0,
    roll_rad: 0.0,
};
const WHEELS: WheelConfig = WheelConfig {
    metres_per_count: 0.02,
    modulus: 256,
    track_m: 1.54,
    timeout_micros: 200_000,
};

/// A drive seen once, to be gone through again and again.
struct Tape {
    camera: Camera,
    frames: Arc<Vec<FrameBuffer>>,
    world: Arc<World>,
}

struct Playing {
    frames: Arc<Vec<FrameBuffer>>,
    next: usize,
}

impl CameraPort for Playing {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let Some(frame) = self.frames.get(self.next) else {
            return CameraAnswer::End;
        };
        self.next += 1;
        buffer.clone_from(frame);
        CameraAnswer::Frame
    }
}

fn tape(speed_mps: f64) -> Tape {
    let camera = Camera {
        lens: Lens::pinhole(280.0, 280.0, 159.5, 119.5),
        width: 320,
        height: 240,
        mount: TRUTH,
    };
    let config = WorldConfig {
        seed: 5,
        kind: Some(Kind::Urban),
        drive: Drive {
            start_mps: speed_mps,
            cruise_mps: speed_mps.max(0.1),
            cruise_s: 1000.0,
            ..Drive::default()
        },
        // The simulated body's mean pitch is not zero: it is where it was at the start.
        body_pitch_rad: 0.001,
        ..WorldConfig::default()
    };
    let world = Arc::new(World::new(&config, &Arc::new(Textures::new())));
    let mut sim = SimFrames::new(
        Arc::clone(&world),
        &camera,
        &Sensor::default(),
        true,
        10.0,
        SECONDS,
    );
    let mut frames = Vec::new();
    let mut buffer = FrameBuffer::default();
    while sim.next_frame(&mut buffer) == CameraAnswer::Frame {
        frames.push(buffer.clone());
    }
    Tape {
        camera,
        frames: Arc::new(frames),
        world,
    }
}

impl Tape {
    fn encoders(&self) -> SimEncoders {
        let encoders = Encoders {
            metres_per_count: WHEELS.metres_per_count,
            ..Encoders::default()
        };
        SimEncoders::new(Arc::clone(&self.world), &encoders)
    }

    fn survey(&self, mount: &Mount, has_wheels: bool, round: Option<usize>) -> Survey {
        let mut config = PipelineConfig {
            camera: Camera {
                mount: *mount,
                ..self.camera
            },
            working_size: (160, 120),
            wheels: has_wheels.then_some(WHEELS),
            cadence: Cadence::Micros(500_000),
            slices: Slices::default(),
            track: TrackConfig::default(),
            map: MapConfig::default(),
            priors: PriorsConfig::default(),
            colour: ColourConfig::default(),
            crf: CrfConfig::default(),
            grid: GridConfig::default(),
        };
        if let Some(round) = round {
            config.priors.plane = open_minded(&config.priors.plane, round);
        }
        let camera = Playing {
            frames: Arc::clone(&self.frames),
            next: 0,
        };
        let wheels = has_wheels.then(|| -> Box<dyn WheelPort + Send> { Box::new(self.encoders()) });
        survey(config, Box::new(camera), wheels, &mut |_| {})
    }
}

#[test]
fn a_wrong_mount_is_corrected_from_a_drive() {
    let tape = tape(9.0);
    let wrong = Mount {
        height_m: 1.2,
        pitch_rad: TRUTH.pitch_rad + 0.02,
        ..TRUTH
    };
    let found = calibrate(&wrong, &mut |mount, round| tape.survey(mount, true, Some(round))).unwrap();
    println!("{found:#?}");
    let height = found.height_m.unwrap();
    assert!((height.value / TRUTH.height_m - 1.0).abs() < 0.04, "{height:?}");
    assert!(
        (found.pitch_rad.value - TRUTH.pitch_rad).abs() < 0.003,
        "{:?}",
        found.pitch_rad
    );
    assert!(found.yaw_rad.value.abs() < 0.006, "{:?}", found.yaw_rad);
    let without = calibrate(&wrong, &mut |mount, round| tape.survey(mount, false, Some(round))).unwrap();
    assert!(without.height_m.is_none());
    assert!(
        (without.pitch_rad.value - TRUTH.pitch_rad).abs() < 0.006,
        "{:?}",
        without.pitch_rad
    );

    let straight = straight_stretches(&tape.survey(&TRUTH, false, None)).unwrap();
    let mut readings: Vec<WheelReading> = Vec::new();
    tape.encoders()
        .readings_until(Micros(24_000_000), &mut |reading| readings.push(reading));
    let guessed = WheelConfig {
        metres_per_count: 0.018,
        ..WHEELS
    };
    let ticks = from_stretches(&readings, &guessed, &straight).unwrap();
    println!("{ticks:#?}");
    assert!(
        (ticks.metres_per_count / WHEELS.metres_per_count - 1.0).abs() < 0.06,
        "{ticks:?}"
    );
}

#[test]
fn a_standing_car_is_refused() {
    let tape = tape(0.0);
    let error = calibrate(&TRUTH, &mut |mount, round| tape.survey(mount, true, Some(round))).unwrap_err();
    assert!(error.to_string().contains("stands"), "{error}");
}
