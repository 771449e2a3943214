//! What is wrong with an input, where, and how to mend it: the one error of everything that is read before a run.
//!
//! Printed by `miette` at start-up with the offending line; the program then ends with exit code 2.

use std::path::Path;

use miette::{NamedSource, SourceSpan};

/// A fault of an input file, folder or argument.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error(transparent)]
#[diagnostic(transparent)]
pub struct BadInput(Box<Report>);

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{message}")]
struct Report {
    message: String,
    #[help]
    fix: String,
    #[source_code]
    text: Option<NamedSource<String>>,
    #[label("{label}")]
    span: Option<SourceSpan>,
    label: String,
}

impl BadInput {
    /// A fault of a whole file, folder or argument; `message` names it.
    #[must_use]
    pub fn new(message: impl Into<String>, fix: impl Into<String>) -> Self {
        Self(Box::new(Report {
            message: message.into(),
            fix: fix.into(),
            text: None,
            span: None,
            label: String::new(),
        }))
    }

    /// A fault of a file or folder.
    #[must_use]
    pub fn of_file(path: &Path, message: impl std::fmt::Display, fix: impl Into<String>) -> Self {
        Self::new(format!("{}: {message}", path.display()), fix)
    }

    /// A fault at bytes `span` of the text of `path`.
    #[must_use]
    pub fn at_span(
        path: &Path,
        text: &str,
        span: std::ops::Range<usize>,
        message: impl std::fmt::Display,
        fix: impl Into<String>,
    ) -> Self {
        let start = span.start.min(text.len());
        let line = text.as_bytes()[..start].iter().filter(|&&b| b == b'\n').count() + 1;
        Self(Box::new(Report {
            message: format!("{}:{line}: {message}", path.display()),
            fix: fix.into(),
            text: Some(NamedSource::new(path.display().to_string(), text.to_owned())),
            span: Some((start..span.end.clamp(start, text.len())).into()),
            label: "here".to_owned(),
        }))
    }

    /// A fault of line `line`, counted from zero, of the text of `path`.
    #[must_use]
    pub fn at_line(
        path: &Path,
        text: &str,
        line: usize,
        message: impl std::fmt::Display,
        fix: impl Into<String>,
    ) -> Self {
        let start: usize = text.split_inclusive('\n').take(line).map(str::len).sum();
        let length = text[start..].lines().next().map_or(0, str::len);
        Self::at_span(path, text, start..start + length, message, fix)
    }

    /// What is wrong.
    #[must_use]
    pub fn message(&self) -> &str {
        &self.0.message
    }

    /// How to mend it.
    #[must_use]
    pub fn fix(&self) -> &str {
        &self.0.fix
    }
}

/// The name among `known` that `name` was probably meant to be.
#[must_use]
pub fn closest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// The whole text of a file.
///
/// # Errors
/// Where it cannot be read or is no UTF-8; `fix` says what to do about it.
pub fn read_text(path: &Path, fix: &str) -> Result<String, BadInput> {
    std::fs::read_to_string(path)
        .map_err(|error| BadInput::of_file(path, format!("cannot be read: {error}"), fix))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_and_fix_are_named() {
        let fault = BadInput::at_line(
            Path::new("times.txt"),
            "0\n1\n0.5\n",
            2,
            "time goes back",
            "sort it",
        );
        assert_eq!(fault.message(), "times.txt:3: time goes back");
        assert_eq!(fault.fix(), "sort it");
    }

    #[test]
    fn closest_name_is_found_and_strangers_are_not() {
        assert_eq!(closest("heigth", ["width", "height", "mount"]), Some("height"));
        assert_eq!(closest("zzz", ["width", "height"]), None);
    }
}
