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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crf::Ablation;
    use crate::frame::RgbImage;
    use crate::segmentation::RoadProbability;
    use alloc::vec::Vec;

    const WIDTH: usize = 33;
    const HEIGHT: usize = 25;
    const COUNT: usize = WIDTH * HEIGHT;

    /// Road is the left half; the network is noisy, the plane says road everywhere but in the last column.
    struct Scene {
        probability: RoadProbability,
        indicator: Vec<u8>,
        belief: Vec<f32>,
        score: Vec<f32>,
        rgb: RgbImage,
    }

    impl Scene {
        fn new() -> Self {
            let mut scene = Self {
                probability: RoadProbability::new(WIDTH, HEIGHT),
                indicator: vec![1; COUNT],
                belief: vec![0.6; COUNT],
                score: vec![0.7; COUNT],
                rgb: RgbImage::new(WIDTH, HEIGHT),
            };
            for p in 0..COUNT {
                let is_road = p % WIDTH < WIDTH / 2;
                let noise = (p * 7919 % 101) as f32 / 101.0;
                let road = if is_road {
                    0.9 - 0.6 * noise * noise
                } else {
                    0.1 + 0.6 * noise * noise
                };
                scene.probability.road[p] = road;
                scene.probability.not_road[p] = 1.0 - road;
                scene.rgb.pixels_mut()[3 * p..3 * p + 3].fill(if is_road { 90 } else { 160 });
                if p % WIDTH == WIDTH - 1 {
                    scene.indicator[p] = 0;
                }
            }
            scene
        }

        fn inputs(&self) -> CrfInputs<'_> {
            CrfInputs {
                probability: &self.probability,
                indicator: &self.indicator,
                indicator_previous: Some(&self.indicator),
                belief: &self.belief,
                belief_previous: None,
                road_score: &self.score,
                not_road_score: &self.score,
                rgb: &self.rgb,
            }
        }
    }

    fn solve(stage: &mut CrfStage, inputs: &CrfInputs<'_>) {
        stage.base(inputs);
        for _ in 0..10_000 {
            if !stage.refine(500) {
                break;
            }
        }
        assert!(stage.solved());
    }

    #[test]
    fn noise_is_smoothed_away_up_to_the_edge_of_the_image() {
        let scene = Scene::new();
        let mut stage = CrfStage::new(WIDTH, HEIGHT, &CrfConfig::default());
        solve(&mut stage, &scene.inputs());
        for p in 0..COUNT {
            assert_eq!(stage.labels()[p], u8::from(p % WIDTH < WIDTH / 2), "pixel {p}");
        }
        assert!(stage.gap().abs() < 1e-6);
    }

    #[test]
    fn stopped_anywhere_the_margin_agrees_with_the_labels() {
        let scene = Scene::new();
        let mut stage = CrfStage::new(WIDTH, HEIGHT, &CrfConfig::default());
        stage.base(&scene.inputs());
        let mut gap = f32::INFINITY;
        loop {
            assert!(stage.gap() <= gap);
            gap = stage.gap();
            for (&label, &margin) in stage.labels().iter().zip(stage.margin()) {
                assert_eq!(label != 0, margin > 0.5);
            }
            if !stage.refine(50) {
                break;
            }
        }
    }

    #[test]
    fn as_printed_the_plane_outvotes_a_certain_network() {
        let mut scene = Scene::new();
        scene.probability.road.fill(0.0);
        scene.probability.not_road.fill(1.0);
        let mut stage = CrfStage::new(WIDTH, HEIGHT, &CrfConfig::paper());
        solve(&mut stage, &scene.inputs());
        assert_eq!(
            stage.labels().iter().map(|&l| usize::from(l)).sum::<usize>(),
            COUNT - HEIGHT
        );
        let two_d = CrfConfig {
            ablation: Ablation::TwoD,
            ..CrfConfig::paper()
        };
        let mut stage = CrfStage::new(WIDTH, HEIGHT, &two_d);
        solve(&mut stage, &scene.inputs());
        assert!(stage.labels().iter().all(|&l| l == 0));
    }

    #[test]
    fn garbage_is_no_evidence() {
        let mut scene = Scene::new();
        scene.probability.road.fill(f32::NAN);
        scene.belief.fill(f32::NAN);
        scene.score.fill(f32::NAN);
        let mut stage = CrfStage::new(WIDTH, HEIGHT, &CrfConfig::default());
        solve(&mut stage, &scene.inputs());
        assert!(stage.margin().iter().all(|m| (m - 0.5).abs() < 0.1));
    }
}
