//! A case: what is injected, what is required, and what was seen; one row of the table.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::bench::{BenchError, Rig};
use crate::stall::{StallWatch, Stalls};

/// One case.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) injected: &'static str,
    pub(crate) required: &'static str,
    /// Whether it belongs to the short set.
    pub(crate) is_quick: bool,
    pub(crate) run: fn(&Rig) -> Result<Seen, BenchError>,
}

/// How a case ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Verdict {
    Passed,
    Failed,
    Skipped,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Passed => "passed",
            Self::Failed => "FAILED",
            Self::Skipped => "SKIPPED",
        })
    }
}

/// What a case saw.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    /// In words.
    pub(crate) words: Vec<String>,
    /// What was required and did not hold.
    pub(crate) broken: Vec<String>,
    /// The same, of what a machine that stands still may cost.
    pub(crate) broken_in_peace: Vec<String>,
    /// From the end of the fault to the first good answer.
    pub(crate) recovery_s: Option<f64>,
    /// Whether the rig itself was late: then this was not the drive that it was to be.
    pub(crate) was_late: bool,
}

impl Seen {
    /// Notes a figure.
    pub(crate) fn note(&mut self, words: impl Into<String>) {
        self.words.push(words.into());
    }

    /// Notes what does not hold, where it does not, of what only a machine that is left in peace can be held to: that nothing is
    /// named, and that all is well again soon. Answers in time, and none wrong unmarked, are required of every machine.
    pub(crate) fn require_in_peace(&mut self, holds: bool, otherwise: impl Into<String>) {
        if !holds {
            self.broken_in_peace.push(otherwise.into());
        }
    }

    /// Notes what does not hold, where it does not.
    pub(crate) fn require(&mut self, holds: bool, otherwise: impl Into<String>) {
        if !holds {
            self.broken.push(otherwise.into());
        }
    }
}

/// A row of the table.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Row {
    pub(crate) case: String,
    pub(crate) injected: String,
    pub(crate) required: String,
    pub(crate) seen: String,
    pub(crate) recovery_s: Option<f64>,
    pub(crate) verdict: Verdict,
    pub(crate) seconds: f64,
    /// Whether the machine stood still meanwhile, so that a failure may be its doing.
    #[serde(default)]
    pub(crate) is_disturbed: bool,
    /// Whether a failure is one that such a machine is excused.
    #[serde(default)]
    pub(crate) is_excusable: bool,
}

impl Case {
    /// Runs it on the bench.
    pub(crate) fn row(&self, rig: &Rig) -> Row {
        let begin = std::time::Instant::now();
        let watch = StallWatch::begin();
        let outcome = (self.run)(rig);
        let stalls = watch.map_or_else(|_| Stalls::default(), StallWatch::end);
        let was_late = outcome.as_ref().is_ok_and(|seen| seen.was_late);
        let is_excusable = outcome.as_ref().is_ok_and(|seen| seen.broken.is_empty());
        let (verdict, mut seen, recovery_s) = match outcome {
            Ok(seen) => {
                let is_well = seen.broken.is_empty() && seen.broken_in_peace.is_empty();
                let all = [seen.broken, seen.broken_in_peace, seen.words].concat();
                let verdict = if is_well { Verdict::Passed } else { Verdict::Failed };
                (verdict, all.join("; "), seen.recovery_s)
            }
            Err(BenchError::Lacking(what)) => (Verdict::Skipped, what, None),
            Err(error) => (Verdict::Failed, error.to_string(), None),
        };
        if stalls.are_grave() {
            seen = format!("{seen}; {stalls}");
        }
        let row = self.with(verdict, seen, recovery_s, begin.elapsed().as_secs_f64());
        Row {
            is_disturbed: was_late || stalls.are_grave(),
            is_excusable,
            ..row
        }
    }

    /// A row of this case.
    pub(crate) fn with(&self, verdict: Verdict, seen: String, recovery_s: Option<f64>, seconds: f64) -> Row {
        Row {
            case: self.name.to_owned(),
            injected: self.injected.to_owned(),
            required: self.required.to_owned(),
            seen,
            recovery_s,
            verdict,
            seconds,
            is_disturbed: false,
            is_excusable: false,
        }
    }
}
