//! A short simulated drive at 320x240 and 10 Hz, with a network that believes what it is told.

use std::sync::Arc;

use freespace::crf::CrfConfig;
use freespace::deadline::Slices;
use freespace::frame::{Camera, Lens};
use freespace::grid::GridConfig;
use freespace::map::MapConfig;
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::{CameraPort, WheelPort};
use freespace::priors::PriorsConfig;
use freespace::segmentation::{ChannelOrder, ColourConfig, NetworkShape, TileConfig};
use freespace::space::Mount;
use freespace::track::{TrackConfig, WheelConfig};
use freespace_platform::camera::SimFrames;
use freespace_platform::clock::MonotonicClock;
use freespace_platform::runtime::memory::MemoryPlan;
use freespace_platform::runtime::rights::RealTimeConfig;
use freespace_platform::runtime::{Devices, Setup};
use freespace_platform::segmenter::{Segmenter, SegmenterError};
use freespace_platform::wheels::SimEncoders;
use freespace_platform::world::{Drive, Encoders, Sensor, Textures, World, WorldConfig};

/// Stands in for the network: a fixed belief that the road is a triangle below the horizon; it fails when told to.
pub(crate) struct Triangle {
    shape: NetworkShape,
    runs: u32,
    failing: std::ops::Range<u32>,
    hangs_in: Option<u32>,
    input: Vec<f32>,
    output: Vec<f32>,
}

impl Triangle {
    /// Fails in these of its runs.
    pub(crate) fn new(failing: std::ops::Range<u32>) -> Self {
        let shape = NetworkShape {
            width: 80,
            height: 60,
            classes: 2,
            road: std::iter::once(0).collect(),
            vehicle: std::iter::empty().collect(),
            mean: [0.0; 3],
            scale: [1.0; 3],
            order: ChannelOrder::Rgb,
            out_width: 80,
            out_height: 60,
        };
        Self {
            input: vec![0.0; shape.input_len()],
            output: vec![0.0; shape.output_len()],
            shape,
            runs: 0,
            failing,
            hangs_in: None,
        }
    }

    /// Never comes back from this run.
    #[allow(dead_code, reason = "each test binary uses its own share of this module")]
    pub(crate) fn hanging_in(run: u32) -> Self {
        Self {
            hangs_in: Some(run),
            ..Self::new(0..0)
        }
    }
}

impl Segmenter for Triangle {
    fn name(&self) -> &str {
        "triangle"
    }

    fn shape(&self) -> &NetworkShape {
        &self.shape
    }

    fn run_in_place(
        &mut self,
        fill: &mut dyn FnMut(&mut [f32]),
        read: &mut dyn FnMut(&[f32]),
    ) -> Result<(), SegmenterError> {
        while self.hangs_in == Some(self.runs) {
            std::thread::sleep(std::time::Duration::from_secs(1));
        }
        self.runs += 1;
        if self.failing.contains(&(self.runs - 1)) {
            return Err(SegmenterError::Engine);
        }
        fill(&mut self.input);
        let output = &mut self.output;
        let (road, rest) = output.split_at_mut(80 * 60);
        for y in 0..60_u16 {
            for x in 0..80_u16 {
                let half = 2.0 * (f32::from(y) - 28.0);
                let is_road = (f32::from(x) - 39.5).abs() < half;
                let at = usize::from(y) * 80 + usize::from(x);
                road[at] = if is_road { 0.95 } else { 0.05 };
                rest[at] = 1.0 - road[at];
            }
        }
        read(output);
        Ok(())
    }
}

/// Camera and wheels of a drive of `seconds`.
pub(crate) fn devices(seconds: f64) -> (Camera, Box<dyn CameraPort + Send>, Box<dyn WheelPort + Send>) {
    let mount = Mount {
        height_m: 1.4,
        ahead_m: 1.6,
        left_m: 0.0,
        pitch_rad: 0.04,
        yaw_rad: 0.0,
        roll_rad: 0.0,
    };
    let camera = Camera {
        lens: Lens::pinhole(260.0, 260.0, 159.5, 119.5),
        width: 320,
        height: 240,
        mount,
    };
    let start = Drive {
        start_mps: 8.0,
        ..Drive::default()
    };
    let config = WorldConfig {
        seed: 3,
        drive: start,
        ..WorldConfig::default()
    };
    let world = Arc::new(World::new(&config, &Arc::new(Textures::new())));
    let encoders = Encoders {
        metres_per_count: 0.02,
        ..Encoders::default()
    };
    let wheels = SimEncoders::new(Arc::clone(&world), &encoders);
    let frames = SimFrames::new(world, &camera, &Sensor::default(), false, 10.0, seconds);
    (camera, Box::new(frames), Box::new(wheels))
}

/// The pipeline of such a camera: a key frame each half second.
pub(crate) fn setup(
    camera: Camera,
    frames: Box<dyn CameraPort + Send>,
    wheels: Option<Box<dyn WheelPort + Send>>,
    network: Triangle,
) -> Setup {
    let odometer = WheelConfig {
        metres_per_count: 0.02,
        modulus: 256,
        track_m: 1.54,
        timeout_micros: 200_000,
    };
    Setup {
        config: PipelineConfig {
            camera,
            working_size: (160, 120),
            wheels: wheels.is_some().then_some(odometer),
            cadence: Cadence::Micros(500_000),
            slices: Slices::default(),
            track: TrackConfig::default(),
            map: MapConfig::default(),
            priors: PriorsConfig::default(),
            colour: ColourConfig::default(),
            crf: CrfConfig::default(),
            grid: GridConfig::default(),
        },
        devices: Devices {
            camera: frames,
            wheels,
            segmenter: Box::new(network),
            tiles: TileConfig::default(),
            sinks: Vec::new(),
        },
        real_time: RealTimeConfig::default(),
        plan: MemoryPlan::new(),
        lacks: Vec::new(),
        clock: MonotonicClock::default(),
        slow: None,
    }
}
