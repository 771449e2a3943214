//! A short simulated drive through the whole pipeline, on one thread: reproducible, without an allocation after the start.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::sync::Arc;

use freespace::crf::CrfConfig;
use freespace::deadline::Slices;
use freespace::frame::{Camera, Lens};
use freespace::grid::GridConfig;
use freespace::map::MapConfig;
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::priors::PriorsConfig;
use freespace::segmentation::{ChannelOrder, ColourConfig, NetworkShape, TileConfig};
use freespace::space::Mount;
use freespace::track::{TrackConfig, WheelConfig};
use freespace_platform::camera::SimFrames;
use freespace_platform::runtime::allocation::CountingAllocator;
use freespace_platform::runtime::memory::MemoryPlan;
use freespace_platform::runtime::rights::RealTimeConfig;
use freespace_platform::runtime::{
    Devices, FrameReport, KeyFrameReport, Observer, RunSummary, Setup, run_in_lockstep,
};
use freespace_platform::segmenter::{Segmenter, SegmenterError};
use freespace_platform::wheels::SimEncoders;
use freespace_platform::world::{Drive, Encoders, Sensor, Textures, World, WorldConfig};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Stands in for the network: a fixed belief that the road is a triangle below the horizon; it fails when told to.
struct Triangle {
    shape: NetworkShape,
    runs: u32,
    failing: std::ops::Range<u32>,
}

impl Triangle {
    fn new(failing: std::ops::Range<u32>) -> Self {
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
            shape,
            runs: 0,
            failing,
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

    fn run(&mut self, _input: &[f32], output: &mut [f32]) -> Result<(), SegmenterError> {
        self.runs += 1;
        if self.failing.contains(&(self.runs - 1)) {
            return Err(SegmenterError::Engine);
        }
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
        Ok(())
    }
}

/// Everything that a run gave, as bytes.
#[derive(Default, PartialEq)]
struct Log {
    poses: Vec<String>,
    messages: Vec<Vec<u8>>,
    masks: Vec<Vec<u8>>,
    levels: Vec<&'static str>,
    free_cells: Vec<usize>,
}

impl Observer for Log {
    fn frame(&mut self, report: &FrameReport) {
        self.poses
            .push(format!("{:?}", report.outcome.estimate.world_from_camera));
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        let output = report.output;
        self.messages.push(output.message[..output.message_len].to_vec());
        self.masks.push(output.labels.to_vec());
        self.levels.push(output.level.name());
        self.free_cells.push(
            output
                .grid
                .occupancy
                .iter()
                .filter(|cell| (0..=35).contains(*cell))
                .count(),
        );
    }
}

const SECONDS: f64 = 4.0;

fn drive(failing: std::ops::Range<u32>, has_wheels: bool) -> (Log, RunSummary) {
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
    let odometer = WheelConfig {
        metres_per_count: 0.02,
        modulus: 256,
        track_m: 1.54,
        timeout_micros: 200_000,
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
    let frames = SimFrames::new(world, &camera, &Sensor::default(), false, 10.0, SECONDS);
    let setup = Setup {
        config: PipelineConfig {
            camera,
            working_size: (160, 120),
            wheels: has_wheels.then_some(odometer),
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
            camera: Box::new(frames),
            wheels: has_wheels.then_some(Box::new(wheels)),
            segmenter: Box::new(Triangle::new(failing)),
            tiles: TileConfig::default(),
            sinks: Vec::new(),
        },
        real_time: RealTimeConfig::default(),
        plan: MemoryPlan::new(),
        lacks: Vec::new(),
    };
    let mut log = Log::default();
    let summary = run_in_lockstep(setup, &mut log);
    (log, summary)
}

#[test]
fn a_drive_allocates_nothing_after_the_start_and_answers_every_key_frame() {
    let (log, summary) = drive(0..0, true);
    assert!(freespace_platform::runtime::allocation::is_installed());
    assert_eq!(summary.allocations_after_start, 0);
    assert_eq!(
        (summary.frames, summary.key_frames, summary.dropped_frames),
        (40, 8, 0)
    );
    assert!(
        log.levels.iter().all(|level| *level == "full"),
        "{:?}",
        log.levels
    );
    assert!(
        log.free_cells.iter().all(|cells| *cells > 500),
        "{:?}",
        log.free_cells
    );
}

#[test]
fn the_same_drive_gives_the_same_bytes() {
    let (first, _) = drive(0..0, true);
    let (second, _) = drive(0..0, true);
    assert!(first == second);
}

#[test]
fn a_failing_network_lowers_the_level_and_no_more() {
    let (log, summary) = drive(2..4, true);
    assert_eq!(summary.key_frames, 8);
    let stale = log
        .levels
        .iter()
        .enumerate()
        .filter(|(_, level)| **level == "no_fresh_network");
    assert_eq!(stale.map(|(index, _)| index).collect::<Vec<_>>(), [2, 3]);
    assert!(
        log.free_cells[3] > 100,
        "the last probabilities, moved, still show road: {:?}",
        log.free_cells
    );
}

#[test]
fn without_wheels_every_key_frame_is_answered_too() {
    let (log, summary) = drive(0..0, false);
    assert_eq!((summary.key_frames, log.messages.len()), (8, 8));
    assert_eq!(summary.allocations_after_start, 0);
}
