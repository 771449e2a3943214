//! Where the map's scale comes from, and whether the wheels may be believed.
//!
//! In: for each pair of neighbouring views, what the wheels and what the landmarks (already metric) say of the rear axle's step.
//! Out: whether the wheel distance enters the map. A wheel that slips, blocks or sticks disagrees with the landmarks and is left
//! out; the scale is then held by the landmarks. Wheels that disagree by the same ratio for [`RELOCK_STEPS`] steps
//! are right and the map is not: it is rescaled. Constant cost.

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use crate::health::ScaleState;

/// Disagreement that is noticed: a share of the step, some centimetres, and what the picture itself may err. On KITTI 03 at
/// 1.4 m a view a picture that drifts in a turn is 9 % off while the wheels are right; less must pull the map back.
const TOLERANCE: f64 = 0.12;
const TOLERANCE_M: f64 = 0.03;
const TOLERANCE_SIGMA: f64 = 3.0;
/// A picture this vague about a step cannot judge the wheels.
const VAGUE: f64 = 0.1;
/// Steps (about 1.2 m each) with one and the same ratio until the map gives in.
const RELOCK_STEPS: u32 = 10;
/// Spread of that ratio, as a share.
const RELOCK_SPREAD: f64 = 0.05;
/// Ratios beyond are faults of the encoder, whatever their spread.
const RELOCK_RATIO: core::ops::Range<f64> = 0.4..2.5;
/// Share of a new ratio in the running mean.
const SMOOTHING: f64 = 0.05;

/// What the landmarks say of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct VisualStep {
    pub(super) length_m: f64,
    pub(super) sigma_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    Believe,
    Reject,
    /// The map is wrong by this factor; the wheels are believed again.
    Relock(f64),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ScaleMonitor {
    pub(super) state: ScaleState,
    pub(super) rejected: u64,
    wheel_over_visual: f64,
    disagreeing: u32,
    ratio_mean: f64,
}

impl ScaleMonitor {
    pub(super) const fn new() -> Self {
        Self {
            state: ScaleState::Held,
            rejected: 0,
            wheel_over_visual: 1.0,
            disagreeing: 0,
            ratio_mean: 1.0,
        }
    }

    /// Running mean of wheel distance over visual distance.
    pub(super) const fn wheel_over_visual(&self) -> f64 {
        self.wheel_over_visual
    }

    pub(super) fn judge(&mut self, wheel_m: f64, visual: Option<VisualStep>) -> Verdict {
        let Some(visual) = visual.filter(|v| v.sigma_m < VAGUE * v.length_m.max(wheel_m) + TOLERANCE_M)
        else {
            return self.believe();
        };
        let tolerance =
            TOLERANCE * visual.length_m.max(wheel_m) + TOLERANCE_M + TOLERANCE_SIGMA * visual.sigma_m;
        let ratio = wheel_m / visual.length_m.max(1e-3);
        if (wheel_m - visual.length_m).abs() <= tolerance {
            if visual.length_m > 10.0 * TOLERANCE_M {
                self.wheel_over_visual += SMOOTHING * (ratio - self.wheel_over_visual);
            }
            return self.believe();
        }
        self.rejected += 1;
        self.state = ScaleState::Held;
        let continues = self.disagreeing > 0 && (ratio / self.ratio_mean - 1.0).abs() < RELOCK_SPREAD;
        if continues {
            self.disagreeing += 1;
            self.ratio_mean += (ratio - self.ratio_mean) / f64::from(self.disagreeing);
        } else {
            self.disagreeing = 1;
            self.ratio_mean = ratio;
        }
        if self.disagreeing >= RELOCK_STEPS && RELOCK_RATIO.contains(&self.ratio_mean) {
            let ratio = self.ratio_mean;
            let _ = self.believe();
            return Verdict::Relock(ratio);
        }
        Verdict::Reject
    }

    fn believe(&mut self) -> Verdict {
        self.state = ScaleState::Wheels;
        self.disagreeing = 0;
        Verdict::Believe
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEEN: Option<VisualStep> = Some(VisualStep {
        length_m: 1.2,
        sigma_m: 0.01,
    });

    #[test]
    fn slip_and_stuck_are_rejected_and_noise_is_not() {
        let mut monitor = ScaleMonitor::new();
        assert_eq!(monitor.judge(1.23, SEEN), Verdict::Believe);
        assert_eq!(monitor.judge(1.45, SEEN), Verdict::Reject);
        assert_eq!(monitor.state, ScaleState::Held);
        for _ in 0..50 {
            assert_eq!(monitor.judge(0.0, SEEN), Verdict::Reject);
        }
        assert_eq!(monitor.judge(1.19, SEEN), Verdict::Believe);
        assert_eq!(monitor.state, ScaleState::Wheels);
    }

    #[test]
    fn wheels_are_believed_where_the_picture_is_vague() {
        let vague = Some(VisualStep {
            length_m: 1.2,
            sigma_m: 0.5,
        });
        assert_eq!(ScaleMonitor::new().judge(0.9, vague), Verdict::Believe);
    }

    #[test]
    fn steady_disagreement_rescales_the_map() {
        let mut monitor = ScaleMonitor::new();
        let verdicts: [Verdict; 10] =
            core::array::from_fn(|k| monitor.judge(1.5 + 0.01 * (k % 2) as f64, SEEN));
        assert!(verdicts[..9].iter().all(|v| *v == Verdict::Reject));
        assert!(matches!(verdicts[9], Verdict::Relock(r) if (r - 1.254).abs() < 0.01));
    }
}
