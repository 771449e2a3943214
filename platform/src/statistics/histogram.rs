//! Times in a histogram of fixed size.
//!
//! In: microseconds, one sample at a time. Out: [`Percentiles`] in milliseconds, and counts between two times for a picture.
//! Invariant: a percentile is at most 0.1 % above the exact one by nearest rank, and never above the largest sample, which is
//! kept exactly. Cost: O(1) a sample, without allocation; [`LatencyHistogram::BYTES`] each, written to at construction so that
//! no page is added later. A sample beyond the last bin counts in it; a count that would overflow stays at its largest value.
//! Source: hdrhistogram, after G. Tene.

use hdrhistogram::{Counter, Histogram};
use serde::Serialize;

/// The first bin's upper end.
const SHORTEST_MICROS: u64 = 1;
/// What the last bin ends at: a minute is no latency any more.
const LONGEST_MICROS: u64 = 60_000_000;
/// Significant decimal digits.
const DIGITS: u8 = 3;

/// Percentiles of the samples by nearest rank, in milliseconds: the smallest sample that the given share does not exceed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99 in 100.
    pub p99: f64,
    /// 999 in 1000.
    pub p99_9: f64,
    /// Largest.
    pub max: f64,
}

/// Times between one microsecond and a minute.
#[derive(Clone, Debug)]
pub struct LatencyHistogram {
    bins: Histogram<u32>,
    /// Exact, where the bins are not.
    max_micros: u64,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self::new()
    }
}

impl LatencyHistogram {
    /// Heap memory of one: 1,024 bins for each doubling of the range, and 1,024 more, as three digits ask for.
    pub const BYTES: usize = 17 * 1024 * size_of::<u32>();

    /// An empty histogram, all of its memory resident.
    ///
    /// # Panics
    /// Never: the bounds are constants, and valid.
    #[must_use]
    pub fn new() -> Self {
        let mut histogram = Self {
            bins: bins(),
            max_micros: 0,
        };
        // Fresh zeros are one shared page; seen through `black_box`, clearing them cannot be left out.
        std::hint::black_box(&mut histogram.bins).reset();
        histogram
    }

    /// Adds a sample.
    pub fn record(&mut self, micros: u64) {
        self.bins.saturating_record(micros);
        self.max_micros = self.max_micros.max(micros);
    }

    /// Samples.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.bins.len()
    }

    /// Percentiles of all samples; none of none.
    #[must_use]
    pub fn percentiles(&self) -> Option<Percentiles> {
        percentiles(&self.bins, self.max_micros)
    }

    /// Largest sample, exactly; 0 of none.
    #[must_use]
    pub const fn max_micros(&self) -> u64 {
        self.max_micros
    }

    /// Smallest sample, as its bin's lower end.
    #[must_use]
    pub fn min_micros(&self) -> Option<u64> {
        (!self.bins.is_empty()).then(|| self.bins.min().min(self.max_micros))
    }

    /// Calls `take` with each time that was recorded and how often, in ascending order.
    pub fn for_each(&self, mut take: impl FnMut(u64, u64)) {
        for step in self.bins.iter_recorded() {
            take(
                self.bins.lowest_equivalent(step.value_iterated_to()),
                u64::from(step.count_at_value()),
            );
        }
    }
}

/// Empty bins, with counters of the wanted width.
///
/// # Panics
/// Never: the bounds are constants, and valid.
#[expect(clippy::expect_used, reason = "constant arguments; a test constructs one")]
pub(super) fn bins<C: Counter>() -> Histogram<C> {
    Histogram::new_with_bounds(SHORTEST_MICROS, LONGEST_MICROS, DIGITS).expect("the bounds are valid")
}

/// Percentiles of all samples, whose largest is known exactly; none of none.
pub(super) fn percentiles<C: Counter>(bins: &Histogram<C>, max_micros: u64) -> Option<Percentiles> {
    if bins.is_empty() {
        return None;
    }
    let at = |quantile: f64| millis(bins.value_at_quantile(quantile).min(max_micros));
    Some(Percentiles {
        p50: at(0.5),
        p99: at(0.99),
        p99_9: at(0.999),
        max: millis(max_micros),
    })
}

#[expect(clippy::cast_precision_loss, reason = "microseconds of one drive")]
fn millis(micros: u64) -> f64 {
    micros as f64 / 1e3
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn filled(samples: impl IntoIterator<Item = u64>) -> LatencyHistogram {
        let mut histogram = LatencyHistogram::new();
        samples.into_iter().for_each(|micros| histogram.record(micros));
        histogram
    }

    #[test]
    fn percentiles_are_samples_but_for_a_thousandth() {
        let found = filled((1..=1000).rev().map(|ms| ms * 1000))
            .percentiles()
            .unwrap();
        for (found, exact) in [(found.p50, 500.0), (found.p99, 990.0), (found.p99_9, 999.0)] {
            assert!(found >= exact && found <= exact * 1.001, "{found} for {exact}");
        }
        assert_eq!(found.max, 1000.0);
        let three = filled([1000, 2000, 9000]).percentiles().unwrap();
        assert_eq!((three.p50, three.p99), (2.0, 9.0));
        assert_eq!(LatencyHistogram::new().percentiles(), None);
    }

    #[test]
    fn one_sample_is_every_percentile() {
        let found = filled([123_457]).percentiles().unwrap();
        assert_eq!((found.p50, found.max), (123.457, 123.457));
    }

    #[test]
    fn extremes_are_kept() {
        let histogram = filled([0, u64::MAX]);
        assert_eq!(histogram.count(), 2);
        assert_eq!(histogram.min_micros(), Some(0));
        let mut seen = 0;
        histogram.for_each(|_, count| seen += count);
        assert_eq!(seen, 2);
    }

    #[test]
    fn the_size_is_what_is_said() {
        assert_eq!(
            LatencyHistogram::new().bins.distinct_values() * size_of::<u32>(),
            LatencyHistogram::BYTES
        );
    }
}
