//! The command line: arguments in, an exit code out.
//!
//! Exit codes: 0 done, 1 internal failure or a check of doctor that fails, 2 bad input (file, line or field, and fix are printed to standard error).

mod args;
mod calibrate;
mod calibrate_args;
mod can;
mod demo;
mod doctor;
mod drive;
mod eval;
mod failure;
mod fleet;
mod fleet_args;
mod memory_watch;
mod monitor;
mod replay;
mod replay_drive;
mod run;
mod service;
mod table;
mod terminal;

pub use args::{
    Ablation, CanCommand, CanDecodeArgs, CanLoadArgs, Cli, Command, DemoArgs, DoctorArgs, EvalCommand,
    McapArgs, Pace, ReplayArgs, RunArgs, Timing, TruthArgs,
};
pub use calibrate::run as run_calibrate;
pub use calibrate_args::{CalibrateCommand, ImportArgs, LensArgs, MountArgs, TicksArgs};
pub use can::run as run_can;
pub use demo::run as run_demo;
pub use doctor::run as run_doctor;
pub use eval::run as run_eval;
pub use failure::{Failure, finish};
pub use fleet_args::{DrivesArgs, MergeArgs};
pub use monitor::{MonitorArgs, run as run_monitor};
pub use replay::{ReplayInputs, open_inputs, run as run_replay};
pub use run::run as run_run;
