//! The program `freespace`.

use std::process::ExitCode;

use clap::Parser as _;
use freespace_platform::cli::{self, Cli, Command};
use freespace_platform::runtime::allocation::CountingAllocator;
use freespace_platform::runtime::rights;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    #[cfg(feature = "onnx")]
    freespace_platform::segmenter::onnx_runtime::forbid_telemetry();
    // Where it is refused, whoever opens the network asks once more and tells it.
    let _ = rights::settle_allocator();
    let result = match Cli::parse().command {
        Command::Run(args) => cli::run_run(&args),
        Command::Eval(command) => cli::run_eval(&command),
        Command::Replay(args) => cli::run_replay(&args),
        Command::Demo(args) => cli::run_demo(&args),
        Command::Can(command) => cli::run_can(&command),
        Command::Calibrate(command) => cli::run_calibrate(&command),
        Command::Monitor(args) => cli::run_monitor(&args),
        Command::Doctor(args) => cli::run_doctor(&args),
    };
    cli::finish(result)
}
