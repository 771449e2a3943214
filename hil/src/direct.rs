//! The drive again without devices: the pictures and counts that were sent, in lockstep, at the drive's own stage times.
//!
//! The grids that the module recorded behind a real kernel's camera and bus must be those of this direct replay, its pictures
//! those that were sent, and its path that of the car.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use freespace::frame::{Camera, PixelFormat, RgbImage};
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer, WheelPort};
use freespace::segmentation::{Tile, TileConfig};
use freespace::space::Micros;
use freespace::track::{WheelConfig, WheelReading};
use freespace_platform::camera::replay::drive::{DriveFrames, RecordedDrive};
use freespace_platform::clock::MonotonicClock;
use freespace_platform::config::{Config, Wheels};
use freespace_platform::eval::{npy, trajectory};
use freespace_platform::runtime::memory::MemoryPlan;
use freespace_platform::runtime::{Devices, FrameReport, KeyFrameReport, Observer, Setup, run_recorded};
use freespace_platform::segmenter::{self, EngineChoice, Manifest, Segmenter};
use freespace_platform::wheels::{CandumpOptions, CandumpWheels, RecordedWheels, WheelDecoder};
use freespace_platform::world::{Sensor, SimCamera};

use crate::bench::{Bench, BenchError, Rig};
use crate::case::Seen;
use crate::drive::{Ending, finish};
use crate::feed::Sent;
use crate::module::Log;
use crate::promise::Blind;
use crate::road::{Road, yuyv};

/// Length of the drive.
const DRIVE: Duration = Duration::from_secs(12);
/// Agreement of the free cells, where bytes do not agree.
const IOU: f64 = 0.98;
/// The driver stamps a picture so soon after it was sent.
const LATEST_STAMP_MICROS: u64 = 30_000;
/// Error of the path's length.
const SCALE: f64 = 0.01;

/// Records a drive and compares.
pub(crate) fn case(rig: &Rig) -> Result<Seen, BenchError> {
    // Not into a folder of the host: User-Mode Linux stands still while the host writes.
    let record = std::env::temp_dir().join(format!("freespace-rig-{}", std::process::id()));
    let log = Log {
        folder: record.clone(),
        mcap: Some(record.with_extension("mcap")),
    };
    let bench = Bench::start(rig, &[], Some(&log))?;
    std::thread::sleep(DRIVE);
    let (road, start_micros) = (bench.road.clone(), bench.feed.start_micros);
    let logs = bench.feed.logs();
    let mut seen = finish(bench, Blind::default(), Ending::Well, Seen::default())?;
    let (sent, wheels) = (logs.pictures(), logs.wheels());
    let counts = rig.file("wheels.candump");
    std::fs::write(&counts, crate::listener::candump(&wheels, &rig.interface))?;

    let driven = trajectory::read(&record.join("trajectory.tum"))?;
    let stamps = micros_of(driven.stamps_s.as_deref().unwrap_or_default());
    scale(&road, start_micros, &stamps, &driven.poses, &mut seen);
    let drive = RecordedDrive::open(&record.with_extension("mcap"))?;
    let direct = replay(rig, &road, &drive, sent, &counts, &mut seen)?;
    compare(&record, &direct, &mut seen)?;
    for file in ["report.json", "trajectory.tum", "timing.csv"] {
        std::fs::copy(record.join(file), rig.file(file))?;
    }
    std::fs::remove_dir_all(&record)?;
    std::fs::remove_file(record.with_extension("mcap"))?;
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

/// Grids by capture stamp.
type Grids = BTreeMap<u64, Vec<i8>>;

fn replay(
    rig: &Rig,
    road: &Road,
    drive: &RecordedDrive,
    sent: Vec<Sent>,
    counts: &Path,
    seen: &mut Seen,
) -> Result<Grids, BenchError> {
    let (config, ..) = rig.config()?;
    let words = |error: &dyn std::error::Error| BenchError::Config(error.to_string());
    let Wheels::Can(can) = config.wheels() else {
        return Err(BenchError::Config(
            "[wheels] must have the source \"can\"".to_owned(),
        ));
    };
    let decoder = WheelDecoder::open(&can.dbc, &can.mapping()).map_err(|error| words(&error))?;
    let mut wheels =
        CandumpWheels::open(counts, &decoder, &CandumpOptions::default()).map_err(|error| words(&error))?;
    compare_counts(&mut wheels, drive, seen);
    let manifest = Manifest::load(&config.network.manifest).map_err(|error| words(&error))?;
    let network = segmenter::open(&manifest, EngineChoice::Auto, config.network.threads)
        .map_err(|error| words(&error))?;
    let strange = Arc::new(AtomicUsize::new(0));
    let camera = SentFrames {
        recorded: DriveFrames::as_driven(drive),
        painter: Painter::new(road),
        sent,
        own: Vec::new(),
        strange: Arc::clone(&strange),
    };
    // Those that arrived late arrive late again.
    let wheels = RecordedWheels::new(drive.wheels.clone());
    let mut setup = setup(rig, Box::new(camera), Some(Box::new(wheels)), network)?;
    setup.config.cadence = drive.drive().cadence();
    let mut collector = Collector::default();
    run_recorded(setup, drive.times(), &mut collector);
    let strange = strange.load(Ordering::Relaxed);
    seen.require(
        strange == 0,
        format!("{strange} of {} frames are not what was sent", drive.frames.len()),
    );
    Ok(collector.0)
}

/// What does not hold of the drive's readings: each is one that was sent, in order, none between the first and the last is
/// missing, and each was stamped when it was sent.
fn compare_counts(sent: &mut CandumpWheels, drive: &RecordedDrive, seen: &mut Seen) {
    let mut readings = Vec::new();
    sent.readings_until(Micros(u64::MAX), &mut |reading| readings.push(reading));
    let mut at = None;
    let (mut strange, mut missing, mut apart_micros) = (0, 0, 0);
    for recorded in &drive.wheels {
        let from = at.map_or(0, |at: usize| at + 1);
        let found = readings[from..]
            .iter()
            .position(|reading| unstamped(*reading) == unstamped(recorded.reading));
        let Some(ahead) = found else {
            strange += 1;
            continue;
        };
        missing += if at.is_some() { ahead } else { 0 };
        at = Some(from + ahead);
        let apart = readings[from + ahead]
            .stamp()
            .0
            .abs_diff(recorded.reading.stamp().0);
        apart_micros = apart_micros.max(apart);
    }
    seen.require(
        strange == 0,
        format!("{strange} wheel readings are not what was sent"),
    );
    seen.require(missing == 0, format!("{missing} wheel readings are missing"));
    seen.note(format!("wheel stamps {apart_micros} us apart at most"));
    seen.require(
        apart_micros < LATEST_STAMP_MICROS,
        format!("wheel stamps are {apart_micros} us from when they were sent"),
    );
}

/// The reading without the time at which it arrived.
const fn unstamped(reading: WheelReading) -> WheelReading {
    let stamp = Micros(0);
    match reading {
        WheelReading::Counts {
            counts, direction, ..
        } => WheelReading::Counts {
            stamp,
            counts,
            direction,
        },
        WheelReading::Speeds { mps, .. } => WheelReading::Speeds { stamp, mps },
    }
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
        slow: None,
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

/// Renders the road's pictures by their numbers.
struct Painter {
    road: Road,
    camera: SimCamera,
    picture: RgbImage,
}

impl Painter {
    fn new(road: &Road) -> Self {
        let camera = &road.camera;
        Self {
            picture: RgbImage::new(camera.width, camera.height),
            camera: SimCamera::new(camera, &Sensor::default()),
            road: road.clone(),
        }
    }

    /// The picture as a camera gives it, YUYV.
    fn paint(&mut self, number: u64, bytes: &mut Vec<u8>) {
        let seconds = self.road.picture_seconds(number);
        self.camera.render(&self.road.world, seconds, &mut self.picture);
        yuyv(self.picture.pixels(), bytes);
    }
}

/// Pictures by their numbers, each at its stamp.
pub(crate) struct Again {
    frames: std::vec::IntoIter<(u64, u64)>,
    painter: Painter,
    index: u64,
}

impl Again {
    /// Stamps, and the number of the picture behind each.
    pub(crate) fn new(road: &Road, frames: Vec<(u64, u64)>) -> Self {
        Self {
            frames: frames.into_iter(),
            painter: Painter::new(road),
            index: 0,
        }
    }
}

impl CameraPort for Again {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let Some((stamp, number)) = self.frames.next() else {
            return CameraAnswer::End;
        };
        buffer.index = self.index;
        self.index += 1;
        buffer.stamp = Micros(stamp);
        buffer.format = PixelFormat::Yuyv;
        let camera = &self.painter.road.camera;
        (buffer.width, buffer.height) = (camera.width, camera.height);
        self.painter.paint(number, &mut buffer.bytes);
        buffer.key_frame_wanted = false;
        CameraAnswer::Frame
    }
}

/// A recorded drive's frames with the pictures that were sent in place of those that came.
struct SentFrames {
    recorded: DriveFrames,
    painter: Painter,
    sent: Vec<Sent>,
    /// The picture that was sent.
    own: Vec<u8>,
    /// Frames that are not what was sent.
    strange: Arc<AtomicUsize>,
}

impl SentFrames {
    /// The last picture that was sent before a stamp.
    fn number(&self, stamp: Micros) -> Option<u64> {
        let after = self.sent.partition_point(|sent| sent.at_micros <= stamp.0);
        let sent = self.sent.get(after.checked_sub(1)?)?;
        (stamp.0 - sent.at_micros < LATEST_STAMP_MICROS).then_some(sent.picture)
    }
}

impl CameraPort for SentFrames {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let answer = self.recorded.next_frame(buffer);
        // A loopback device's first frame may be one that it had kept.
        if answer == CameraAnswer::Frame && buffer.index > 0 {
            if let Some(number) = self.number(buffer.stamp) {
                self.painter.paint(number, &mut self.own);
            } else {
                self.own.clear();
            }
            if self.own != buffer.bytes {
                self.strange.fetch_add(1, Ordering::Relaxed);
            }
            buffer.bytes.clone_from(&self.own);
        }
        answer
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
    seen.require_in_peace(iou >= IOU, format!("IoU with the direct replay is {iou:.4}"));
    Ok(())
}
