//! How late the publisher's timer wakes it: absolute sleeps on a thread of its role.

use std::io;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::{Timespec, clock_gettime};

use super::Check;
use crate::runtime::rights::{RealTimeConfig, Scheduling, ThreadRole, enter, thread_builder};

/// Time between wake-ups.
pub const PERIOD_MICROS: u64 = 1_000;

/// The longest lateness told apart.
const LONGEST_NANOS: u64 = 60_000_000_000;

/// Upper ends of the rows of the histogram; what is later stands in a last one.
const ROWS_MICROS: [u64; 14] = [
    2, 5, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000,
];

/// Lateness from which the publication of a grid may be seen to slip: the tolerance of the promise.
const NOTICED_MICROS: f64 = 5_000.0;

/// Lateness of the wake-ups.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Jitter {
    /// Length of the test.
    pub seconds: f64,
    /// How the thread was scheduled.
    pub scheduling: Scheduling,
    /// Wake-ups.
    pub wake_ups: u64,
    /// Half of them were earlier.
    pub p50_micros: f64,
    /// 99 of 100 were earlier.
    pub p99_micros: f64,
    /// 999 of 1000 were earlier.
    pub p99_9_micros: f64,
    /// The latest.
    pub max_micros: f64,
    /// Wake-ups by lateness.
    pub rows: Vec<Row>,
}

/// Wake-ups of one range of lateness.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Row {
    /// Up to this late; none in the last row.
    pub up_to_micros: Option<u64>,
    /// So many.
    pub count: u64,
}

/// Why lateness could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum JitterError {
    /// The thread could not be started.
    #[error("the thread of the jitter test could not be started: {0}")]
    Thread(io::Error),
    /// The clock or its histogram failed.
    #[error("the jitter test failed: {0}")]
    Clock(String),
}

/// Wakes up each millisecond for a while, on a thread set up as the publisher is.
///
/// # Errors
/// No thread or no clock.
pub fn measure_jitter(config: &RealTimeConfig, length: Duration) -> Result<Jitter, JitterError> {
    let config = *config;
    let thread = thread_builder(ThreadRole::Publisher, &config)
        .spawn(move || {
            let entered = enter(ThreadRole::Publisher, &config);
            lateness(length).map(|histogram| Jitter::new(&histogram, length, entered.scheduling))
        })
        .map_err(JitterError::Thread)?;
    thread
        .join()
        .unwrap_or_else(|_| Err("its thread panicked".to_owned()))
        .map_err(JitterError::Clock)
}

/// Lateness of each wake-up, nanoseconds.
fn lateness(length: Duration) -> Result<Histogram<u64>, String> {
    let mut histogram = Histogram::new_with_bounds(1, LONGEST_NANOS, 3).map_err(|error| error.to_string())?;
    let begin = Instant::now();
    let mut target = nanos(clock_gettime(rustix::time::ClockId::Monotonic));
    while begin.elapsed() < length {
        target += i128::from(PERIOD_MICROS) * 1000;
        sleep_until(target)?;
        let now = nanos(clock_gettime(rustix::time::ClockId::Monotonic));
        histogram.saturating_record(u64::try_from(now - target).unwrap_or(0).max(1));
        // One late wake-up counts once, not for each period that it slept through.
        target = target.max(now - i128::from(PERIOD_MICROS) * 1000);
    }
    Ok(histogram)
}

fn sleep_until(target: i128) -> Result<(), String> {
    let seconds = |nanos: i128| i64::try_from(nanos / 1_000_000_000).unwrap_or(i64::MAX);
    let request = Timespec {
        tv_sec: seconds(target),
        tv_nsec: i64::try_from(target % 1_000_000_000).unwrap_or(0),
    };
    loop {
        match clock_nanosleep_absolute(ClockId::Monotonic, &request) {
            Ok(()) => return Ok(()),
            Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(error.to_string()),
        }
    }
}

fn nanos(time: Timespec) -> i128 {
    i128::from(time.tv_sec) * 1_000_000_000 + i128::from(time.tv_nsec)
}

impl Jitter {
    #[expect(clippy::cast_precision_loss, reason = "microseconds")]
    fn new(histogram: &Histogram<u64>, length: Duration, scheduling: Scheduling) -> Self {
        let micros = |nanos: u64| (nanos as f64 * 1e-2).round() * 1e-1;
        let mut from = 0;
        let mut rows: Vec<Row> = (ROWS_MICROS.iter())
            .map(|up_to| {
                let count = histogram.count_between(from, up_to * 1000 - 1);
                from = up_to * 1000;
                Row {
                    up_to_micros: Some(*up_to),
                    count,
                }
            })
            .collect();
        rows.push(Row {
            up_to_micros: None,
            count: histogram.count_between(from, u64::MAX),
        });
        let quantile = |q| micros(histogram.value_at_quantile(q));
        Self {
            seconds: length.as_secs_f64(),
            scheduling,
            wake_ups: histogram.len(),
            p50_micros: quantile(0.5),
            p99_micros: quantile(0.99),
            p99_9_micros: quantile(0.999),
            max_micros: micros(histogram.max()),
            rows,
        }
    }

    /// The verdict: a timer later than `guard_micros`, what a fallback leaves before its deadline, misses it.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "microseconds")]
    pub fn check(&self, guard_micros: u64) -> Check {
        const NAME: &str = "timer jitter";
        let ms = |micros: f64| micros * 1e-3;
        let seen = format!(
            "p99.9 {:.2} ms, latest {:.2} ms at {}; a deadline is missed from {:.0} ms on",
            ms(self.p99_9_micros),
            ms(self.max_micros),
            self.scheduling,
            ms(guard_micros as f64)
        );
        let fix = "stop what else runs at a real-time priority, keep cores for the program (isolcpus, `cpus` in [runtime]), \
                   boot a PREEMPT_RT kernel; on a virtual machine, give it cores of its own";
        if self.max_micros > guard_micros as f64 {
            return Check::fails(NAME, seen, fix);
        }
        if self.max_micros > NOTICED_MICROS {
            return Check::warning(NAME, seen, fix);
        }
        Check::ok(NAME, seen)
    }

    /// The histogram as text, from its first row that holds something to its last.
    #[must_use]
    pub fn table(&self) -> String {
        use std::fmt::Write as _;
        const WIDTH: u64 = 40;
        let first = self.rows.iter().position(|row| row.count > 0).unwrap_or(0);
        let last = self.rows.iter().rposition(|row| row.count > 0).unwrap_or(0);
        let most = self.rows.iter().map(|row| row.count).max().unwrap_or(0).max(1);
        let mut text = String::new();
        for row in &self.rows[first..=last] {
            let end = match row.up_to_micros {
                Some(micros) if micros < 1000 => format!("under {micros:>3} us"),
                Some(micros) => format!("under {:>3} ms", micros / 1000),
                None => "later       ".to_owned(),
            };
            // A row that holds anything shows something.
            let length = (row.count * WIDTH).div_ceil(most);
            let bar = "#".repeat(usize::try_from(length).unwrap_or(0));
            // A `String` takes all that is written to it.
            let _ = writeln!(text, "  {end}  {:>7}  {bar}", row.count);
        }
        text
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::doctor::State;

    fn jitter(late_micros: &[u64]) -> Jitter {
        let mut histogram = Histogram::new_with_bounds(1, LONGEST_NANOS, 3).unwrap();
        for late in late_micros {
            histogram.record(late * 1000).unwrap();
        }
        Jitter::new(
            &histogram,
            Duration::from_secs(1),
            Scheduling::Fifo { priority: 48 },
        )
    }

    #[test]
    fn rows_hold_every_wake_up_once() {
        let jitter = jitter(&[1, 3, 3, 7, 80, 7_000, 90_000]);
        assert_eq!(jitter.rows.iter().map(|row| row.count).sum::<u64>(), 7);
        let table = jitter.table();
        let lines: Vec<&str> = table.lines().collect();
        assert!(lines[0].starts_with("  under   2 us        1"), "{table}");
        assert!(lines[1].starts_with("  under   5 us        2"), "{table}");
        assert!(lines.last().unwrap().trim_start().starts_with("later"), "{table}");
        assert!(lines[0].ends_with('#'));
    }

    #[test]
    fn a_timer_later_than_the_guard_fails() {
        assert_eq!(jitter(&[10, 4_000]).check(20_000).state, State::Ok);
        assert_eq!(jitter(&[10, 6_000]).check(20_000).state, State::Warning);
        assert_eq!(jitter(&[10, 21_000]).check(20_000).state, State::Fails);
    }

    #[test]
    fn a_short_test_counts_its_wake_ups() {
        let jitter = measure_jitter(&RealTimeConfig::default(), Duration::from_millis(50)).unwrap();
        assert!((1..=60).contains(&jitter.wake_ups), "{}", jitter.wake_ups);
        assert!(jitter.p50_micros <= jitter.p99_micros && jitter.p99_micros <= jitter.max_micros);
    }
}
