//! The energy: unary and pairwise terms to integer capacities.
//!
//! In: [`CrfInputs`]. Out: [`Capacities`], `[height, width] i32` in units of 1/1024 of an energy unit.
//!
//! Two forms: [`TermForm::Paper`] is the paper's energy to the letter; [`TermForm::Calibrated`] has the same terms with
//! soft beliefs as clipped log-odds and a pairwise term that gives way at image edges. Garbage in (NaN) counts as no evidence.
//!
//! Cost: one pass over the pixels, logarithms and exponentials from tables made once.
//! Source: the paper, section "2D Road Detection"; the contrast term is that of Boykov and Jolly (ICCV 2001).
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: table indices and capacities are clamped before they are cast"
)]

use alloc::boxed::Box;
use alloc::vec;

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::GridProblem;
use crate::frame::RgbImage;
use crate::segmentation::RoadProbability;

/// Capacities for one unit of energy.
pub const UNIT: f32 = 1024.0;
/// Largest capacity, so that sums over blocks and along arcs stay far from overflow.
const MAX_CAPACITY: f32 = 4.0e6;
/// Steps of a probability in the log-odds table.
const ODDS_STEPS: usize = 1024;
/// Entries of the contrast table, each [`CONTRAST_STEP`] squared grey levels (summed over channels) wide.
const CONTRAST_ENTRIES: usize = 2048;
/// See [`CONTRAST_ENTRIES`].
const CONTRAST_STEP: usize = 16;

/// Which information the energy uses, for the paper's tables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum Ablation {
    /// Both.
    #[default]
    Joint,
    /// The network alone, without D1 and D2.
    TwoD,
    /// The plane and the boxes alone, without D3.
    ThreeD,
}

/// How evidence becomes energy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum TermForm {
    /// Indicators and probabilities, as printed.
    Paper,
    /// Clipped log-odds of beliefs; contrast in the pairwise term.
    #[default]
    Calibrated,
}

/// Weights of the energy.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(deny_unknown_fields, default)
)]
pub struct CrfConfig {
    /// How evidence becomes energy.
    pub form: TermForm,
    /// Which information is used.
    pub ablation: Ablation,
    /// Paper form: cost in D1 and D2 of calling a pixel road whose ray does not meet the plane first.
    pub omega_1: f32,
    /// Paper form: cost in D1 and D2 of calling a pixel not road whose ray meets the plane first.
    pub omega_2: f32,
    /// Paper form: weight of the network in D3.
    pub omega_3: f32,
    /// Calibrated form: weight of the network's log-odds (D3).
    pub network: f32,
    /// Calibrated form: bound on the network's log-odds before its weight.
    pub network_clip: f32,
    /// Calibrated form: the network's log-odds are divided by it; over 1 for a network too sure of itself.
    pub network_temperature: f32,
    /// Calibrated form: weight of the log-odds of this key frame's 3D belief (D1).
    pub belief: f32,
    /// Calibrated form: weight of the log-odds of the previous key frame's 3D belief (D2).
    pub belief_previous: f32,
    /// Calibrated form: bound on the log-odds of both 3D beliefs before their weights.
    pub belief_clip: f32,
    /// Factor of the pairwise term; 1 in the paper.
    pub smoothness: f32,
    /// Part of the pairwise term that does not depend on the colour lines, 0 to 1.
    pub smoothness_floor: f32,
    /// Colour difference over which the pairwise term falls to 61 %, in grey levels; 0 for no contrast term.
    pub contrast_sigma: f32,
    /// Part of the pairwise term that stays across any edge, 0 to 1.
    pub contrast_floor: f32,
}

impl CrfConfig {
    /// The paper's energy and weights.
    #[must_use]
    pub const fn paper() -> Self {
        Self {
            form: TermForm::Paper,
            smoothness: 1.0,
            smoothness_floor: 0.0,
            contrast_sigma: 0.0,
            contrast_floor: 0.0,
            ..Self::joint()
        }
    }

    /// Calibrated terms.
    #[must_use]
    pub const fn joint() -> Self {
        Self {
            form: TermForm::Calibrated,
            ablation: Ablation::Joint,
            omega_1: 0.9,
            omega_2: 0.9,
            omega_3: 1.0,
            network: 1.0,
            network_clip: 4.0,
            network_temperature: 1.0,
            belief: 0.5,
            belief_previous: 0.3,
            belief_clip: 2.0,
            smoothness: 2.0,
            smoothness_floor: 0.4,
            contrast_sigma: 12.0,
            contrast_floor: 0.05,
        }
    }
}

impl Default for CrfConfig {
    fn default() -> Self {
        Self::joint()
    }
}

/// Evidence of one key frame, everything at the CRF resolution.
#[derive(Clone, Copy, Debug)]
pub struct CrfInputs<'a> {
    /// The network's probabilities (D3).
    pub probability: &'a RoadProbability,
    /// `I(p)`: 1 where the pixel's ray meets the road plane before any box (D1, paper form).
    pub indicator: &'a [u8],
    /// `I(p)` of the previous key frame's plane and boxes, moved here (D2, paper form).
    pub indicator_previous: Option<&'a [u8]>,
    /// Soft `I(p)`, 0.5 without evidence (D1, calibrated form).
    pub belief: &'a [f32],
    /// Soft `I(p)` of the previous key frame's plane and boxes (D2, calibrated form).
    pub belief_previous: Option<&'a [f32]>,
    /// `P_R(p|i)` of the colour lines.
    pub road_score: &'a [f32],
    /// `P_notR(p|i)` of the colour lines.
    pub not_road_score: &'a [f32],
    /// The image, for the contrast term.
    pub rgb: &'a RgbImage,
}

/// A cut problem in the making.
#[derive(Clone, Debug)]
pub struct Capacities {
    width: usize,
    height: usize,
    pub(super) source: Box<[i32]>,
    pub(super) sink: Box<[i32]>,
    pub(super) right: Box<[i32]>,
    pub(super) down: Box<[i32]>,
}

impl Capacities {
    /// No energy at all.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let plane = || vec![0; width * height].into_boxed_slice();
        Self {
            width,
            height,
            source: plane(),
            sink: plane(),
            right: plane(),
            down: plane(),
        }
    }

    /// As the cut takes it: label 1, road, is the source side.
    #[must_use]
    pub fn problem(&self) -> GridProblem<'_> {
        GridProblem {
            width: self.width,
            height: self.height,
            source: &self.source,
            sink: &self.sink,
            right: &self.right,
            down: &self.down,
        }
    }
}

/// The energy with its tables.
#[derive(Clone, Debug)]
pub struct Energy {
    config: CrfConfig,
    network_odds: Box<[f32]>,
    belief_odds: Box<[f32]>,
    contrast: Box<[f32]>,
}

impl Energy {
    /// The energy of `config`.
    #[must_use]
    pub fn new(config: &CrfConfig) -> Self {
        let odds = |temperature: f32, clip: f32| {
            (0..=ODDS_STEPS)
                .map(|step| {
                    let p = (step as f32 / ODDS_STEPS as f32).clamp(1e-6, 1.0 - 1e-6);
                    ((p / (1.0 - p)).ln() / temperature.max(1e-3)).clamp(-clip.abs(), clip.abs())
                })
                .collect()
        };
        let contrast = |entry: usize| {
            // The difference is the mean over the three channels.
            let squared = ((entry * CONTRAST_STEP) as f32 + 0.5 * CONTRAST_STEP as f32) / 3.0;
            let fall = if config.contrast_sigma > 0.0 && entry > 0 {
                (-squared / (2.0 * config.contrast_sigma * config.contrast_sigma)).exp()
            } else {
                1.0
            };
            if config.contrast_sigma > 0.0 {
                config.contrast_floor + (1.0 - config.contrast_floor) * fall
            } else {
                1.0
            }
        };
        Self {
            config: *config,
            network_odds: odds(config.network_temperature, config.network_clip),
            belief_odds: odds(1.0, config.belief_clip),
            contrast: (0..CONTRAST_ENTRIES).map(contrast).collect(),
        }
    }

    /// Writes the capacities of `inputs`.
    ///
    /// # Panics
    /// Where an input is not of the capacities' size.
    pub fn fill(&self, inputs: &CrfInputs<'_>, capacities: &mut Capacities) {
        let count = capacities.width * capacities.height;
        assert!(
            inputs.probability.road.len() == count
                && inputs.indicator.len() == count
                && inputs.belief.len() == count
                && inputs.road_score.len() == count
                && inputs.not_road_score.len() == count
                && inputs.rgb.pixels().len() == 3 * count
        );
        for p in 0..count {
            let (road, not_road) = match self.config.form {
                TermForm::Paper => self.paper_unary(inputs, p),
                TermForm::Calibrated => self.calibrated_unary(inputs, p),
            };
            capacities.sink[p] = capacity(road);
            capacities.source[p] = capacity(not_road);
        }
        self.fill_pairwise(inputs, capacities);
    }

    /// Costs of road and not road: D1 + D2 + D3 as printed.
    fn paper_unary(&self, inputs: &CrfInputs<'_>, p: usize) -> (f32, f32) {
        let config = &self.config;
        let (mut road, mut not_road) = (0.0, 0.0);
        if config.ablation != Ablation::TwoD {
            let previous = inputs.indicator_previous.and_then(|indicator| indicator.get(p));
            for &meets_plane in [Some(&inputs.indicator[p]), previous].into_iter().flatten() {
                if meets_plane != 0 {
                    not_road += config.omega_2;
                } else {
                    road += config.omega_1;
                }
            }
        }
        if config.ablation != Ablation::ThreeD {
            road += config.omega_3 * inputs.probability.not_road[p];
            not_road += config.omega_3 * inputs.probability.road[p];
        }
        (road, not_road)
    }

    /// Costs of road and not road: the weighted log-odds of all evidence, on the side that it speaks against.
    fn calibrated_unary(&self, inputs: &CrfInputs<'_>, p: usize) -> (f32, f32) {
        let config = &self.config;
        let mut odds = 0.0;
        if config.ablation != Ablation::TwoD {
            odds += config.belief * look_up(&self.belief_odds, inputs.belief[p]);
            if let Some(&previous) = inputs.belief_previous.and_then(|belief| belief.get(p)) {
                odds += config.belief_previous * look_up(&self.belief_odds, previous);
            }
        }
        if config.ablation != Ablation::ThreeD {
            let (road, not_road) = (inputs.probability.road[p], inputs.probability.not_road[p]);
            odds += config.network * look_up(&self.network_odds, road / (road + not_road));
        }
        ((-odds).max(0.0), odds.max(0.0))
    }

    fn fill_pairwise(&self, inputs: &CrfInputs<'_>, capacities: &mut Capacities) {
        let (width, height) = (capacities.width, capacities.height);
        let pixels = inputs.rgb.pixels();
        for y in 0..height {
            for x in 0..width {
                let p = y * width + x;
                capacities.right[p] = if x + 1 < width {
                    self.pairwise(inputs, pixels, p, p + 1)
                } else {
                    0
                };
                capacities.down[p] = if y + 1 < height {
                    self.pairwise(inputs, pixels, p, p + width)
                } else {
                    0
                };
            }
        }
    }

    /// `V(p,q) = P_R(p|i) P_R(q|j) + P_notR(p|i) P_notR(q|j)`, scaled, and weaker across an edge of the image.
    fn pairwise(&self, inputs: &CrfInputs<'_>, pixels: &[u8], p: usize, q: usize) -> i32 {
        let config = &self.config;
        let alike =
            inputs.road_score[p] * inputs.road_score[q] + inputs.not_road_score[p] * inputs.not_road_score[q];
        let alike = config.smoothness_floor + (1.0 - config.smoothness_floor) * alike;
        let (a, b) = (&pixels[3 * p..3 * p + 3], &pixels[3 * q..3 * q + 3]);
        let squared = |k: usize| usize::from(a[k].abs_diff(b[k])) * usize::from(a[k].abs_diff(b[k]));
        let entry = (squared(0) + squared(1) + squared(2)) / CONTRAST_STEP;
        capacity(config.smoothness * alike * self.contrast[entry.min(CONTRAST_ENTRIES - 1)])
    }
}

/// An energy as a capacity; NaN and negative energies are none.
fn capacity(energy: f32) -> i32 {
    (energy * UNIT + 0.5).clamp(0.0, MAX_CAPACITY) as i32
}

/// Log-odds of a probability; none for NaN.
fn look_up(table: &[f32], probability: f32) -> f32 {
    if probability.is_nan() {
        return 0.0;
    }
    let step = (probability.clamp(0.0, 1.0) * ODDS_STEPS as f32 + 0.5) as usize;
    table[step.min(ODDS_STEPS)]
}
