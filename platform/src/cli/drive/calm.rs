//! Keeps a device that comes and goes from filling the log.
//!
//! In: lines as a device tells them. Out: [`BURST`] of them as they come, then one every [`EVERY`]: the newest, for how things
//! stand now is what its reader must know, with how many were left out before it; and the last one at the end. Memory: one line.

use std::time::{Duration, Instant};

/// Lines that are passed on however fast they come.
const BURST: u32 = 8;
/// One more line may be told.
const EVERY: Duration = Duration::from_secs(1);

/// The lines of one device.
pub(super) struct Calm {
    credit: u32,
    /// The last credit was given then.
    credited: Instant,
    held: Option<String>,
    left_out: u64,
}

impl Calm {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            credit: BURST,
            credited: now,
            held: None,
            left_out: 0,
        }
    }

    /// Takes a line; what is to be told now.
    pub(super) fn take(&mut self, line: String, now: Instant) -> Option<String> {
        self.left_out += u64::from(self.held.replace(line).is_some());
        self.due(now)
    }

    /// What has waited long enough.
    pub(super) fn due(&mut self, now: Instant) -> Option<String> {
        while self.credit < BURST && now.duration_since(self.credited) >= EVERY {
            self.credit += 1;
            self.credited += EVERY;
        }
        if self.credit == 0 {
            return None;
        }
        let line = self.last()?;
        if self.credit == BURST {
            self.credited = now;
        }
        self.credit -= 1;
        Some(line)
    }

    /// What still waits, once nothing more can come.
    pub(super) fn last(&mut self) -> Option<String> {
        let line = self.held.take()?;
        Some(match std::mem::take(&mut self.left_out) {
            0 => line,
            count => format!("{line} ({count} lines before this one are left out)"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_lines_pass_then_one_a_second_and_the_last_one_always() {
        let start = Instant::now();
        let at = |millis| start + Duration::from_millis(millis);
        let mut calm = Calm::new(start);
        // Up and down every 10 ms for 5 s.
        let mut told = Vec::new();
        for k in 0..500 {
            told.extend(calm.take(format!("line {k}"), at(10 * k)));
        }
        assert_eq!(told[..8], [0, 1, 2, 3, 4, 5, 6, 7].map(|k| format!("line {k}")));
        assert_eq!(told.len(), 8 + 4, "{told:?}");
        assert_eq!(told[8], "line 100 (92 lines before this one are left out)");
        assert_eq!(calm.due(at(4_999)), None);
        let last = calm.due(at(5_000));
        assert_eq!(
            last.as_deref(),
            Some("line 499 (98 lines before this one are left out)")
        );
        assert_eq!(calm.due(at(60_000)), None, "nothing is told twice");
        let later: Vec<_> = (0..10)
            .filter_map(|k| calm.take(format!("{k}"), at(60_000)))
            .collect();
        assert_eq!(later.len(), 8, "calm again");
        let at_the_end = calm.last();
        assert_eq!(
            at_the_end.as_deref(),
            Some("9 (1 lines before this one are left out)")
        );
    }
}
