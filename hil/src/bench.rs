//! One drive on the bench: the road fed to the devices, the module running on them, the bus listened to.

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use freespace::frame::Camera;
use freespace::health::Faults;
use freespace::track::WheelConfig;
use freespace_platform::bad_input::BadInput;
use freespace_platform::config::{Config, Wheels};
use freespace_platform::world::Slip;

use crate::drive::names;
use crate::feed::{Feed, FeedError};
use crate::listener::{Heard, Listener, candump};
use crate::module::{Installation, Log, Module};
use crate::road::Road;

/// How long the module may take from its start to the first good answer.
const TO_DRIVE: Duration = Duration::from_secs(15);

/// What the bench is made of.
#[derive(Clone, Debug)]
pub(crate) struct Rig {
    pub(crate) installation: Installation,
    /// V4L2 device that the module reads and the rig writes.
    pub(crate) device: PathBuf,
    /// CAN interface of the module.
    pub(crate) interface: String,
    /// Folder of the case's own files.
    pub(crate) folder: PathBuf,
    pub(crate) seed: u64,
    /// The road's pictures, painted before.
    pub(crate) tape: Option<PathBuf>,
    /// Whether the kernel is the rig's own: clocks may be stepped and modules unloaded.
    pub(crate) owns_kernel: bool,
}

/// Why a case could not be run.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BenchError {
    #[error("{0}")]
    Config(String),
    #[error(transparent)]
    Feed(#[from] FeedError),
    #[error("{0}")]
    System(#[from] std::io::Error),
    #[error("`{0}` failed")]
    Command(String),
    #[error("the module gave no good answer within {seconds} s of its start: {0}", seconds = TO_DRIVE.as_secs())]
    NoAnswer(String),
    /// This machine does not offer what the case needs.
    #[error("{0}")]
    Lacking(String),
}

impl From<BadInput> for BenchError {
    fn from(error: BadInput) -> Self {
        Self::Config(error.to_string())
    }
}

/// Lines of the shipped configuration.
const SHIPPED_CAMERA: &str = "path = \"/dev/video0\"";
const SHIPPED_BUS: &str = "interface = \"can0\"";

impl Rig {
    /// The module's configuration, its camera and its odometer.
    pub(crate) fn config(&self) -> Result<(Config, Camera, WheelConfig), BenchError> {
        let path = &self.installation.config;
        let config = Config::load(path)?;
        let size = config
            .camera
            .size()
            .ok_or_else(|| BenchError::Config(format!("{}: width and height are missing", path.display())))?;
        let camera = config.camera_for(path, size.width, size.height)?;
        match config.wheels() {
            Wheels::Can(wheels) => Ok((config, camera, wheels.odometer)),
            Wheels::None | Wheels::Sim(_) => Err(BenchError::Config(format!(
                "{}: [wheels] must have the source \"can\"",
                path.display()
            ))),
        }
    }

    /// The road, with slips of the wheels at these seconds of the drive.
    pub(crate) fn road(&self, slips: &[Slip]) -> Result<Road, BenchError> {
        let (config, camera, odometer) = self.config()?;
        let mut road = Road::new(self.seed, &camera, config.camera.frame_rate_hz, &odometer, slips);
        road.tape = self.tape.clone();
        Ok(road)
    }

    /// Lets the module's configuration name the rig's devices, where the shipped one names others.
    pub(crate) fn take_devices(&mut self) -> Result<(), BenchError> {
        let device = self.device.display().to_string();
        let config = self.config_with(&[
            (SHIPPED_CAMERA, &format!("path = \"{device}\"")),
            (SHIPPED_BUS, &format!("interface = \"{}\"", self.interface)),
        ])?;
        self.installation.config = config;
        Ok(())
    }

    /// The configuration with lines replaced, in a file of its own beside it, for its relative paths.
    pub(crate) fn config_with(&self, lines: &[(&str, &str)]) -> Result<PathBuf, BenchError> {
        let shipped = &self.installation.config;
        let mut text = std::fs::read_to_string(shipped)?;
        if lines.iter().all(|(old, new)| old == new) {
            return Ok(shipped.clone());
        }
        for (old, new) in lines {
            if !text.contains(old) {
                return Err(BenchError::Config(format!(
                    "{}: there is no `{old}`",
                    shipped.display()
                )));
            }
            text = text.replace(old, new);
        }
        let name = self.folder.file_name().unwrap_or_default().to_string_lossy();
        let path = shipped.with_file_name(format!("rig-{name}.toml"));
        std::fs::write(&path, text)?;
        Ok(path)
    }

    /// A file of the case.
    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Runs `ip link set INTERFACE STATE`.
    pub(crate) fn link(&self, state: &str) -> Result<(), BenchError> {
        command("ip", &["link", "set", &self.interface, state])
    }
}

/// Runs a program to its end.
pub(crate) fn command(program: &str, arguments: &[&str]) -> Result<(), BenchError> {
    let status = Command::new(program).args(arguments).status()?;
    if status.success() {
        return Ok(());
    }
    Err(BenchError::Command(format!("{program} {}", arguments.join(" "))))
}

/// A drive under way.
pub(crate) struct Bench {
    pub(crate) rig: Rig,
    pub(crate) road: Road,
    pub(crate) listener: Listener,
    pub(crate) feed: Feed,
    pub(crate) module: Module,
    /// The first good answer.
    pub(crate) first: Heard,
    pub(crate) started_micros: u64,
}

impl Bench {
    /// Drives, and waits for the first good answer.
    pub(crate) fn start(rig: &Rig, slips: &[Slip], record: Option<&Log>) -> Result<Self, BenchError> {
        let road = rig.road(slips)?;
        let listener = Listener::start(&rig.interface)?;
        let feed = Feed::start(road.show()?, &rig.device, &rig.interface)?;
        std::thread::sleep(Duration::from_millis(500));
        let started_micros = crate::clock::now_micros();
        let module = Module::start(&rig.installation, record, &rig.file("module.log"))?;
        let first = listener
            .wait_for(TO_DRIVE, |heard| heard.is_good(STANDING))
            .ok_or_else(|| no_answer(rig, &listener, &module, feed.lateness_micros(road.rate_hz)))?;
        Ok(Self {
            rig: rig.clone(),
            road,
            listener,
            feed,
            module,
            first,
            started_micros,
        })
    }
}

/// What was heard instead of a good answer; all of it stands in the case's files.
pub(crate) fn no_answer(rig: &Rig, listener: &Listener, module: &Module, late_micros: u64) -> BenchError {
    let log = candump(&listener.frames(), &rig.interface);
    // The error is told all the same.
    let _ = std::fs::write(rig.file("bus.candump"), log);
    let heard = listener.heard();
    let last = heard
        .last()
        .map(|last| format!("{} with {}", last.level.name(), names(last.faults)));
    BenchError::NoAnswer(format!(
        "{} answers, {last:?}; pictures up to {} ms late; {}",
        heard.len(),
        late_micros / 1000,
        module.last_words()
    ))
}

/// Faults of the machine rather than of the drive: a bench without real-time rights is one all the same.
pub(crate) const STANDING: Faults = Faults::RIGHTS_LACKING;

/// What one answer of a case may name beside its fault: two kernels share a machine, and one may lose some frames' time to the
/// other without either standing still.
pub(crate) fn late_once(answers: &[&Heard]) -> Faults {
    const LATE: Faults = Faults(Faults::MAP_LATE.0 | Faults::NETWORK_LATE.0 | Faults::CUT_STOPPED.0);
    let is_late = |heard: &&&Heard| heard.faults.0 & LATE.0 != 0;
    if answers.iter().filter(is_late).count() <= 1 {
        LATE
    } else {
        Faults::NONE
    }
}

/// What these answers may name without a fault: the road shows hardly enough landmarks of itself at places, so that a plane is
/// held now and then, a few in a hundred.
pub(crate) fn ordinary(answers: &[&Heard]) -> Faults {
    let is_held = |heard: &&&Heard| heard.faults.contains(Faults::PLANE_HELD);
    let held = answers.iter().filter(is_held).count();
    if held <= 1 + answers.len() / 20 {
        STANDING | Faults::PLANE_HELD
    } else {
        STANDING
    }
}
