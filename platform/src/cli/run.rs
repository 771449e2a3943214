//! `freespace run`: the camera and the bus of this computer, until it is told to end.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use freespace::frame::Camera;
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::{SinkPort, WheelPort};
use freespace::track::WheelConfig;

use super::drive::{self, DriveLog, Ports, Progress, Recorded, Recorder, ViewFeed, Watch};
use super::{Failure, Pace, RunArgs, table, terminal};
use crate::bad_input::BadInput;
use crate::camera::v4l2::{CameraEvents, V4l2Camera};
use crate::can::{self, CanDevices, CanListener, CanPlan};
use crate::clock::MonotonicClock;
use crate::config::{Config, DeviceSection, ImageSize, Wheels};
use crate::runtime::{RunSummary, Setup};
use crate::sink::recording::{Recording, Report, RunTitle};
use crate::statistics::DriveStatistics;

/// Drives on this computer's devices until SIGTERM or SIGINT, or for the seconds that were asked for.
///
/// # Errors
/// A bad configuration, devices that cannot be what it says, a folder that cannot be written to. A device that is absent is
/// waited for.
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let config = Config::load(&args.config)?;
    let (device, size) = camera_device(&config)?;
    let camera = config.camera_for(&args.config, size.width, size.height)?;
    // Everything that may be refused is tried before anything is written or started.
    let mut network = drive::open_network(&config)?;
    let mut frames = V4l2Camera::open(device, size, config.camera.frame_rate_hz).map_err(BadInput::from)?;
    let mut watch = Watch::new(Progress::new(None), DriveStatistics::new());
    if let Some(mode) = frames.mode() {
        terminal::tell(format_args!("{}: {mode}", device.path.display()));
    }
    if let Some(events) = frames.take_events() {
        watch.listen(1, Box::new(camera_lines(events)));
    }
    let mut bus = open_bus(&config, &mut watch)?;
    bus.sinks.extend(drive::sinks(&config, Pace::Real, &mut network)?);
    let engine = network.segmenter.name().to_owned();
    let pipeline = pipeline(&config, camera, bus.odometer);
    let mut log = DriveLog::open(
        &args.mcap,
        Pace::Real,
        &config,
        &pipeline,
        &mut network.plan,
        &mut watch,
    )?;
    watch.show((network.plan).measure_library("view", || ViewFeed::open(&config, &pipeline, Pace::Real)));
    let ports = Ports {
        camera: Box::new(frames),
        wheels: bus.wheels,
        sinks: bus.sinks,
    };
    let setup = Setup {
        clock: MonotonicClock::of_devices(),
        ..network.into_setup(&config, pipeline.clone(), ports, &mut log)
    };
    let drive = Drive {
        args,
        config: &config,
        pipeline: &pipeline,
        log: &log,
    };
    let report = drive.run(setup, watch)?;
    log.finish();
    table::print(&report, &engine, args.record.as_deref(), args.json);
    Ok(())
}

fn camera_device(config: &Config) -> Result<(&DeviceSection, ImageSize), Failure> {
    match (&config.camera.device, config.camera.size()) {
        (Some(device), Some(size)) => Ok((device, size)),
        _ => Err(BadInput::of_file(
            &config.path,
            "names no camera of this computer",
            "add [camera.device] with `path = \"/dev/video0\"`, and width and height to [camera]; config/car.toml shows it",
        )
        .into()),
    }
}

/// What the bus gives a run.
#[derive(Default)]
struct Bus {
    wheels: Option<Box<dyn WheelPort + Send>>,
    odometer: Option<WheelConfig>,
    sinks: Vec<Box<dyn SinkPort + Send>>,
}

fn open_bus(config: &Config, watch: &mut Watch) -> Result<Bus, Failure> {
    let odometer = match config.wheels() {
        Wheels::Can(wheels) if wheels.interface.is_some() => Some(wheels.odometer),
        Wheels::None => None,
        Wheels::Can(_) | Wheels::Sim(_) => {
            return Err(BadInput::of_file(
                &config.path,
                "[wheels] names no interface of this computer",
                "set `source = \"can\"` and `interface = \"can0\"` in [wheels], or `source = \"none\"`",
            )
            .into());
        }
    };
    let Some(plan) = CanPlan::of(config).map_err(Failure::bad_input)? else {
        return Ok(Bus::default());
    };
    if let Some(out) = &plan.out {
        terminal::tell(format_args!(
            "{}: {out}",
            out.interface.as_deref().unwrap_or_default()
        ));
    }
    let CanDevices {
        wheels,
        sink,
        listener,
        ..
    } = can::open(plan).map_err(Failure::bad_input)?;
    watch.listen(listener.interfaces().len(), Box::new(can_lines(listener)));
    Ok(Bus {
        wheels: wheels.map(|port| -> Box<dyn WheelPort + Send> { port }),
        odometer,
        sinks: sink
            .into_iter()
            .map(|port| -> Box<dyn SinkPort + Send> { port })
            .collect(),
    })
}

fn camera_lines(mut events: CameraEvents) -> impl FnMut() -> Option<(usize, String)> {
    let device = events.device().display().to_string();
    move || Some((0, format!("{device}: {}", events.next_event()?)))
}

fn can_lines(mut listener: CanListener) -> impl FnMut() -> Option<(usize, String)> {
    move || {
        let trace = listener.next_event()?;
        Some((trace.interface, listener.line(&trace)))
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "an interval of at most 10 s"
)]
fn pipeline(config: &Config, camera: Camera, odometer: Option<WheelConfig>) -> PipelineConfig {
    let period_micros = (config.key_frames.interval_s * 1e6) as u64;
    drive::pipeline_config(config, camera, odometer, Cadence::Micros(period_micros))
}

struct Drive<'a> {
    args: &'a RunArgs,
    config: &'a Config,
    pipeline: &'a PipelineConfig,
    log: &'a DriveLog,
}

impl Drive<'_> {
    fn run(&self, setup: Setup, watch: Watch) -> Result<Report, Failure> {
        let stop = Arc::new(AtomicBool::new(false));
        match &self.args.record {
            Some(folder) => {
                let title = RunTitle {
                    title: format!("freespace run {}", self.config.path.display()),
                    deadline_ms: self.config.deadline.publish_ms,
                    ..RunTitle::default()
                };
                let recording = Recording::create(folder, title)?;
                let mut recorder = Recorder::new(recording, self.pipeline, BTreeMap::new(), watch);
                let summary = self.live(setup, &stop, &mut recorder)?;
                let Recorded {
                    recording,
                    counts,
                    statistics,
                } = recorder.finish(&summary)?;
                Ok(recording.finish(&counts, &statistics, None)?)
            }
            None => {
                let mut watch = watch;
                let summary = self.live(setup, &stop, &mut watch)?;
                let (counts, statistics) = watch.finish(&summary);
                Ok(Report::new(&RunTitle::default(), &counts, &statistics, None))
            }
        }
    }

    fn live(
        &self,
        setup: Setup,
        stop: &Arc<AtomicBool>,
        observer: &mut dyn crate::runtime::Observer,
    ) -> Result<RunSummary, Failure> {
        if let Some(seconds) = self.args.seconds {
            stop_after(seconds, Arc::clone(stop))?;
        }
        drive::run_live(setup, stop, &mut self.log.noted(observer))
    }
}

/// The thread is forgotten: it ends with the process where the drive ends first.
fn stop_after(seconds: f64, stop: Arc<AtomicBool>) -> Result<(), Failure> {
    let thread = std::thread::Builder::new()
        .name("stop".to_owned())
        .spawn(move || {
            std::thread::sleep(std::time::Duration::from_secs_f64(seconds));
            stop.store(true, std::sync::atomic::Ordering::Relaxed);
        });
    thread
        .map(drop)
        .map_err(|error| Failure::unmet(format!("a thread could not be started: {error}")))
}
