//! `freespace doctor`: the checks, the memory plan and the timer's histogram, for a reader or as JSON.

use std::io::IsTerminal as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use freespace::frame::{Camera, Lens};
use freespace::pipeline::{Cadence, PipelineConfig};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::segmentation::InputFiller;
use freespace::space::Micros;
use freespace::stage::Stage;
use serde::Serialize;

use super::demo::{SHIPPED, shipped};
use super::drive::{self, Network};
use super::{DoctorArgs, Failure};
use crate::clock::MonotonicClock;
use crate::config::{Config, ImageSize, Wheels};
use crate::doctor::{self, Check, Jitter, NetworkTiming, State, System};
use crate::runtime::memory::MemoryPlan;
use crate::runtime::{Devices, LiveRun, Setup};
use crate::segmenter::Segmenter;

/// All that was found.
#[derive(Serialize)]
struct Findings {
    config: String,
    checks: Vec<Check>,
    memory_plan: MemoryPlan,
    total_bytes: u64,
    network: Option<NetworkTiming>,
    jitter: Option<Jitter>,
}

/// Looks at this computer, as a run of the configuration would find it.
///
/// # Errors
/// A bad configuration; a check that fails; no thread to check with.
pub fn run(args: &DoctorArgs) -> Result<(), Failure> {
    let path = args.config.clone().unwrap_or_else(|| shipped(SHIPPED));
    let config = Config::load(&path)?;
    let findings = examine(&path, &config, args.jitter_seconds)?;
    if args.json {
        // Findings always have a JSON form.
        println!("{}", serde_json::to_string_pretty(&findings).unwrap_or_default());
    } else {
        print!("{}", text_of(&findings));
    }
    let failing: Vec<&str> = (findings.checks.iter())
        .filter(|check| check.state == State::Fails)
        .map(|check| check.name)
        .collect();
    if failing.is_empty() {
        return Ok(());
    }
    Err(Failure::unmet(format!(
        "the promise cannot be kept on this computer as it is: {}",
        failing.join(", ")
    )))
}

fn examine(path: &Path, config: &Config, jitter_seconds: f64) -> Result<Findings, Failure> {
    let no_thread = |error: std::io::Error| Failure::unmet(format!("a thread could not be started: {error}"));
    let system = System::default();
    let real_time = config.real_time();
    let pipeline = pipeline_config(path, config);
    let slices = pipeline.slices;
    let mut network = drive::open_network(config);
    let network_check = match &mut network {
        Ok(network) => {
            let slice = slices.end(Stage::Segmentation, Micros(0), Micros(0)).0;
            let runs = runs_of_a_key_frame(&*network.segmenter, config, &pipeline.camera);
            doctor::network(&mut *network.segmenter, runs, slice, &real_time).map_err(no_thread)?
        }
        Err(failure) => {
            let fix = "give a manifest whose model is there, in [network]; run scripts/fetch-onnxruntime.sh";
            (Check::fails("network", failure.to_string(), fix), None)
        }
    };
    // What a run holds but for its devices; without a network there is no run.
    let held = network
        .ok()
        .map(|network| LiveRun::prepare(setup(pipeline, network, config), &Arc::default()))
        .transpose()
        .map_err(|error| Failure::unmet(error.to_string()))?;
    let mut held = held;
    let mut nothing = MemoryPlan::new();
    let plan = held.as_mut().map_or(&mut nothing, LiveRun::plan);
    let lock = doctor::memory_lock(&real_time, plan);
    let is_locked = lock.state == State::Ok;
    let mut checks = vec![
        doctor::kernel(&system),
        doctor::priorities(&real_time).map_err(no_thread)?,
        lock,
        doctor::throttling(&system),
        doctor::governor(&system),
        doctor::interrupts(&system, &real_time),
        doctor::huge_pages(&system),
        doctor::swap(&system, is_locked),
    ];
    let (network, timing) = network_check;
    checks.push(network);
    checks.push(doctor::camera(&system));
    if let Some((device, size)) = config.camera.device.as_ref().zip(config.camera.size()) {
        let rate_hz = config.camera.frame_rate_hz;
        checks.push(doctor::camera_device(&system, device, size, rate_hz));
    }
    checks.push(doctor::can(&system, doctor::bitrate_by_ip));
    checks.extend(doctor::can_interfaces(
        &system,
        config,
        doctor::bitrate_by_ip,
        doctor::can_stamps,
    ));
    checks.push(doctor::shared_memory(&system, &config.sharing()));
    let jitter = (jitter_seconds > 0.0)
        .then(|| {
            if std::io::stderr().is_terminal() {
                eprintln!("measuring the timer for {jitter_seconds} s ...");
            }
            doctor::measure_jitter(&real_time, Duration::from_secs_f64(jitter_seconds))
        })
        .transpose()
        .map_err(|error| Failure::unmet(error.to_string()))?;
    checks.extend(
        jitter
            .as_ref()
            .map(|jitter| jitter.check(slices.deadline_micros - slices.send_by_micros)),
    );
    Ok(Findings {
        config: path.display().to_string(),
        checks,
        total_bytes: plan.total_bytes(),
        memory_plan: plan.clone(),
        network: timing,
        jitter,
    })
}

/// How often the network runs for a key frame: once a tile, the far one among them.
fn runs_of_a_key_frame(segmenter: &dyn Segmenter, config: &Config, camera: &Camera) -> usize {
    let tiles = drive::tiles(config, camera);
    InputFiller::new(segmenter.shape(), camera.width, camera.height, &tiles)
        .tiles()
        .len()
}

/// A run without devices.
fn setup(config: PipelineConfig, network: Network, of: &Config) -> Setup {
    let tiles = drive::tiles(of, &config.camera);
    Setup {
        config,
        devices: Devices {
            camera: Box::new(NoCamera),
            wheels: None,
            segmenter: network.segmenter,
            tiles,
            sinks: Vec::new(),
        },
        real_time: network.real_time,
        plan: network.plan,
        lacks: network.lacks,
        clock: MonotonicClock::default(),
        slow: None,
    }
}

/// Stands where a camera would be.
struct NoCamera;

impl CameraPort for NoCamera {
    fn next_frame(&mut self, _buffer: &mut FrameBuffer) -> CameraAnswer {
        CameraAnswer::End
    }
}

/// The pipeline of a configuration; where its lens stands in a recording's folder, any lens needs the same memory.
#[expect(clippy::cast_precision_loss, reason = "image sizes")]
fn pipeline_config(path: &Path, config: &Config) -> PipelineConfig {
    let ImageSize { width, height } = config.camera.size().unwrap_or(ImageSize {
        width: 1280,
        height: 720,
    });
    let camera = config.camera_for(path, width, height).unwrap_or_else(|_| Camera {
        lens: Lens::pinhole(
            width as f64,
            width as f64,
            0.5 * width as f64,
            0.5 * height as f64,
        ),
        width,
        height,
        mount: config.camera.mount,
    });
    let odometer = match config.wheels() {
        Wheels::None => None,
        Wheels::Sim(odometer) => Some(odometer),
        Wheels::Can(wheels) => Some(wheels.odometer),
    };
    drive::pipeline_config(config, camera, odometer, Cadence::Micros(500_000))
}

fn text_of(findings: &Findings) -> String {
    use std::fmt::Write as _;
    let mut text = format!("freespace doctor, {}\n\n", findings.config);
    for check in &findings.checks {
        // A `String` takes all that is written to it, here and below.
        let _ = writeln!(
            text,
            "{:<8} {:<16} {}",
            check.state.name(),
            check.name,
            check.seen
        );
        if let Some(fix) = &check.fix {
            let _ = writeln!(text, "{:<8} {:<16} fix: {fix}", "", "");
        }
    }
    let _ = write!(text, "\nmemory plan\n{}", findings.memory_plan);
    if let Some(jitter) = &findings.jitter {
        let _ = write!(
            text,
            "\ntimer: {} wake-ups in {} s at {}\n  p50 {:.0} us  p99 {:.0} us  p99.9 {:.0} us  latest {:.0} us\n{}",
            jitter.wake_ups,
            jitter.seconds,
            jitter.scheduling,
            jitter.p50_micros,
            jitter.p99_micros,
            jitter.p99_9_micros,
            jitter.max_micros,
            jitter.table()
        );
    }
    let count = |state: State| {
        (findings.checks.iter())
            .filter(|check| check.state == state)
            .count()
    };
    let _ = writeln!(
        text,
        "\n{} ok, {} to look at, {} in the way",
        count(State::Ok),
        count(State::Warning),
        count(State::Fails)
    );
    text
}
