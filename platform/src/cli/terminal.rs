//! Lines for whoever reads the terminal.
//!
//! Invariant: a terminal that takes nothing (a full disk, a pipe that its reader closed) never ends a drive: `println!` would
//! panic there. What is lost is a line; the messages and the exit code say the same.

use std::fmt;
use std::io::{Write as _, stderr, stdout};

/// Writes a line to standard error.
pub(super) fn tell(line: fmt::Arguments<'_>) {
    // See above, here and below.
    let _ = stderr().write_fmt(format_args!("{line}\n"));
}

/// Writes over the line on standard error.
pub(super) fn tell_over(text: fmt::Arguments<'_>) {
    let _ = stderr().write_fmt(text);
}

/// Writes a line of the result to standard output.
pub(super) fn show(line: fmt::Arguments<'_>) {
    let _ = stdout().write_fmt(format_args!("{line}\n"));
}
