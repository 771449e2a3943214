//! Why a command ended early, and its exit code.

use std::fmt;
use std::process::ExitCode;

use miette::{Diagnostic, MietteHandlerOpts, Report};

use super::terminal;
use crate::bad_input::BadInput;
use crate::sink::recording::RecordingError;
use crate::whole_file::WriteError;

/// Why a command ended early.
#[derive(Debug)]
pub enum Failure {
    /// What the user gave is wrong: exit code 2.
    BadInput(Report),
    /// Something else failed: exit code 1.
    Internal(Report),
}

impl Failure {
    /// A fault of what the user gave.
    pub fn bad_input(error: impl Diagnostic + Send + Sync + 'static) -> Self {
        set_printer();
        Self::BadInput(Report::new(error))
    }

    /// A fault of the program or its machine.
    pub fn internal(error: impl Diagnostic + Send + Sync + 'static) -> Self {
        set_printer();
        Self::Internal(Report::new(error))
    }
}

impl Failure {
    /// What was asked for cannot be had on this computer; `message` says what.
    #[must_use]
    pub fn unmet(message: String) -> Self {
        set_printer();
        Self::Internal(Report::msg(message))
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BadInput(report) | Self::Internal(report) => write!(formatter, "{report}"),
        }
    }
}

impl From<BadInput> for Failure {
    fn from(error: BadInput) -> Self {
        Self::bad_input(error)
    }
}

impl From<RecordingError> for Failure {
    fn from(error: RecordingError) -> Self {
        match error {
            RecordingError::Folder(bad) => Self::bad_input(bad),
            RecordingError::Write { .. } => Self::internal(error),
        }
    }
}

impl From<WriteError> for Failure {
    fn from(error: WriteError) -> Self {
        Self::internal(error)
    }
}

/// Prints the fault, if there is one, and gives the exit code.
#[must_use]
pub fn finish(result: Result<(), Failure>) -> ExitCode {
    let (report, code) = match result {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Failure::BadInput(report)) => (report, 2),
        Err(Failure::Internal(report)) => (report, 1),
    };
    terminal::tell(format_args!("{report:?}"));
    ExitCode::from(code)
}

/// Sets how reports are printed; a report remembers what was set when it was made.
///
/// Lines are never wrapped: a path broken in two cannot be searched for or copied.
fn set_printer() {
    // Fails where it was set already, by an earlier failure or by a program around this one.
    let _ = miette::set_hook(Box::new(|_| {
        Box::new(
            MietteHandlerOpts::new()
                .wrap_lines(false)
                .context_lines(1)
                .build(),
        )
    }));
}
