//! `freespace calibrate`: what a configuration must be told, as lines to paste into it.

mod lens;
mod mount;
mod recording;
mod ticks;

use super::{CalibrateCommand, Failure};

/// Calibrates.
///
/// # Errors
/// Bad input: files, pictures or recordings that are missing, malformed, or unfit.
pub fn run(command: &CalibrateCommand) -> Result<(), Failure> {
    match command {
        CalibrateCommand::Lens(args) => lens::run(args),
        CalibrateCommand::Import(args) => lens::import(args),
        CalibrateCommand::Mount(args) => mount::run(args),
        CalibrateCommand::Ticks(args) => ticks::run(args),
    }
}

/// Prints a value as JSON; one always has a JSON form.
fn print_json(value: &serde_json::Value) {
    println!("{value:#}");
}
