//! The table of a run: case, what was injected, what was required, what was seen.

use crate::case::{Row, Verdict};

/// Prints the rows and a summary line; whether nothing failed.
pub(crate) fn print(rows: &[Row]) -> bool {
    for row in rows {
        line(row);
    }
    let count = |verdict| rows.iter().filter(|row| row.verdict == verdict).count();
    let (passed, failed, skipped) = (
        count(Verdict::Passed),
        count(Verdict::Failed),
        count(Verdict::Skipped),
    );
    println!("{passed} passed, {failed} failed, {skipped} skipped");
    failed == 0
}

/// Prints one row.
pub(crate) fn line(row: &Row) {
    let recovery = row
        .recovery_s
        .map(|seconds| format!("  recovered in {seconds:.2} s"));
    println!(
        "{:<18} {}  {:>5.0} s{}\n    injected  {}\n    required  {}\n    seen      {}",
        row.case,
        row.verdict,
        row.seconds,
        recovery.unwrap_or_default(),
        row.injected,
        row.required,
        row.seen
    );
}
