//! A latency histogram as counts: what files hold, and what adds up exactly.
//!
//! In: a [`LatencyHistogram`], or counts from a file. Out: their sum, and its [`Percentiles`]. Invariant: bins are those of
//! [`LatencyHistogram`], so that the sum over drives has the percentiles that one histogram of all their samples has; counts
//! are integers, and their sum does not depend on its order. Cost: as many entries as there are different bins, some hundreds.
//! A sum that does not fit 64 bits is refused.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::histogram::{self, LatencyHistogram, Percentiles};

/// Samples by the lower end of their bin.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LatencyCounts {
    /// Largest sample, exactly.
    max_micros: u64,
    /// Lower end of each bin in microseconds, and samples in it; empty bins are left out.
    bins: BTreeMap<u64, u64>,
}

impl LatencyCounts {
    /// Of a histogram.
    #[must_use]
    pub fn of(histogram: &LatencyHistogram) -> Self {
        let mut bins = BTreeMap::new();
        histogram.for_each(|micros, count| {
            bins.insert(micros, count);
        });
        Self {
            max_micros: histogram.max_micros(),
            bins,
        }
    }

    /// Samples; none where there are more than 64 bits count.
    #[must_use]
    pub fn count(&self) -> Option<u64> {
        self.bins
            .values()
            .try_fold(0_u64, |sum, count| sum.checked_add(*count))
    }

    /// Whether every entry is a bin with samples, and the largest sample lies in the last one or beyond.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let bins = histogram::bins::<u64>();
        let last = self.bins.last_key_value().map_or(0, |(micros, _)| *micros);
        self.max_micros >= last
            && self.count().is_some()
            && (self.bins.iter())
                .all(|(micros, count)| *count > 0 && bins.lowest_equivalent(*micros) == *micros)
    }

    /// Adds the samples of another; none, and nothing added, where the sum has no room.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Option<Self> {
        for (micros, count) in &other.bins {
            let sum = self.bins.entry(*micros).or_default();
            *sum = sum.checked_add(*count)?;
        }
        self.max_micros = self.max_micros.max(other.max_micros);
        self.count().map(|_| self)
    }

    /// Percentiles of all samples; none of none.
    #[must_use]
    pub fn percentiles(&self) -> Option<Percentiles> {
        let mut bins = histogram::bins::<u64>();
        for (micros, count) in &self.bins {
            bins.saturating_record_n(*micros, *count);
        }
        histogram::percentiles(&bins, self.max_micros)
    }

    /// Smallest sample, as its bin's lower end.
    #[must_use]
    pub fn min_micros(&self) -> Option<u64> {
        self.bins.first_key_value().map(|(micros, _)| *micros)
    }

    /// Lower ends of the bins in microseconds and samples in each, ascending.
    pub fn iter(&self) -> impl Iterator<Item = (u64, u64)> {
        self.bins.iter().map(|(micros, count)| (*micros, *count))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use proptest::prelude::*;

    fn filled(samples: &[u64]) -> LatencyHistogram {
        let mut histogram = LatencyHistogram::new();
        samples.iter().for_each(|micros| histogram.record(*micros));
        histogram
    }

    proptest! {
        #[test]
        fn counts_add_up_to_the_histogram_of_all_samples(
            drives in prop::collection::vec(prop::collection::vec(0..90_000_000_u64, 0..40), 1..6),
        ) {
            let all: Vec<u64> = drives.concat();
            let sum = drives.iter().try_fold(LatencyCounts::default(), |sum, samples| {
                sum.plus(&LatencyCounts::of(&filled(samples)))
            });
            let (sum, whole) = (sum.unwrap(), filled(&all));
            prop_assert_eq!(&sum, &LatencyCounts::of(&whole));
            prop_assert!(sum.is_sound());
            prop_assert_eq!(sum.percentiles(), whole.percentiles());
            prop_assert_eq!(sum.min_micros(), whole.min_micros());
            prop_assert_eq!(sum.count(), Some(all.len() as u64));
        }
    }

    #[test]
    fn what_is_no_histogram_is_told() {
        let read = |text: &str| serde_json::from_str::<LatencyCounts>(text).unwrap();
        assert!(read(r#"{"max_micros": 45001, "bins": {"44992": 3}}"#).is_sound());
        for text in [
            r#"{"max_micros": 45001, "bins": {"45001": 3}}"#,
            r#"{"max_micros": 45001, "bins": {"44992": 0}}"#,
            r#"{"max_micros": 1, "bins": {"44992": 1}}"#,
            r#"{"max_micros": 2, "bins": {"1": 18446744073709551615, "2": 1}}"#,
        ] {
            assert!(!read(text).is_sound(), "{text}");
        }
        let full = read(r#"{"max_micros": 1, "bins": {"1": 18446744073709551615}}"#);
        assert_eq!(full.clone().plus(&full), None);
    }
}
