//! What `run`, `demo` and `replay` share: the pipeline built from a configuration, watched, and its results recorded.

mod calm;
mod log;
mod progress;
mod recorder;
mod view;
mod watch;

pub(in crate::cli) use log::DriveLog;
pub(in crate::cli) use progress::Progress;
pub(in crate::cli) use recorder::{Recorded, Recorder};
pub(in crate::cli) use view::ViewFeed;
pub(in crate::cli) use watch::Watch;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use freespace::emit::FreeSpaceMessage;
use freespace::frame::Camera;
use freespace::grid::GridConfig;
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::{CameraPort, SinkPort, WheelPort};
use freespace::segmentation::{Tile, TileConfig};
use freespace::track::WheelConfig;

use super::{Failure, Pace, terminal};
use crate::bad_input::BadInput;
use crate::clock::MonotonicClock;
use crate::config::{Config, Sharing};
use crate::eval::grid::GridLayout;
use crate::runtime::memory::MemoryPlan;
use crate::runtime::rights::{self, Lack, RealTimeConfig, ThreadRole};
use crate::runtime::supervision::{end_at_once, stop_on_signals};
use crate::runtime::{self, Devices, Observer, RunError, RunSummary, Setup};
use crate::segmenter::{self, EngineChoice, Manifest, Segmenter};
use crate::sink::shared_memory::{Opened, SharedMemorySink};
use crate::statistics::DriveStatistics;

/// Exit code of a process that must be started anew: an internal failure.
const HUNG: i32 = 1;

/// The pipeline's settings.
pub(in crate::cli) fn pipeline_config(
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
pub(in crate::cli) struct Network {
    /// SHA-256 of the model's file.
    pub(in crate::cli) sha256: String,
    pub(in crate::cli) segmenter: Box<dyn Segmenter>,
    pub(in crate::cli) real_time: RealTimeConfig,
    pub(in crate::cli) plan: MemoryPlan,
    pub(in crate::cli) lacks: Vec<Lack>,
}

/// Opens the configured network; the threads of its library become as real-time as its own.
///
/// # Errors
/// A manifest or model that is missing or wrong, or no engine for it.
pub(in crate::cli) fn open_network(config: &Config) -> Result<Network, Failure> {
    let manifest = Manifest::load(&config.network.manifest).map_err(Failure::bad_input)?;
    let real_time = config.real_time();
    let mut plan = MemoryPlan::new();
    // Done first in `main`; once more, to hear whether it was refused.
    let unsettled = rights::settle_allocator().err();
    let (opened, lacks) = rights::adopt_new_threads(ThreadRole::Network, &real_time, || {
        plan.measure_library("network", || {
            segmenter::open(&manifest, EngineChoice::Auto, config.network.threads)
        })
    });
    Ok(Network {
        sha256: manifest.sha256,
        segmenter: opened.map_err(Failure::bad_input)?,
        real_time,
        plan,
        lacks: unsettled.into_iter().chain(lacks).collect(),
    })
}

/// What a run is connected to.
pub(in crate::cli) struct Ports {
    pub(in crate::cli) camera: Box<dyn CameraPort + Send>,
    pub(in crate::cli) wheels: Option<Box<dyn WheelPort + Send>>,
    pub(in crate::cli) sinks: Vec<Box<dyn SinkPort + Send>>,
}

impl Network {
    /// A run of this network with these ports, which `log` records where it does; its times begin now.
    pub(in crate::cli) fn into_setup(
        self,
        config: &Config,
        pipeline: PipelineConfig,
        ports: Ports,
        log: &mut DriveLog,
    ) -> Setup {
        let devices = log.tap(Devices {
            camera: ports.camera,
            wheels: ports.wheels,
            segmenter: self.segmenter,
            tiles: tiles(config, &pipeline.camera),
            sinks: ports.sinks,
        });
        Setup {
            config: pipeline,
            devices,
            real_time: self.real_time,
            plan: self.plan,
            lacks: self.lacks,
            clock: MonotonicClock::default(),
            slow: None,
        }
    }
}

/// The configured tiles.
pub(in crate::cli) fn tiles(config: &Config, camera: &Camera) -> TileConfig {
    TileConfig {
        count: Some(config.network.tiles),
        far: config.network.far_tile.then(|| Tile::far(camera)),
    }
}

/// The configured sinks of a run at a pace; shared memory is for drives at real pace alone.
///
/// # Errors
/// Shared memory that the configuration demands, and that cannot be had.
pub(in crate::cli) fn sinks(
    config: &Config,
    pace: Pace,
    network: &mut Network,
) -> Result<Vec<Box<dyn SinkPort + Send>>, Failure> {
    let (sharing, is_required) = match config.sharing() {
        Sharing::Off => return Ok(Vec::new()),
        _ if pace == Pace::Fast => return Ok(Vec::new()),
        Sharing::Wanted(sharing) => (sharing, false),
        Sharing::Required(sharing) => (sharing, true),
    };
    let (rows, columns, _) = config.grid.size();
    let message_bytes = FreeSpaceMessage::encoded_len(rows * columns);
    let real_time = network.real_time;
    let opened = (network.plan).measure_library("sharing thread", || {
        SharedMemorySink::open(&sharing, message_bytes, &real_time)
    });
    match opened {
        Ok(Opened { sink, lacks }) => {
            network.lacks.extend(lacks);
            Ok(vec![Box::new(sink)])
        }
        Err(error) if is_required => Err(Failure::unmet(format!(
            "shared memory `{}`: {error}",
            sharing.name
        ))),
        Err(error) => {
            crate::cli::terminal::tell(format_args!(
                "freespace: nothing is published in shared memory: {error}"
            ));
            Ok(Vec::new())
        }
    }
}

/// Where a run at a pace is counted.
pub(in crate::cli) fn statistics(pace: Pace) -> DriveStatistics {
    match pace {
        Pace::Real => DriveStatistics::new(),
        Pace::Fast => DriveStatistics::untimed(),
    }
}

/// Runs the pipeline at a pace; at real pace until SIGTERM or SIGINT at the latest.
///
/// # Errors
/// A thread that could not be started, hung, or panicked too often.
pub(in crate::cli) fn run(
    setup: Setup,
    pace: Pace,
    observer: &mut dyn Observer,
) -> Result<RunSummary, Failure> {
    if pace == Pace::Fast {
        return Ok(runtime::run_in_lockstep(setup, observer));
    }
    run_live(setup, &Arc::new(AtomicBool::new(false)), observer)
}

/// Runs at real pace until `stop`, SIGTERM or SIGINT.
///
/// # Errors
/// A thread that could not be started, hung, or panicked too often.
pub(in crate::cli) fn run_live(
    setup: Setup,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
) -> Result<RunSummary, Failure> {
    let internal = |error: &dyn std::error::Error| Failure::Internal(miette::miette!("{error}"));
    let request = stop_on_signals(stop).map_err(|error| internal(&error))?;
    runtime::hush_real_time_panics();
    let mut summary = runtime::run_live(setup, stop, observer).map_err(|error| {
        if let RunError::Hung(_) = error {
            // The hanging thread would meet the libraries' destructors at an ordinary end.
            terminal::tell(format_args!("freespace: {error}"));
            end_at_once(HUNG);
        }
        internal(&error)
    })?;
    summary.is_cut_short = request.is_made();
    Ok(summary)
}

/// Where the cells of a grid lie.
pub(in crate::cli) fn layout(config: &GridConfig) -> GridLayout {
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

/// A folder to write to must not be the one that is read.
pub(in crate::cli) fn check_apart(source: &Path, out: &Path) -> Result<(), BadInput> {
    let same = matches!((source.canonicalize(), out.canonicalize()), (Ok(a), Ok(b)) if a == b);
    if same {
        return Err(BadInput::of_file(
            out,
            "is what is replayed",
            "give another folder with --out",
        ));
    }
    Ok(())
}
