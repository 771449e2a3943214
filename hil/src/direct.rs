//! The drive again without devices: the same frames at the stamps that they came with, the same wheel frames, in lockstep.
//!
//! The grids that the module recorded behind a real kernel's camera and bus must be those of this direct replay, and its path
//! that of the car.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use freespace::frame::{Camera, PixelFormat, RgbImage};
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer, WheelPort};
use freespace::segmentation::{Tile, TileConfig};
use freespace::space::Micros;
use freespace::stage::Stage;
use freespace::track::WheelConfig;
use freespace_platform::clock::MonotonicClock;
use freespace_platform::config::{Config, Wheels};
use freespace_platform::eval::{npy, trajectory};
use freespace_platform::runtime::memory::MemoryPlan;
use freespace_platform::runtime::{
    Devices, FaultModel, FrameReport, KeyFrameReport, Observer, Setup, run_modelled,
};
use freespace_platform::segmenter::{self, EngineChoice, Manifest, Segmenter};
use freespace_platform::wheels::{CandumpOptions, CandumpWheels, WheelDecoder};
use freespace_platform::world::{Sensor, SimCamera};

use crate::bench::{Bench, BenchError, Rig};
use crate::case::Seen;
use crate::drive::finish;
use crate::feed::Sent;
use crate::promise::Blind;
use crate::road::{Road, yuyv};

/// Length of the drive.
const DRIVE: Duration = Duration::from_secs(20);
/// Agreement of the free cells, where bytes do not agree.
const IOU: f64 = 0.98;
/// Error of the path's length.
const SCALE: f64 = 0.01;

/// Records a drive and compares.
pub(crate) fn case(rig: &Rig) -> Result<Seen, BenchError> {
    // Not into a folder of the host: User-Mode Linux stands still while the host writes.
    let record = std::env::temp_dir().join(format!("freespace-rig-{}", std::process::id()));
    let bench = Bench::start(rig, &[], Some(&record))?;
    std::thread::sleep(DRIVE);
    let (road, start_micros) = (bench.road.clone(), bench.feed.start_micros);
    let (sent, wheels) = (bench.feed.sent(), bench.feed.sent_wheels());
    let mut seen = finish(bench, Blind::default(), Seen::default())?;
    let log = rig.file("wheels.candump");
    std::fs::write(&log, crate::listener::candump(&wheels, &rig.interface))?;

    let driven = trajectory::read(&record.join("trajectory.tum"))?;
    let stamps = micros_of(driven.stamps_s.as_deref().unwrap_or_default());
    scale(&road, start_micros, &stamps, &driven.poses, &mut seen);
    let frames = pair(&stamps, &sent);
    seen.require(
        frames.len() == stamps.len(),
        format!(
            "{} of {} frames were sent by nobody",
            stamps.len() - frames.len(),
            stamps.len()
        ),
    );
    let direct = replay(rig, &road, frames, &log, &times_of(&record)?)?;
    compare(&record, &direct, &mut seen)?;
    std::fs::copy(record.join("report.json"), rig.file("report.json"))?;
    std::fs::copy(record.join("trajectory.tum"), rig.file("trajectory.tum"))?;
    std::fs::copy(record.join("timing.csv"), rig.file("timing.csv"))?;
    std::fs::remove_dir_all(&record)?;
    Ok(seen)
}

/// The file has six decimals.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "stamps of a running clock"
)]
fn micros_of(seconds: &[f64]) -> Vec<u64> {
    seconds
        .iter()
        .map(|seconds| (seconds * 1e6).round() as u64)
        .collect()
}

fn scale(road: &Road, start_micros: u64, stamps: &[u64], poses: &[freespace::space::Pose], seen: &mut Seen) {
    #[expect(clippy::cast_precision_loss, reason = "a drive of seconds")]
    let seconds = |stamp: u64| (stamp.cast_signed() - start_micros.cast_signed()) as f64 * 1e-6;
    let truth: Vec<_> = stamps
        .iter()
        .map(|stamp| road.world.world_from_camera(seconds(*stamp), &road.camera.mount))
        .collect();
    let Some(score) = trajectory::compare(poses, &truth) else {
        seen.require(false, "the recorded path cannot be compared with the true one");
        return;
    };
    let error = (score.estimated_distance_m / score.distance_m - 1.0).abs();
    seen.note(format!(
        "{:.0} m driven, length error {:.2} %, position error {:.2} m",
        score.distance_m,
        100.0 * error,
        score.ate_se3_m
    ));
    seen.require(error < SCALE, format!("length error {:.2} %", 100.0 * error));
}

/// The picture behind each stamp: the last that was sent before it.
fn pair(stamps: &[u64], sent: &[Sent]) -> Vec<(u64, u64)> {
    let of = |stamp: u64| {
        let after = sent.partition_point(|sent| sent.at_micros <= stamp);
        let sent = sent.get(after.checked_sub(1)?)?;
        (stamp - sent.at_micros < 20_000).then_some((stamp, sent.picture))
    };
    stamps.iter().filter_map(|stamp| of(*stamp)).collect()
}

/// Grids by capture stamp.
type Grids = BTreeMap<u64, Vec<i8>>;

/// What the stages took in the recorded drive, their medians: when a map reaches the tracker decides on what it does.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "milliseconds of a stage"
)]
fn times_of(record: &Path) -> Result<FaultModel, BenchError> {
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(record.join("report.json"))?).unwrap_or_default();
    let micros = |stage: Stage| {
        let millis = report["stages_ms"][stage.name()]["p50"]
            .as_f64()
            .unwrap_or_default();
        (millis * 1e3).round() as u64
    };
    Ok(FaultModel {
        costs_micros: Stage::ALL.map(|stage| {
            if stage == Stage::Segmentation {
                (0, 0)
            } else {
                (micros(stage), 0)
            }
        }),
        network_micros: micros(Stage::Segmentation),
        injection: None,
    })
}

fn replay(
    rig: &Rig,
    road: &Road,
    frames: Vec<(u64, u64)>,
    log: &Path,
    times: &FaultModel,
) -> Result<Grids, BenchError> {
    let (config, ..) = rig.config()?;
    let words = |error: &dyn std::error::Error| BenchError::Config(error.to_string());
    let Wheels::Can(can) = config.wheels() else {
        return Err(BenchError::Config(
            "[wheels] must have the source \"can\"".to_owned(),
        ));
    };
    let decoder = WheelDecoder::open(&can.dbc, &can.mapping()).map_err(|error| words(&error))?;
    let wheels =
        CandumpWheels::open(log, &decoder, &CandumpOptions::default()).map_err(|error| words(&error))?;
    let manifest = Manifest::load(&config.network.manifest).map_err(|error| words(&error))?;
    let network = segmenter::open(&manifest, EngineChoice::Auto, config.network.threads)
        .map_err(|error| words(&error))?;
    let camera = Again::new(road, frames);
    let setup = setup(rig, Box::new(camera), Some(Box::new(wheels)), network)?;
    let mut collector = Collector::default();
    run_modelled(setup, times, &mut collector);
    Ok(collector.0)
}

/// The module's pipeline, as its configuration says, on other devices.
pub(crate) fn setup(
    rig: &Rig,
    frames: Box<dyn CameraPort + Send>,
    wheels: Option<Box<dyn WheelPort + Send>>,
    network: Box<dyn Segmenter>,
) -> Result<Setup, BenchError> {
    let (config, camera, odometer) = rig.config()?;
    Ok(Setup {
        config: pipeline(&config, camera, wheels.is_some().then_some(odometer)),
        devices: Devices {
            camera: frames,
            wheels,
            segmenter: network,
            tiles: TileConfig {
                count: Some(config.network.tiles),
                far: config.network.far_tile.then(|| Tile::far(&camera)),
            },
            sinks: Vec::new(),
        },
        real_time: config.real_time(),
        plan: MemoryPlan::new(),
        lacks: Vec::new(),
        clock: MonotonicClock::default(),
    })
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "an interval of at most 10 s"
)]
fn pipeline(config: &Config, camera: Camera, odometer: Option<WheelConfig>) -> PipelineConfig {
    let working = config.working_size(camera.width, camera.height);
    PipelineConfig {
        camera,
        working_size: (working.width, working.height),
        wheels: odometer,
        cadence: Cadence::Micros((config.key_frames.interval_s * 1e6) as u64),
        slices: config.slices(),
        track: config.track,
        map: config.map,
        priors: config.priors,
        colour: config.colour_lines,
        crf: config.crf,
        grid: config.grid,
    }
}

/// The frames that the module took, rendered again.
pub(crate) struct Again {
    frames: std::vec::IntoIter<(u64, u64)>,
    picture: RgbImage,
    camera: SimCamera,
    road: Road,
    index: u64,
}

impl Again {
    /// Pictures by their numbers, each at its stamp.
    pub(crate) fn new(road: &Road, frames: Vec<(u64, u64)>) -> Self {
        let camera = &road.camera;
        Self {
            frames: frames.into_iter(),
            picture: RgbImage::new(camera.width, camera.height),
            camera: SimCamera::new(camera, &Sensor::default()),
            road: road.clone(),
            index: 0,
        }
    }
}

impl CameraPort for Again {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let Some((stamp, number)) = self.frames.next() else {
            return CameraAnswer::End;
        };
        let seconds = self.road.picture_seconds(number);
        self.camera.render(&self.road.world, seconds, &mut self.picture);
        buffer.index = self.index;
        self.index += 1;
        buffer.stamp = Micros(stamp);
        buffer.format = PixelFormat::Yuyv;
        (buffer.width, buffer.height) = (self.picture.width(), self.picture.height());
        yuyv(self.picture.pixels(), &mut buffer.bytes);
        buffer.key_frame_wanted = false;
        CameraAnswer::Frame
    }
}

/// Looks away.
pub(crate) struct Nobody;

impl Observer for Nobody {
    fn frame(&mut self, _: &FrameReport) {}
    fn key_frame(&mut self, _: &KeyFrameReport<'_>) {}
}

#[derive(Default)]
struct Collector(Grids);

impl Observer for Collector {
    fn frame(&mut self, _: &FrameReport) {}

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        self.0
            .insert(report.output.stamp.0, report.output.grid.occupancy.to_vec());
    }
}

fn compare(record: &Path, direct: &Grids, seen: &mut Seen) -> Result<(), BenchError> {
    let (mut both, mut either, mut same, mut grids) = (0_u64, 0_u64, 0, 0);
    let free = |value: i8| (0..freespace_platform::eval::grid::FREE_BELOW).contains(&value);
    for entry in std::fs::read_dir(record.join("grids"))? {
        let path = entry?.path();
        if path.extension().is_none_or(|ending| ending != "json") {
            continue;
        }
        let header: serde_json::Value = serde_json::from_slice(&std::fs::read(&path)?).unwrap_or_default();
        let stamp = header["stamp_micros"].as_u64().unwrap_or_default();
        let (_, _, recorded) = npy::read_i8(&path.with_extension("npy"))?;
        let Some(replayed) = direct.get(&stamp) else {
            seen.require(false, format!("no key frame at {stamp} us in the direct replay"));
            continue;
        };
        grids += 1;
        same += u64::from(&recorded == replayed);
        for (a, b) in recorded.iter().zip(replayed) {
            both += u64::from(free(*a) && free(*b));
            either += u64::from(free(*a) || free(*b));
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "counts of cells")]
    let iou = both as f64 / either.max(1) as f64;
    seen.note(format!(
        "{same} of {grids} grids are those of the direct replay to the byte, IoU {iou:.4}"
    ));
    seen.require(grids > 0, "no grid was recorded");
    seen.require(iou >= IOU, format!("IoU with the direct replay is {iou:.4}"));
    Ok(())
}
