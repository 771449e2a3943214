//! `freespace demo`: a simulated drive through the pipeline, measured against its exact truth.

use std::collections::BTreeMap;
use std::sync::Arc;

use freespace::frame::Camera;
use freespace::pipeline::{Cadence, KeyFrameOutput};
use freespace::port::WheelPort;
use freespace::space::{Micros, Pose};

use super::drive::{self, DriveLog, Ports, Progress, Recorded, Recorder, ViewFeed, Watch};
use super::{DemoArgs, Failure, Pace, table};
use crate::bad_input::BadInput;
use crate::camera::{SimFrames, seconds_at};
use crate::config::{Config, Wheels};
use crate::eval::grid::{CellCount, RANGE_M};
use crate::eval::masks::{PixelCount, TruthKind};
use crate::eval::{Truth, trajectory};
use crate::runtime::{FrameReport, KeyFrameReport, Observer, Setup, Start, Status, Trace};
use crate::sink::recording::{FrameRecord, Recording, RunTitle};
use crate::statistics::Publication;
use crate::wheels::SimEncoders;
use crate::world::{Encoders, GridSpec, Label, Sensor, SimCamera, Textures, World, WorldConfig};

/// The configuration that is used where none is given.
pub(super) const SHIPPED: &str = "config/demo.toml";

/// Runs the demo.
///
/// # Errors
/// A bad configuration, or a folder that cannot be written to.
pub fn run(args: &DemoArgs) -> Result<(), Failure> {
    if args.slow.is_some() && args.pace == Pace::Fast {
        return Err(BadInput::new(
            "--slow is given with --pace fast",
            "a slow stage shows at real pace only",
        )
        .into());
    }
    if let Some(slow) = &args.slow
        && slow.from.0 as f64 >= args.seconds * 1e6
    {
        return Err(BadInput::new(
            format!("--slow begins after the drive, which takes {} s", args.seconds),
            "give a second of the drive after the @, or a longer drive with --seconds",
        )
        .into());
    }
    let path = args.config.clone().unwrap_or_else(|| shipped(SHIPPED));
    let config = Config::load(&path)?;
    let camera = config.camera_for(&path, 640, 480)?;
    let mut world_config = WorldConfig {
        seed: args.seed,
        ..WorldConfig::default()
    };
    let odometer = match config.wheels() {
        Wheels::Sim(odometer) => Some(odometer),
        Wheels::None | Wheels::Can(_) => None,
    };
    if let Some(odometer) = &odometer {
        world_config.track_m = odometer.track_m;
    }
    let mut network = drive::open_network(&config)?;
    let engine = network.segmenter.name().to_owned();
    let title = RunTitle {
        title: format!("freespace demo, seed {}", args.seed),
        deadline_ms: config.deadline.publish_ms,
        is_reproducible: args.pace == Pace::Fast,
        ..RunTitle::default()
    };
    let recording = Recording::create(&args.out, title)?;
    let sinks = drive::sinks(&config, args.pace, &mut network)?;
    let world = (network.plan).measure("simulated road", || {
        Arc::new(World::new(&world_config, &Arc::new(Textures::new())))
    });
    let rate_hz = config.camera.frame_rate_hz;
    let frames = (network.plan).measure("simulated camera", || {
        SimFrames::new(
            Arc::clone(&world),
            &camera,
            &Sensor::default(),
            false,
            rate_hz,
            args.seconds,
        )
    });
    let wheels = odometer.map(|odometer| -> Box<dyn WheelPort + Send> {
        let encoders = Encoders {
            seed: args.seed,
            metres_per_count: odometer.metres_per_count,
            modulus: odometer.modulus,
            ..Encoders::default()
        };
        Box::new(SimEncoders::new(Arc::clone(&world), &encoders))
    });
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an interval of at most 10 s"
    )]
    let period_micros = (config.key_frames.interval_s * 1e6) as u64;
    let pipeline = drive::pipeline_config(&config, camera, odometer, Cadence::Micros(period_micros));
    let mut watch = Watch::new(Progress::new(Some(frames.len())), drive::statistics(args.pace));
    let mut log = DriveLog::open(
        &args.mcap,
        args.pace,
        &config,
        &pipeline,
        &mut network.plan,
        &mut watch,
    )?;
    watch.show((network.plan).measure_library("view", || ViewFeed::open(&config, &pipeline, args.pace)));
    let mut judge = (network.plan).measure("recording and truth", || Judge {
        recorder: Recorder::new(recording, &pipeline, BTreeMap::new(), watch),
        truth: frames.camera().clone(),
        mask: vec![0; camera.width * camera.height].into_boxed_slice(),
        world,
        camera,
        cells: CellCount::default(),
        pixels: PixelCount::default(),
        masks: 0,
    });
    let ports = Ports {
        camera: Box::new(frames),
        wheels,
        sinks,
    };
    let setup = Setup {
        slow: args.slow,
        ..network.into_setup(&config, pipeline, ports, &mut log)
    };
    let summary = drive::run(setup, args.pace, &mut log.noted(&mut judge))?;
    log.finish();
    let truth = judge.truth();
    let Recorded {
        mut recording,
        counts,
        statistics,
    } = judge.recorder.finish(&summary)?;
    let score = trajectory::compare(&recording.poses()?, &recording.true_poses()?);
    let truth = score.map_or(truth, |score| truth.with_trajectory(&score));
    let report = recording.finish(&counts, &statistics, Some(truth))?;
    table::print(&report, &engine, Some(&args.out), args.json);
    Ok(())
}

/// A shipped file: beside the current folder, else where the program was built.
pub(super) fn shipped(file: &str) -> std::path::PathBuf {
    let here = std::path::PathBuf::from(file);
    if here.exists() {
        return here;
    }
    std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .join(file)
}

/// Records a drive, and measures it against the world it went through.
struct Judge {
    recorder: Recorder,
    truth: SimCamera,
    /// True road of the last key frame, `[height, width] u8`, 0 or 1.
    mask: Box<[u8]>,
    world: Arc<World>,
    camera: Camera,
    cells: CellCount,
    pixels: PixelCount,
    masks: usize,
}

impl Judge {
    fn true_pose(&self, stamp: Micros) -> Pose {
        self.world
            .world_from_camera(seconds_at(stamp), &self.camera.mount)
    }

    /// Comparison of grids and masks.
    fn truth(&self) -> Truth {
        Truth::default()
            .with_grid(&self.cells)
            .with_road(&self.pixels, self.masks)
    }

    fn true_grid(&self, stamp: Micros) -> Vec<i8> {
        let layout = self.recorder.layout();
        #[expect(clippy::cast_precision_loss, reason = "sizes of a grid")]
        let spec = GridSpec {
            cell_m: layout.cell_m,
            ahead_m: layout.rows as f64 * layout.cell_m,
            side_m: 0.5 * layout.columns as f64 * layout.cell_m,
        };
        self.world
            .free_space_truth(&self.camera, seconds_at(stamp), &spec)
    }

    /// Fills the true mask.
    fn see(&mut self, stamp: Micros) {
        self.truth.see(&self.world, seconds_at(stamp));
        for (road, label) in self.mask.iter_mut().zip(self.truth.labels()) {
            *road = u8::from(*label == Label::Road as u8);
        }
    }

    fn judge(&mut self, report: &KeyFrameReport<'_>) {
        let stamp = report.output.stamp;
        let cells = self.true_grid(stamp);
        self.see(stamp);
        let mut count = CellCount::default();
        let layout = self.recorder.layout();
        count.add(layout, &report.output.grid.occupancy, &cells, &RANGE_M);
        self.cells.merge(&count);
        // Both have the camera's size, and every value is 0 or 1.
        if (self.pixels)
            .add(self.recorder.mask(), &self.mask, TruthKind::World)
            .is_ok()
        {
            self.masks += 1;
        }
        let iou = (count.either > 0).then(|| count.iou());
        self.recorder.record_truth(report.index, &cells, &self.mask, iou);
    }
}

impl Observer for Judge {
    fn started(&mut self, start: &Start<'_>) {
        self.recorder.started(start);
    }

    fn publication(&mut self, publication: &Publication) {
        self.recorder.publication(publication);
    }

    fn trace(&mut self, trace: &Trace) {
        self.recorder.trace(trace);
    }

    fn last_word(&mut self, output: &KeyFrameOutput) {
        self.recorder.last_word(output);
    }

    fn status(&mut self, status: &Status) {
        self.recorder.status(status);
    }

    fn frame(&mut self, report: &FrameReport) {
        let truth = FrameRecord {
            index: usize::try_from(report.index).unwrap_or(usize::MAX),
            stamp: report.stamp,
            world_from_camera: self.true_pose(report.stamp),
        };
        self.recorder.record_true_pose(&truth);
        self.recorder.frame(report);
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        self.recorder.key_frame(report);
        // What answers for an instant without a frame has no picture to be judged by.
        if report.output.has_frame {
            self.judge(report);
        }
    }
}
