//! Separable resampling with coefficients computed once: bilinear where it enlarges, area average where it shrinks.
//!
//! Pixel centres: destination `i` of `to` lies at `(i + 0.5) * from / to - 0.5` in the source.
//! Cost: [`MAX_TAPS`] multiplications a destination pixel and axis at most; shrinking further skips source pixels evenly.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use alloc::boxed::Box;

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::budget::MAX_TAPS;

/// The source samples and weights of one destination coordinate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Taps {
    pub(super) index: [u16; MAX_TAPS],
    pub(super) weight: [f32; MAX_TAPS],
    pub(super) count: u8,
}

impl Taps {
    /// Samples and weights in use.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        let count = usize::from(self.count);
        self.index[..count]
            .iter()
            .zip(&self.weight[..count])
            .map(|(&i, &w)| (usize::from(i), w))
    }
}

/// Taps of the destinations `0..to` that cover the source interval `start..start + length` (in source pixels, edges).
pub(super) fn taps(start: f32, length: f32, source: usize, to: usize) -> Box<[Taps]> {
    let step = length / to.max(1) as f32;
    (0..to)
        .map(|i| tap(start + (i as f32 + 0.5) * step - 0.5, step, source))
        .collect()
}

/// A triangle filter as wide as the larger of both pixels, evaluated at the source's pixel centres.
fn tap(centre: f32, step: f32, source: usize) -> Taps {
    let radius = step.max(1.0);
    let (first, last) = ((centre - radius).ceil() as i32, (centre + radius).floor() as i32);
    let span = (last - first + 1).max(1) as usize;
    let stride = span.div_ceil(MAX_TAPS);
    let mut taps = Taps::default();
    let mut total = 0.0;
    for k in (0..span).step_by(stride) {
        let at = first + k as i32;
        let weight = 1.0 - (at as f32 - centre).abs() / radius;
        if weight <= 0.0 {
            continue;
        }
        let slot = usize::from(taps.count);
        taps.index[slot] = at.clamp(0, source as i32 - 1) as u16;
        taps.weight[slot] = weight;
        taps.count += 1;
        total += weight;
    }
    if total <= 0.0 {
        taps.index[0] = centre.round().clamp(0.0, source as f32 - 1.0) as u16;
        taps.weight[0] = 1.0;
        taps.count = 1;
        total = 1.0;
    }
    for weight in &mut taps.weight {
        *weight /= total;
    }
    taps
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_ramp_stays_a_ramp(source in 8..600_usize, to in 2..600_usize) {
            for (i, taps) in taps(0.0, source as f32, source, to).iter().enumerate() {
                let value: f32 = taps.iter().map(|(at, weight)| at as f32 * weight).sum();
                let expected = (i as f32 + 0.5) * source as f32 / to as f32 - 0.5;
                let step = (source as f32 / to as f32).max(1.0);
                let inside = (step..source as f32 - 1.0 - step).contains(&expected);
                prop_assert!(!inside || (value - expected).abs() < 0.5 * step.max(0.02), "{value} {expected}");
                prop_assert!((taps.iter().map(|(_, w)| w).sum::<f32>() - 1.0).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn equal_sizes_copy() {
        for (i, taps) in taps(0.0, 16.0, 16, 16).iter().enumerate() {
            assert_eq!(
                taps.iter().filter(|&(_, w)| w > 1e-6).map(|(at, _)| at).next(),
                Some(i)
            );
        }
    }
}
