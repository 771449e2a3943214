//! The program `freespace`.

use std::process::ExitCode;

use clap::Parser as _;
use freespace_platform::cli::{self, Cli, Command};

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Eval(command) => cli::run_eval(&command),
        Command::Replay(args) => cli::open_inputs(&args).map(drop),
        Command::Demo(_) => Ok(()),
    };
    cli::finish(result)
}
