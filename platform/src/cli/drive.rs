//! What `demo` and `replay` share: the pipeline built from a configuration, and its results recorded.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use freespace::frame::Camera;
use freespace::grid::GridConfig;
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::Clock as _;
use freespace::segmentation::{Tile, TileConfig};
use freespace::track::WheelConfig;
use nalgebra::{Point3, Vector3};

use super::memory_watch::MemoryWatch;
use super::service::Service;
use super::{Failure, Pace};
use crate::bad_input::BadInput;
use crate::clock::MonotonicClock;
use crate::config::Config;
use crate::eval::grid::GridLayout;
use crate::runtime::memory::MemoryPlan;
use crate::runtime::rights::{self, Lack, RealTimeConfig, ThreadRole};
use crate::runtime::supervision::stop_on_signals;
use crate::runtime::{self, FrameReport, KeyFrameReport, Observer, RunSummary, Setup, Start, Status, Trace};
use crate::segmenter::{self, EngineChoice, Manifest, Segmenter};
use crate::sink::recording::{
    FrameRecord, ImageView, KeyFrameRecord, Recording, RecordingError, RunCounts, Upsampler,
};
use crate::statistics::{DriveStatistics, Drops, Publication};

/// The pipeline's settings.
pub(super) fn pipeline_config(
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

/// The configured network, and what opening it took.
pub(super) struct Network {
    pub(super) segmenter: Box<dyn Segmenter>,
    pub(super) real_time: RealTimeConfig,
    pub(super) plan: MemoryPlan,
    pub(super) lacks: Vec<Lack>,
}

/// Opens the configured network; the threads of its library become as real-time as its own.
///
/// # Errors
/// A manifest or model that is missing or wrong, or no engine for it.
pub(super) fn open_network(config: &Config) -> Result<Network, Failure> {
    let manifest = Manifest::load(&config.network.manifest).map_err(Failure::bad_input)?;
    let real_time = config.real_time();
    let mut plan = MemoryPlan::new();
    let (opened, lacks) = rights::adopt_new_threads(ThreadRole::Network, &real_time, || {
        plan.measure_library("network", || {
            segmenter::open(&manifest, EngineChoice::Auto, config.network.threads)
        })
    });
    Ok(Network {
        segmenter: opened.map_err(Failure::bad_input)?,
        real_time,
        plan,
        lacks: lacks.into_iter().collect(),
    })
}

/// The configured tiles.
pub(super) fn tiles(config: &Config, camera: &Camera) -> TileConfig {
    TileConfig {
        count: Some(config.network.tiles),
        far: config.network.far_tile.then(|| Tile::far(camera)),
    }
}

/// Runs the pipeline at a pace; at real pace until SIGTERM or SIGINT at the latest.
///
/// # Errors
/// A thread that could not be started, hung, or panicked too often.
pub(super) fn run(setup: Setup, pace: Pace, observer: &mut dyn Observer) -> Result<RunSummary, Failure> {
    if pace == Pace::Fast {
        return Ok(runtime::run_in_lockstep(setup, observer));
    }
    let stop = Arc::new(AtomicBool::new(false));
    let internal = |error: &dyn std::error::Error| Failure::Internal(miette::miette!("{error}"));
    stop_on_signals(&stop).map_err(|error| internal(&error))?;
    runtime::run_live(setup, &stop, observer).map_err(|error| internal(&error))
}

/// Where the cells of a grid lie.
pub(super) fn layout(config: &GridConfig) -> GridLayout {
    let (rows, columns, cell_m) = config.size();
    let cell_m = f64::from(cell_m);
    #[expect(clippy::cast_precision_loss, reason = "columns of a grid")]
    let right_m = -0.5 * columns as f64 * cell_m;
    GridLayout {
        rows,
        columns,
        cell_m,
        origin_in_vehicle_m: [0.0, right_m],
    }
}

/// Writes what a run gives, and counts what its report needs; its memory does not grow with the run.
pub(super) struct Recorder {
    recording: Recording,
    statistics: DriveStatistics,
    camera: Camera,
    layout: GridLayout,
    names: BTreeMap<u64, String>,
    /// Stands in for the picture of a key frame that a fallback answered, one byte a pixel.
    black: Box<[u8]>,
    upsampler: Upsampler,
    /// Road of the last key frame, at the size of the camera.
    mask: Box<[u8]>,
    tracked_frames: u64,
    error: Option<RecordingError>,
    progress: Progress,
    service: Service,
    memory: Option<MemoryWatch>,
}

/// What is left of a recorder when its run is over.
pub(super) struct Recorded {
    pub(super) recording: Recording,
    pub(super) counts: RunCounts,
    pub(super) statistics: DriveStatistics,
}

impl Recorder {
    /// A recorder for a run of `config`; frames without a name are named by their number.
    pub(super) fn new(
        recording: Recording,
        config: &PipelineConfig,
        names: BTreeMap<u64, String>,
        progress: Progress,
    ) -> Self {
        let size = (config.camera.width, config.camera.height);
        Self {
            recording,
            statistics: DriveStatistics::new(),
            camera: config.camera,
            layout: layout(&config.grid),
            names,
            black: vec![0; size.0 * size.1].into_boxed_slice(),
            upsampler: Upsampler::new(config.working_size, size),
            mask: vec![0; size.0 * size.1].into_boxed_slice(),
            tracked_frames: 0,
            error: None,
            progress,
            service: Service::from_environment(),
            memory: None,
        }
    }

    pub(super) const fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// Name of a frame.
    fn name(&self, index: u64) -> String {
        self.names
            .get(&index)
            .cloned()
            .unwrap_or_else(|| format!("{index:06}"))
    }

    /// Labels of the key frame seen last, at the size of the camera, 1 = road.
    pub(super) const fn mask(&self) -> &[u8] {
        &self.mask
    }

    /// Writes what is known to be true of a key frame.
    pub(super) fn record_truth(&mut self, index: u64, cells: &[i8], mask: &[u8]) {
        let size = (self.camera.width, self.camera.height);
        let written = self
            .recording
            .truth(&self.name(index), &self.layout, cells, mask, size);
        self.note(written);
    }

    /// Writes a frame's true pose.
    pub(super) fn record_true_pose(&mut self, frame: &FrameRecord) {
        let written = self.recording.true_pose(frame);
        self.note(written);
    }

    /// Keeps the first fault: a run goes on, and fails at its end.
    fn note(&mut self, written: Result<(), RecordingError>) {
        if self.error.is_none() {
            self.error = written.err();
        }
    }

    /// The recording and its counts, or the first fault that it met.
    pub(super) fn finish(mut self, summary: &RunSummary) -> Result<Recorded, Failure> {
        self.progress.end();
        if let Some(error) = self.error {
            return Err(error.into());
        }
        self.statistics.set_drops(Drops {
            unobserved: Some(summary.unobserved),
            ..Drops::default()
        });
        let counts = RunCounts {
            key_frames: summary.key_frames,
            deadline_misses: summary.deadline_misses,
            frames: summary.frames,
            tracked_frames: self.tracked_frames,
            dropped_frames: summary.dropped_frames,
            allocations_after_start: runtime::allocation::is_installed()
                .then_some(summary.allocations_after_start),
            peak_rss_mb: peak_rss_mb(),
            memory: (self.memory.as_ref()).map(|memory| memory.finish(summary.page_faults)),
            restarts: summary.restarts,
        };
        Ok(Recorded {
            recording: self.recording,
            counts,
            statistics: self.statistics,
        })
    }

    #[expect(clippy::cast_precision_loss, reason = "milliseconds")]
    fn record(&mut self, report: &KeyFrameReport<'_>) -> Result<(), RecordingError> {
        let output = report.output;
        let name = self.name(report.index);
        let outlines = self.outlines(report);
        let (channels, bytes) = report
            .job
            .map_or((1, &*self.black), |job| (3, job.image.pixels()));
        self.recording.key_frame(&KeyFrameRecord {
            name: &name,
            stamp: output.stamp,
            image: ImageView {
                width: self.camera.width,
                height: self.camera.height,
                channels,
                bytes,
            },
            mask: &self.mask,
            layout: self.layout,
            cells: &output.grid.occupancy,
            world_from_vehicle: self.camera.world_from_vehicle(&output.world_from_camera),
            level: output.level.name(),
            deadline_met: !report.output.is_miss(),
            publish_latency_ms: report.output.latency_micros as f64 * 1e-3,
            times: output.times,
            can_frames: &output.can_frames,
            outlines: &outlines,
        })
    }

    /// Edges of the obstacle boxes in the picture.
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    fn outlines(&self, report: &KeyFrameReport<'_>) -> Vec<[(f32, f32); 2]> {
        let camera_from_world = report.output.world_from_camera.inverse();
        let mut segments = Vec::new();
        for obstacle in &report.output.priors.boxes {
            let corner = |bits: usize| {
                let sign = |axis: usize| if bits >> axis & 1 == 1 { 1.0 } else { -1.0 };
                let half = &obstacle.half_m;
                let local = Vector3::new(sign(0) * half.x, sign(1) * half.y, sign(2) * half.z);
                let point: Point3<f64> = camera_from_world * (obstacle.centre + obstacle.axes * local);
                if point.z < 0.3 {
                    return None;
                }
                self.camera
                    .lens
                    .project(&point.coords)
                    .map(|pixel| (pixel.x as f32, pixel.y as f32))
            };
            for from in 0..8 {
                for axis in 0..3 {
                    let to = from | 1 << axis;
                    if to != from
                        && let (Some(a), Some(b)) = (corner(from), corner(to))
                    {
                        segments.push([a, b]);
                    }
                }
            }
        }
        segments
    }
}

impl Observer for Recorder {
    fn started(&mut self, start: &Start<'_>) {
        self.service.started(start);
        self.memory = Some(MemoryWatch::new(start.plan));
    }

    fn frame(&mut self, report: &FrameReport) {
        use freespace::health::TrackingState;
        // The first frame has nothing to be tracked against: its pose is the origin.
        let is_tracked =
            report.outcome.estimate.state != TrackingState::DeadReckoning || self.tracked_frames == 0;
        self.tracked_frames += u64::from(is_tracked);
        self.statistics.frame(report.outcome.estimate.state);
        self.statistics.frame_micros(report.outcome.micros);
        let written = self.recording.frame(&FrameRecord {
            index: usize::try_from(report.index).unwrap_or(usize::MAX),
            stamp: report.stamp,
            world_from_camera: report.outcome.estimate.world_from_camera,
        });
        self.note(written);
        self.progress.frame(report.index);
    }

    fn publication(&mut self, publication: &Publication) {
        self.statistics.publication(publication);
        self.progress.publication(publication);
    }

    fn trace(&mut self, trace: &Trace) {
        self.progress.interrupt();
        eprintln!("{:.3} s: {}", trace.at.0 as f64 * 1e-6, trace.event);
    }

    fn status(&mut self, status: &Status) {
        self.service.status(status, &self.statistics);
        if let Some(memory) = &mut self.memory {
            memory.look();
        }
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        // What answers for an instant without a frame has no picture and no name; it is in the statistics.
        if !report.output.has_frame {
            return;
        }
        self.upsampler.upsample(&report.output.labels, &mut self.mask);
        if self.error.is_none() {
            self.error = self.record(report).err();
        }
    }
}

/// One line on standard error that is written over again, twice a second; nothing where that is no terminal.
pub(super) struct Progress {
    frames: usize,
    clock: MonotonicClock,
    shown_micros: u64,
    key_frames: u64,
    misses: u64,
    is_shown: bool,
}

impl Progress {
    /// For a run of `frames` frames.
    pub(super) fn new(frames: usize) -> Self {
        use std::io::IsTerminal as _;
        Self {
            frames,
            clock: MonotonicClock::default(),
            shown_micros: 0,
            key_frames: 0,
            misses: 0,
            is_shown: std::io::stderr().is_terminal(),
        }
    }

    fn publication(&mut self, publication: &Publication) {
        self.key_frames += 1;
        self.misses += u64::from(publication.is_miss);
    }

    /// Makes room for a line of its own.
    fn interrupt(&self) {
        self.end();
    }

    fn frame(&mut self, index: u64) {
        let now = self.clock.now().0;
        if self.is_shown && now > self.shown_micros + 500_000 {
            self.shown_micros = now;
            eprint!(
                "\rframe {:>5} of {}   key frames {}   misses {} ",
                index + 1,
                self.frames,
                self.key_frames,
                self.misses
            );
        }
    }

    fn end(&self) {
        if self.is_shown {
            eprint!("\r{:78}\r", "");
        }
    }
}

/// A folder to write to must not be the one that is read.
pub(super) fn check_apart(source: &Path, out: &Path) -> Result<(), BadInput> {
    let same = matches!((source.canonicalize(), out.canonicalize()), (Ok(a), Ok(b)) if a == b);
    if same {
        return Err(BadInput::of_file(
            out,
            "is the folder that is replayed",
            "give another folder with --out",
        ));
    }
    Ok(())
}

/// Largest resident memory, as the kernel counts it.
fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes / 1024.0)
}
