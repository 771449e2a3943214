//! A value out of many samples of which some are wrong.

use serde::Serialize;

/// Median and spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Robust {
    /// The median.
    pub value: f64,
    /// Standard deviation of a sample, from the median of the distances to the median.
    pub spread: f64,
    /// Standard deviation of the median, the samples taken as independent.
    pub sigma: f64,
    /// Samples.
    pub count: usize,
}

/// From a normal distribution's median distance to its standard deviation, and from a mean's deviation to a median's.
const DEVIATION: f64 = 1.4826;
const MEDIAN_LOSS: f64 = 1.2533;

/// Median and spread of samples, NaN left out; none of none.
#[must_use]
pub fn robust(samples: impl IntoIterator<Item = f64>) -> Option<Robust> {
    let mut sorted: Vec<f64> = samples.into_iter().filter(|sample| sample.is_finite()).collect();
    let value = median(&mut sorted)?;
    let mut off: Vec<f64> = sorted.iter().map(|sample| (sample - value).abs()).collect();
    let spread = DEVIATION * median(&mut off)?;
    #[expect(clippy::cast_precision_loss, reason = "samples of a recording")]
    let sigma = MEDIAN_LOSS * spread / (sorted.len() as f64).sqrt();
    Some(Robust {
        value,
        spread,
        sigma,
        count: sorted.len(),
    })
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    let upper = *values.get(middle)?;
    Some(if values.len() % 2 == 1 {
        upper
    } else {
        0.5 * (values[middle - 1] + upper)
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn a_third_of_wild_samples_does_not_matter() {
        let samples = [1.0, 1.1, 0.9, 1.05, 0.95, 1.0, 50.0, -40.0, f64::NAN, 70.0];
        let found = robust(samples).unwrap();
        assert!(
            (found.value - 1.0).abs() < 0.06 && found.spread < 0.25,
            "{found:?}"
        );
        assert_eq!(found.count, 9);
        assert_eq!(robust([]), None);
    }
}
