//! Time of *frame*, *track* and *map* on a simulated drive and on KITTI 03, beside the error of the path they found: what is
//! cheap and wrong must show.
//!
//! `cargo bench --bench track`. Every frame goes through the frame task, every key frame through the key-frame task with no
//! network to answer it. Times are processor microseconds of one thread, the lowest of [`PASSES`] passes over the same frames;
//! the work of a frame is the same in each.

mod support;

use std::path::Path;
use std::sync::Arc;

use freespace::frame::{Camera, RgbImage};
use freespace::pipeline::{
    Cadence, FrameTask, KeyFrameJob, KeyFrameOutput, KeyFrameTask, Lesson, Pace, PipelineConfig,
};
use freespace::port::{CameraPort, FrameBuffer, NetworkMiss, RoadNetwork, WheelPort};
use freespace::segmentation::RoadProbability;
use freespace::space::{Micros, Pose};
use freespace::stage::Stage;
use freespace::track::WheelConfig;
use freespace_platform::camera::replay::{KeyFrameRule, KeyFrameSchedule, ReplayCamera, ReplayFrames};
use freespace_platform::camera::{SimFrames, seconds_at};
use freespace_platform::config::{Config, Wheels};
use freespace_platform::eval::trajectory;
use freespace_platform::wheels::{CandumpOptions, CandumpWheels, SimEncoders, WheelDecoder};
use freespace_platform::world::{Encoders, Sensor, Textures, World, WorldConfig};
use support::{ThreadClock, data, percentile};

/// Passes over the same frames.
const PASSES: usize = 3;
/// Length of a simulated drive.
const SECONDS: f64 = 20.0;
/// Wheel readings up to this long after a frame go in before it, as in a run.
const LOOKAHEAD_MICROS: u64 = 25_000;

type Error = Box<dyn std::error::Error>;

/// The network that never answers: its time is not what is measured here.
struct NoNetwork;

impl RoadNetwork for NoNetwork {
    fn begin(&mut self, _image: &RgbImage) {}

    fn finish(&mut self, _until: Option<Micros>, _out: &mut RoadProbability) -> Result<u64, NetworkMiss> {
        Err(NetworkMiss::Failed)
    }
}

/// What a pass over a drive gives.
#[derive(Default)]
struct Pass {
    poses: Vec<Pose>,
    stamps: Vec<Micros>,
    is_key_frame: Vec<bool>,
    frame_micros: Vec<u64>,
    track_micros: Vec<u64>,
    map_micros: Vec<u64>,
}

fn pass(config: &PipelineConfig, camera: &mut dyn CameraPort, wheels: &mut dyn WheelPort) -> Pass {
    let mut frame_task = FrameTask::new(config);
    let mut key_frame_task = KeyFrameTask::new(config, Pace::Reproducible);
    let mut job = KeyFrameJob::new(config.camera.width, config.camera.height);
    let mut output = KeyFrameOutput::new(config);
    let mut lesson = Lesson::new();
    let mut buffer = FrameBuffer::default();
    let mut pass = Pass::default();
    while camera.next_frame(&mut buffer) == freespace::port::CameraAnswer::Frame {
        let until = buffer.stamp.plus(LOOKAHEAD_MICROS);
        wheels.readings_until(until, &mut |reading| frame_task.wheel(reading));
        let stepped = frame_task.step(
            &buffer.raw(),
            buffer.key_frame_wanted,
            &mut job,
            &ThreadClock,
            &(),
        );
        let Ok(outcome) = stepped else { continue };
        pass.poses.push(outcome.estimate.world_from_camera);
        pass.stamps.push(buffer.stamp);
        pass.is_key_frame.push(outcome.is_key_frame);
        pass.frame_micros.push(job.times.of(Stage::Frame));
        pass.track_micros.push(job.times.of(Stage::Track));
        if outcome.is_key_frame {
            // Too late for a grid it never is here: the pace is reproducible.
            let _ = key_frame_task.step(&job, &mut NoNetwork, &ThreadClock, &(), &mut output, &mut lesson);
            pass.map_micros.push(output.times.of(Stage::Map));
            frame_task.learn(&lesson);
            FrameTask::recycle(&mut job);
        }
    }
    pass
}

fn pipeline(
    config: &Config,
    camera: Camera,
    wheels: Option<WheelConfig>,
    cadence: Cadence,
) -> PipelineConfig {
    let working = config.working_size(camera.width, camera.height);
    PipelineConfig {
        camera,
        working_size: (working.width, working.height),
        wheels,
        cadence,
        slices: config.slices(),
        track: config.track,
        map: config.map,
        priors: config.priors,
        colour: config.colour_lines,
        crf: config.crf,
        grid: config.grid,
    }
}

fn simulated(seed: u64) -> Result<(), Error> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/demo.toml");
    let config = Config::load(&path)?;
    let camera = config.camera_for(&path, 640, 480)?;
    let Wheels::Sim(odometer) = config.wheels() else {
        return Err("the demo has simulated wheels".into());
    };
    let world_config = WorldConfig {
        seed,
        track_m: odometer.track_m,
        ..WorldConfig::default()
    };
    let world = Arc::new(World::new(&world_config, &Arc::new(Textures::new())));
    let rate_hz = config.camera.frame_rate_hz;
    let setup = pipeline(&config, camera, Some(odometer), Cadence::Micros(500_000));
    let passes: Vec<Pass> = (0..PASSES)
        .map(|_| {
            let sensor = Sensor::default();
            let mut frames = SimFrames::new(Arc::clone(&world), &camera, &sensor, false, rate_hz, SECONDS);
            let encoders = Encoders {
                seed,
                metres_per_count: odometer.metres_per_count,
                modulus: odometer.modulus,
                ..Encoders::default()
            };
            let mut wheels = SimEncoders::new(Arc::clone(&world), &encoders);
            pass(&setup, &mut frames, &mut wheels)
        })
        .collect();
    let truth: Vec<Pose> = (passes[0].stamps.iter())
        .map(|stamp| world.world_from_camera(seconds_at(*stamp), &camera.mount))
        .collect();
    report(&format!("simulated road, seed {seed}, 640x480"), &passes, &truth);
    Ok(())
}

fn kitti() -> Result<(), Error> {
    let Some(source) = data("track on KITTI 03", "kitti_odom03") else {
        return Ok(());
    };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/kitti.toml");
    let config = Config::load(&path)?;
    let rate_hz = config.camera.frame_rate_hz;
    let Wheels::Can(wheels) = config.wheels() else {
        return Err("KITTI has wheels on the bus".into());
    };
    let size = ReplayCamera::open(&source, rate_hz, None)?.size();
    let camera = config.camera_for(&source, size.width, size.height)?;
    let setup = pipeline(&config, camera, Some(wheels.odometer), Cadence::Micros(500_000));
    let mut passes = Vec::new();
    for _ in 0..PASSES {
        let frames = ReplayCamera::open(&source, rate_hz, None)?;
        let schedule = KeyFrameSchedule::new(&KeyFrameRule::Interval, 0.5, rate_hz, &frames)?;
        let decoder = WheelDecoder::open(&wheels.dbc, &wheels.mapping())?;
        let options = CandumpOptions {
            interface: None,
            offset_micros: wheels.offset_micros(),
        };
        let mut readings = CandumpWheels::open(&source.join("wheel.candump"), &decoder, &options)?;
        passes.push(pass(
            &setup,
            &mut ReplayFrames::new(frames, schedule),
            &mut readings,
        ));
    }
    let truth = trajectory::read(&source.join("poses.txt"))?.poses;
    report("KITTI 03, 1242x375", &passes, &truth);
    Ok(())
}

/// The lowest time of each frame over all passes.
fn lowest(passes: &[Pass], of: impl Fn(&Pass) -> &[u64]) -> Vec<u64> {
    (0..of(&passes[0]).len())
        .map(|i| {
            passes
                .iter()
                .filter_map(|p| of(p).get(i))
                .min()
                .copied()
                .unwrap_or(0)
        })
        .collect()
}

#[expect(clippy::cast_precision_loss, reason = "microseconds, printed as milliseconds")]
fn print(name: &str, micros: &[u64]) {
    let ms = |percent| percentile(micros, percent) as f64 * 1e-3;
    println!(
        "  {name:<24} {:>6.2} {:>6.2} {:>6.2} {:>6.2}",
        ms(50),
        ms(90),
        ms(99),
        ms(100)
    );
}

fn report(title: &str, passes: &[Pass], truth: &[Pose]) {
    let frame = lowest(passes, |p| &p.frame_micros);
    let track = lowest(passes, |p| &p.track_micros);
    let map = lowest(passes, |p| &p.map_micros);
    let both: Vec<u64> = frame.iter().zip(&track).map(|(a, b)| a + b).collect();
    let of_kind = |is_key: bool| -> Vec<u64> {
        let kinds = passes[0].is_key_frame.iter();
        (both.iter().zip(kinds))
            .filter(|(_, kind)| **kind == is_key)
            .map(|(micros, _)| *micros)
            .collect()
    };
    println!("{title}: {} frames; ms, p50, p90, p99, max", both.len());
    print("frame", &frame);
    print("track", &track);
    print("frame + track", &both);
    print("  key frames", &of_kind(true));
    print("  other frames", &of_kind(false));
    print("map", &map);
    if let Some(score) = trajectory::compare(&passes[0].poses, truth) {
        println!(
            "  path: {:.3} m RMS over {:.0} m, scale error {:.2} %",
            score.ate_se3_m,
            score.distance_m,
            100.0 * (score.estimated_distance_m / score.distance_m - 1.0)
        );
    }
}

fn main() -> Result<(), Error> {
    for seed in seeds() {
        simulated(seed)?;
    }
    kitti()
}

/// Seeds given as arguments; the demo's without any.
fn seeds() -> Vec<u64> {
    let given: Vec<u64> = std::env::args().filter_map(|word| word.parse().ok()).collect();
    if given.is_empty() { vec![1] } else { given }
}
