//! The hardware-in-the-loop rig: the installed program behind a real kernel's camera and CAN bus, and what it must survive there.
//!
//! `hil/rig` builds what is needed and calls this program: once on the machine itself, to run the cases and print their table,
//! and once a case inside the kernel that is driven on.

mod bench;
mod case;
mod cases;
mod clock;
mod direct;
mod drive;
mod fault;
mod feed;
mod gauge;
mod host;
mod listener;
mod module;
mod promise;
mod road;
mod stall;
mod table;
mod truth;
mod wheel_frame;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};

use crate::bench::Rig;
use crate::module::Installation;

/// The hardware-in-the-loop rig of freespace.
#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// List the cases.
    List,
    /// Run cases, each in a kernel of its own, and print their table.
    Run(host::RunArgs),
    /// Run one case on this kernel's devices; the last line is its row as JSON.
    Case {
        /// Name.
        name: String,
        #[command(flatten)]
        devices: DeviceArgs,
    },
    /// Paint the pictures of the road's first seconds into a file.
    Paint {
        /// The file.
        file: PathBuf,
        /// Seconds.
        #[arg(long, default_value_t = 45.0)]
        seconds: f64,
        #[command(flatten)]
        devices: DeviceArgs,
    },
    /// Record the tape of the gauge.
    GaugeRecord(gauge::RecordArgs),
    /// Play the tape to the module, in the kernel that counts.
    GaugePlay(gauge::PlayArgs),
    /// Compare two plays with each other and with the limits.
    GaugeCheck(gauge::CheckArgs),
    /// Read a bus until killed.
    Listen {
        /// CAN interface.
        interface: String,
    },
}

/// Where things are.
#[derive(Args, Clone)]
struct DeviceArgs {
    /// The program `freespace`.
    #[arg(long, default_value = "target/release/freespace")]
    module: PathBuf,
    /// Its configuration.
    #[arg(long, default_value = "config/car.toml")]
    config: PathBuf,
    /// V4L2 loopback device.
    #[arg(long, default_value = "/dev/video0")]
    camera: PathBuf,
    /// CAN interface.
    #[arg(long, default_value = "can0")]
    can: String,
    /// Folder for the case's files; made where it is not.
    #[arg(long, default_value = "target/rig/out")]
    out: PathBuf,
    /// Pictures of the road, painted by `paint`; painted while it drives without it.
    #[arg(long, value_name = "FILE")]
    road: Option<PathBuf>,
    /// Seed of the road.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The kernel is a test kernel: its clock may be stepped, disks mounted.
    #[arg(long)]
    own_kernel: bool,
}

impl DeviceArgs {
    fn rig(&self, case: &str) -> Rig {
        Rig {
            installation: Installation {
                program: self.module.clone(),
                config: self.config.clone(),
            },
            device: self.camera.clone(),
            interface: self.can.clone(),
            folder: self.out.join(case),
            seed: self.seed,
            tape: self.road.clone(),
            owns_kernel: self.own_kernel,
        }
    }
}

fn main() -> ExitCode {
    let is_well = match Cli::parse().command {
        Command::List => {
            for case in cases::all() {
                println!("{:<18} {}", case.name, case.injected);
            }
            true
        }
        Command::Run(args) => host::run(&args),
        Command::Case { name, devices } => run_case(&name, &devices),
        Command::GaugeRecord(args) => gauge::record(&args),
        Command::GaugePlay(args) => gauge::play(&args),
        Command::GaugeCheck(args) => gauge::check(&args),
        Command::Paint {
            file,
            seconds,
            devices,
        } => paint(&devices.rig("paint"), seconds, &file),
        Command::Listen { interface } => listen(&interface),
    };
    if is_well {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

fn run_case(name: &str, devices: &DeviceArgs) -> bool {
    let Some(case) = cases::all().find(|case| case.name == name) else {
        eprintln!("there is no case `{name}`; `list` names them");
        return false;
    };
    let mut rig = devices.rig(name);
    // Nothing of an earlier run may be taken for this one's.
    let _ = std::fs::remove_dir_all(&rig.folder);
    if let Err(error) = std::fs::create_dir_all(&rig.folder) {
        eprintln!("{}: cannot be made: {error}", rig.folder.display());
        return false;
    }
    if let Err(error) = rig.take_devices() {
        eprintln!("{error}");
        return false;
    }
    let row = case.row(&rig);
    // A row always has a JSON form.
    println!("{}", serde_json::to_string(&row).unwrap_or_default());
    row.verdict != case::Verdict::Failed
}

fn paint(rig: &Rig, seconds: f64, file: &Path) -> bool {
    let painted = rig.road(&[]).and_then(|road| Ok(road.paint(seconds, file)?));
    if let Err(error) = &painted {
        eprintln!("{}: {error}", file.display());
    }
    painted.is_ok()
}

fn listen(interface: &str) -> bool {
    match listener::Listener::start(interface) {
        Ok(_listener) => loop {
            std::thread::sleep(Duration::from_secs(1));
        },
        Err(error) => {
            eprintln!("{interface}: {error}");
            false
        }
    }
}
