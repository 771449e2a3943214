//! The stage: a labelling at once, then a cut at half resolution, then the full cut.
//!
//! Invariant: between calls the labels are valid and their energy never rises within a key frame.
//! Cost: `base` is one pass over the pixels; `refine` does about `max_steps` node visits, and once a key frame one more pass.
#![allow(
    clippy::cast_precision_loss,
    reason = "energies are shown as ratios; 24 bits of them are enough"
)]

use alloc::boxed::Box;
use alloc::vec;

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::{Capacities, CrfConfig, CrfInputs, CutState, Energy, GridCut, Halved, UNIT, halve};

/// P(road) of a pixel whose neighbours outvoted its own evidence stays this far on its label's side of 0.5.
const OUTVOTED_MARGIN: f32 = 0.05;

/// What `refine` does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    BeginHalf,
    Half,
    Full,
    Solved,
}

/// Stage 6. See the module.
#[derive(Clone, Debug)]
pub struct CrfStage {
    energy: Energy,
    capacities: Capacities,
    half_capacities: Capacities,
    cut: GridCut,
    half_cut: GridCut,
    /// The half cut's labels at full resolution.
    enlarged: Box<[u8]>,
    half_energy: i64,
    margin: Box<[f32]>,
    level: Level,
}

impl CrfStage {
    /// A stage for images of `width x height` pixels.
    #[must_use]
    pub fn new(width: usize, height: usize, config: &CrfConfig) -> Self {
        let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
        Self {
            energy: Energy::new(config),
            capacities: Capacities::new(width, height),
            half_capacities: Capacities::new(half_width, half_height),
            cut: GridCut::new(width, height),
            half_cut: GridCut::new(half_width, half_height),
            enlarged: vec![0; width * height].into_boxed_slice(),
            half_energy: i64::MAX,
            margin: vec![0.5; width * height].into_boxed_slice(),
            level: Level::Solved,
        }
    }

    /// Takes the evidence of a key frame; the labels are then those of each pixel alone.
    ///
    /// # Panics
    /// Where an input is not of the stage's size.
    pub fn base(&mut self, inputs: &CrfInputs<'_>) {
        self.energy.fill(inputs, &mut self.capacities);
        self.cut.start(&self.capacities.problem());
        self.level = Level::BeginHalf;
        self.update_margin();
    }

    /// Lowers the energy by about `max_steps` node visits; false once nothing is left to gain.
    pub fn refine(&mut self, max_steps: u32) -> bool {
        match self.level {
            Level::BeginHalf => {
                let Capacities {
                    source,
                    sink,
                    right,
                    down,
                    ..
                } = &mut self.half_capacities;
                halve(
                    &self.capacities.problem(),
                    &mut Halved {
                        source,
                        sink,
                        right,
                        down,
                    },
                );
                self.half_cut.start(&self.half_capacities.problem());
                self.half_energy = i64::MAX;
                self.level = Level::Half;
                self.refine_half(max_steps);
            }
            Level::Half => self.refine_half(max_steps),
            Level::Full => {
                let before = self.cut.bounds().1;
                if self.cut.advance(max_steps) == CutState::Done {
                    self.level = Level::Solved;
                }
                if self.cut.bounds().1 < before {
                    self.update_margin();
                }
            }
            Level::Solved => {}
        }
        self.level != Level::Solved
    }

    fn refine_half(&mut self, max_steps: u32) {
        let state = self.half_cut.advance(max_steps);
        let energy = self.half_cut.bounds().1;
        if energy < self.half_energy {
            self.half_energy = energy;
            self.enlarge();
            let before = self.cut.bounds().1;
            self.cut.offer(&self.enlarged);
            if self.cut.bounds().1 < before {
                self.update_margin();
            }
        }
        if state == CutState::Done {
            self.level = Level::Full;
        }
    }

    fn enlarge(&mut self) {
        let (width, half_width) = (self.cut.width(), self.half_cut.width());
        let half = self.half_cut.labels();
        for (y, row) in self.enlarged.chunks_exact_mut(width).enumerate() {
            let half_row = &half[y / 2 * half_width..][..half_width];
            for (x, label) in row.iter_mut().enumerate() {
                *label = half_row[x / 2];
            }
        }
    }

    /// P(road) from each pixel's own evidence, held on the side of its label.
    fn update_margin(&mut self) {
        let labels = self.cut.labels();
        for p in 0..labels.len() {
            let odds = (self.capacities.source[p] - self.capacities.sink[p]) as f32 / UNIT;
            let probability = 1.0 / (1.0 + (-odds).exp());
            self.margin[p] = if labels[p] != 0 {
                probability.max(0.5 + OUTVOTED_MARGIN)
            } else {
                probability.min(0.5 - OUTVOTED_MARGIN)
            };
        }
    }

    /// The best labelling so far, `[height, width] u8`, 1 = road.
    #[must_use]
    pub fn labels(&self) -> &[u8] {
        self.cut.labels()
    }

    /// P(road), `[height, width] f32`, over 0.5 exactly where the label is road.
    #[must_use]
    pub fn margin(&self) -> &[f32] {
        &self.margin
    }

    /// The labelling's energy over the minimum's, minus 1: at most this.
    #[must_use]
    pub fn gap(&self) -> f32 {
        let (lower, upper) = self.cut.bounds();
        (upper - lower) as f32 / lower.max(1) as f32
    }

    /// Whether the labelling is a minimum.
    #[must_use]
    pub fn solved(&self) -> bool {
        self.level == Level::Solved
    }
}
