//! `freespace can`: what is on a bus, decoded; and what the module costs it.

mod decode;
mod load;

use std::path::Path;

use super::{CanCommand, Failure};
use crate::bad_input::BadInput;
use crate::wheels::candump_line::LoggedFrame;

/// Runs one of its commands.
///
/// # Errors
/// Bad input, or an interface that cannot be read.
pub fn run(command: &CanCommand) -> Result<(), Failure> {
    match command {
        CanCommand::Decode(args) => decode::run(args),
        CanCommand::Load(args) => load::run(args),
    }
}

/// Hands over each frame of a log, until `take` has had enough.
fn read_log(path: &Path, take: &mut dyn FnMut(&LoggedFrame<'_>) -> bool) -> Result<(), BadInput> {
    let bytes = std::fs::read(path).map_err(|error| {
        let fix = "give the path of a log made by `candump -l` or `candump -L`";
        BadInput::of_file(path, format!("the CAN log cannot be read: {error}"), fix)
    })?;
    let text = String::from_utf8_lossy(&bytes);
    for (line, content) in text.lines().enumerate() {
        if content.trim().is_empty() {
            continue;
        }
        let frame = LoggedFrame::parse(content).map_err(|fault| {
            let fix = "remove the line, or record again with `candump -L`; a line reads (SECONDS.MICROS) IFACE ID#HEX";
            BadInput::at_line(path, &text, line, fault, fix)
        })?;
        if !take(&frame) {
            break;
        }
    }
    Ok(())
}
