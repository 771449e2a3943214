//! The work of every key frame: *map*, *priors*, *segmentation*, *crf*, *grid*.

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::Vector3;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::stopwatch::Stopwatch;
use super::{KeyFrameJob, KeyFrameOutput, Pace, PipelineConfig};
use crate::budget::{BUNDLE_REFINEMENTS, CUT_QUANTA, CUT_QUANTUM_STEPS, ISLAND_RANGE_M};
use crate::crf::{Ablation, CrfInputs, CrfStage, Islands};
use crate::deadline::Slices;
use crate::frame::{Camera, Lens, PixelFormat, RawFrame, RayTable, RgbImage};
use crate::grid::GridStage;
use crate::health::{Blame, Faults, QualityLevel, ScaleState};
use crate::map::{Map, MapUpdate};
use crate::port::{Clock, NetworkMiss, RoadNetwork};
use crate::priors::{PriorsStage, ScaleEstimate};
use crate::segmentation::{ColourLines, RoadProbability, reproject};
use crate::space::{Plane, Pose};
use crate::stage::{Stage, StageProbe, StageTimes};

/// Confidence in road of what an island was, at most.
const ISLAND_CONFIDENCE: f32 = 0.45;
/// A scale measured with less confidence than this is not used (see [`ScaleEstimate::confidence`]).
const SCALE_CONFIDENCE: f32 = 0.1;
/// Share of a measured scale error that one key frame corrects.
const SCALE_GAIN: f64 = 0.25;
/// How much of a probability's distance from undecided survives where it stands in for a fresh one.
const REPROJECTED_TRUST: f32 = 0.8;

/// The work of every key frame.
pub struct KeyFrameTask {
    slices: Slices,
    pace: Pace,
    has_wheels: bool,
    ablation: Ablation,
    camera: Camera,
    map: Map,
    update: MapUpdate,
    priors: PriorsStage,
    rays: RayTable,
    working_lens: Lens,
    image: RgbImage,
    probability: RoadProbability,
    last_probability: RoadProbability,
    /// Pose of the key frame that `last_probability` belongs to.
    last_pose: Option<Pose>,
    colour_lines: ColourLines,
    road_score: Box<[f32]>,
    not_road_score: Box<[f32]>,
    crf: CrfStage,
    islands: Islands,
    grid: GridStage,
}

/// What the frame task learns from a key frame.
#[derive(Clone, Debug)]
pub struct Lesson {
    /// Index of the key frame's frame.
    pub frame: u64,
    /// Landmarks and the corrected pose.
    pub update: MapUpdate,
    /// Road plane in the key frame's camera space.
    pub plane_in_camera: Plane,
}

impl Lesson {
    /// An empty lesson.
    #[must_use]
    pub fn new() -> Box<Self> {
        Box::new(Self {
            frame: 0,
            update: MapUpdate::default(),
            plane_in_camera: Plane::default(),
        })
    }
}

impl KeyFrameTask {
    /// Allocates the stages *map*, *priors*, *segmentation*, *crf* and *grid*.
    #[must_use]
    pub fn new(config: &PipelineConfig, pace: Pace) -> Self {
        let camera = config.camera;
        let (width, height) = config.working_size;
        let working_lens = camera.lens_at(width, height);
        Self {
            slices: config.slices,
            pace,
            has_wheels: config.wheels.is_some(),
            ablation: config.crf.ablation,
            camera,
            map: Map::new(&camera, &config.map),
            update: MapUpdate::default(),
            priors: PriorsStage::new(&camera, config.priors, width, height),
            rays: RayTable::new(&working_lens, width, height),
            working_lens,
            image: RgbImage::new(width, height),
            probability: RoadProbability::new(width, height),
            last_probability: RoadProbability::new(width, height),
            last_pose: None,
            colour_lines: ColourLines::new(&config.colour),
            road_score: vec![0.5; width * height].into_boxed_slice(),
            not_road_score: vec![0.5; width * height].into_boxed_slice(),
            crf: CrfStage::new(width, height, &config.crf),
            islands: Islands::new(width, height),
            grid: GridStage::new(&camera, config.grid, width, height),
        }
    }

    /// Takes a job to its output. Whatever goes wrong, `output` holds a valid grid afterwards, and says how good it is.
    ///
    /// # Errors
    /// Whom to blame where it is too late for a grid: the publisher's fallback answers. Times and cuts of `output` are then
    /// those of the work that was done.
    pub fn step(
        &mut self,
        job: &KeyFrameJob,
        network: &mut impl RoadNetwork,
        clock: &impl Clock,
        probe: &impl StageProbe,
        output: &mut KeyFrameOutput,
        lesson: &mut Lesson,
    ) -> Result<(), Blame> {
        let mut watch = Stopwatch::new(clock, probe, &self.slices, self.pace, job);
        output.faults = job.faults;
        let is_network_begun = watch.has_time_for(Stage::Segmentation);
        if is_network_begun {
            network.begin(&job.image);
        }
        let is_map_fresh = self.refine_map(job, &mut watch, output);
        let world_from_camera = if is_map_fresh {
            self.refined_pose(job)
        } else {
            job.world_from_camera
        };
        let are_priors_fresh = self.see_priors(job, &world_from_camera, &mut watch);
        lesson.frame = job.frame;
        self.teach(is_map_fresh, lesson);
        let is_network_fresh = self.segment(
            job,
            &world_from_camera,
            is_network_begun.then_some(network),
            &mut watch,
            output,
        );
        let is_solved = self.label(&mut watch, output);
        if !watch.start(Stage::Grid) {
            output.times = watch.times;
            output.cuts = watch.cuts();
            return Err(self.blame(&watch.times, QualityLevel::Moved, Stage::Grid));
        }
        self.draw_grid(job, &world_from_camera, output);
        watch.end(Stage::Grid);

        output.sequence = job.sequence;
        output.frame = job.frame;
        output.has_frame = true;
        output.stamp = job.stamp;
        output.world_from_camera = world_from_camera;
        output.tracking = job.tracking;
        output.speed_mps = job.speed_mps;
        self.describe(output);
        let stale = Stale {
            is_lost: output.faults.contains(Faults::TRACKING_LOST),
            map: !is_map_fresh || output.landmarks.is_empty(),
            priors: !are_priors_fresh,
            plane: output.faults.contains(Faults::PLANE_HELD),
            scale: output.faults.contains(Faults::SCALE_HELD),
            network: !is_network_fresh,
            is_map_late: output.faults.contains(Faults::MAP_LATE),
            is_cut_stopped: !is_solved,
        };
        let (level, suspect) = stale.level();
        output.level = level;
        output.blame = suspect.map(|stage| self.blame(&watch.times, level, stage));
        output.times = watch.times;
        output.cuts = watch.cuts();
        Ok(())
    }

    /// Whom to blame for a level: a stage far beyond its slice takes the time of all that follow it; else the one that its
    /// stand-in replaced.
    fn blame(&self, times: &StageTimes, level: QualityLevel, suspect: Stage) -> Blame {
        let slowest = self.slices.slowest(times).filter(|_| level != QualityLevel::Full);
        Blame::Stage(slowest.unwrap_or(suspect))
    }

    /// What the stages know besides the grid.
    fn describe(&self, output: &mut KeyFrameOutput) {
        output.scale = self.map.scale_state();
        output.plane_in_camera = self.priors.plane_in_camera();
        output.priors.clone_from(self.priors.priors());
        if self.priors.priors().plane.is_none_or(|plane| plane.inliers == 0) {
            output.faults.insert(Faults::PLANE_HELD);
        }
        if self.map.scale_state() == ScaleState::Held {
            output.faults.insert(Faults::SCALE_HELD);
        }
        output.landmarks.clear();
        // The map holds no more than that.
        let _ = output.landmarks.extend_from_slice(self.map.landmarks());
    }

    /// Stage 3: the batch goes into the map, which is refined until its slice ends; whether it took place.
    fn refine_map(
        &mut self,
        job: &KeyFrameJob,
        watch: &mut Stopwatch<'_, impl Clock, impl StageProbe>,
        output: &mut KeyFrameOutput,
    ) -> bool {
        if !watch.start(Stage::Map) {
            output.faults.insert(Faults::MAP_LATE);
            return false;
        }
        let rejected = self.map.rejected_wheel_steps();
        self.map.insert(&job.batch);
        if self.map.rejected_wheel_steps() > rejected {
            // Over that step the landmarks carried the scale.
            output.faults.insert(Faults::WHEELS_SLIP | Faults::SCALE_HELD);
        }
        for _ in 0..BUNDLE_REFINEMENTS {
            if watch.is_over(Stage::Map) {
                output.faults.insert(Faults::MAP_LATE);
                break;
            }
            if !self.map.refine() {
                break;
            }
        }
        self.map.finish();
        if !self.has_wheels
            && let Some(scale) = self
                .priors
                .measure_scale(self.map.landmarks(), &self.map.newest_pose())
        {
            let is_first = self.map.scale_state() != ScaleState::CameraHeight;
            self.map.rescale(correction(&scale, is_first));
            self.map.finish();
        }
        watch.end(Stage::Map);
        true
    }

    /// The key frame's pose, moved as the map moved its newest view.
    fn refined_pose(&mut self, job: &KeyFrameJob) -> Pose {
        self.map.update_into(&mut self.update);
        match (&job.world_from_view, self.update.stamp) {
            (Some(world_from_view), Some(_)) => self.update.moved(world_from_view, &job.world_from_camera),
            _ => job.world_from_camera,
        }
    }

    /// Stage 4: plane and boxes of this key frame, or held ones; whether they are fresh.
    fn see_priors(
        &mut self,
        job: &KeyFrameJob,
        world_from_camera: &Pose,
        watch: &mut Stopwatch<'_, impl Clock, impl StageProbe>,
    ) -> bool {
        let is_fresh = watch.start(Stage::Priors);
        if is_fresh {
            self.priors
                .step(self.map.landmarks(), world_from_camera, job.stamp);
        } else {
            self.priors.hold(world_from_camera, job.stamp);
        }
        watch.end(Stage::Priors);
        is_fresh
    }

    fn teach(&self, is_map_fresh: bool, lesson: &mut Lesson) {
        lesson.update.copy_from(&self.update);
        if !is_map_fresh {
            lesson.update.stamp = None;
        }
        lesson.plane_in_camera = self.priors.plane_in_camera();
    }

    /// Stage 5: the network's answer, or the last one moved by the pose; then the colours. Whether the answer is fresh.
    fn segment(
        &mut self,
        job: &KeyFrameJob,
        world_from_camera: &Pose,
        network: Option<&mut impl RoadNetwork>,
        watch: &mut Stopwatch<'_, impl Clock, impl StageProbe>,
        output: &mut KeyFrameOutput,
    ) -> bool {
        let is_sound = watch.enter(Stage::Segmentation);
        let picture = RawFrame {
            stamp: job.stamp,
            format: PixelFormat::Rgb24,
            width: job.image.width(),
            height: job.image.height(),
            bytes: job.image.pixels(),
        };
        // Cannot fail: the working size is at most the camera's.
        let _ = picture.rgb_into(&mut self.image);
        core::mem::swap(&mut self.probability, &mut self.last_probability);
        let until = watch.wait_until(Stage::Segmentation);
        let answer = match network {
            _ if !is_sound => Err(NetworkMiss::Failed),
            Some(network) => watch.wait(|| network.finish(until, &mut self.probability)),
            None => Err(NetworkMiss::Late),
        };
        match answer {
            Ok(micros) => watch.times.add(Stage::Segmentation, micros),
            Err(miss) => {
                output.faults.insert(match miss {
                    NetworkMiss::Late | NetworkMiss::Busy => Faults::NETWORK_LATE,
                    NetworkMiss::Failed => Faults::NETWORK_FAILED,
                });
                self.reproject_last(world_from_camera);
            }
        }
        // Here, for the probabilities are this key frame's from now on, even if it is given up later.
        self.last_pose = Some(*world_from_camera);
        self.learn_colours();
        watch.end(Stage::Segmentation);
        answer.is_ok()
    }

    fn reproject_last(&mut self, world_from_camera: &Pose) {
        let Some(last_pose) = &self.last_pose else {
            self.probability.road.fill(0.5);
            self.probability.not_road.fill(0.5);
            return;
        };
        let previous_from_current = last_pose.inverse() * world_from_camera;
        reproject(
            &self.last_probability,
            &self.rays,
            &self.working_lens,
            &self.priors.plane_in_camera(),
            &previous_from_current,
            REPROJECTED_TRUST,
            &mut self.probability,
        );
    }

    /// The colours of road and not-road, learnt from the network's own pixels, or from the third dimension alone in its
    /// ablation.
    fn learn_colours(&mut self) {
        match self.ablation {
            Ablation::Joint | Ablation::TwoD => self.colour_lines.learn(&self.image, &self.probability.road),
            Ablation::ThreeD => self.colour_lines.learn(&self.image, self.priors.belief()),
        }
        self.colour_lines
            .score_into(&self.image, &mut self.road_score, &mut self.not_road_score);
    }

    /// Stage 6: the unaries' labels, then the cut until its slice ends; without a start each pixel goes by the network alone.
    /// Whether the cut came to its end.
    fn label(
        &mut self,
        watch: &mut Stopwatch<'_, impl Clock, impl StageProbe>,
        output: &mut KeyFrameOutput,
    ) -> bool {
        let is_started = watch.start(Stage::Crf);
        let is_solved = is_started && self.cut(watch);
        if !is_solved {
            output.faults.insert(Faults::CUT_STOPPED);
        }
        if is_started {
            output.energy_gap = self.crf.gap();
            self.take_labels(output);
        } else {
            output.energy_gap = 1.0;
            output.confidence.copy_from_slice(&self.probability.road);
            for (label, road) in output.labels.iter_mut().zip(&self.probability.road) {
                *label = u8::from(*road > 0.5);
            }
        }
        watch.end(Stage::Crf);
        is_solved
    }

    fn cut(&mut self, watch: &Stopwatch<'_, impl Clock, impl StageProbe>) -> bool {
        self.crf.base(&CrfInputs {
            probability: &self.probability,
            indicator: self.priors.indicator(),
            indicator_previous: Some(self.priors.indicator_previous()),
            belief: self.priors.belief(),
            belief_previous: Some(self.priors.belief_previous()),
            road_score: &self.road_score,
            not_road_score: &self.not_road_score,
            rgb: &self.image,
        });
        for _ in 0..CUT_QUANTA {
            if watch.is_over(Stage::Crf) || !self.crf.refine(CUT_QUANTUM_STEPS) {
                break;
            }
        }
        self.crf.solved()
    }

    /// Stage 7.
    fn draw_grid(&mut self, job: &KeyFrameJob, world_from_camera: &Pose, output: &mut KeyFrameOutput) {
        let grid = self.grid.step(
            &output.labels,
            &output.confidence,
            &self.probability.vehicle,
            self.priors.surface(),
            &self.priors.plane_in_camera(),
            &self.camera.world_from_vehicle(world_from_camera),
            job.stamp,
        );
        output.grid.copy_from(grid);
        output.boundary = *self.grid.boundary();
    }

    /// The cut's labels without islands, and confidences on the same side.
    fn take_labels(&mut self, output: &mut KeyFrameOutput) {
        output.labels.copy_from_slice(self.crf.labels());
        let near_row = self.row_at(ISLAND_RANGE_M);
        self.islands.remove(&mut output.labels, near_row);
        for ((confidence, margin), label) in output
            .confidence
            .iter_mut()
            .zip(self.crf.margin())
            .zip(&output.labels)
        {
            *confidence = if *label == 0 {
                margin.min(ISLAND_CONFIDENCE)
            } else {
                *margin
            };
        }
    }

    /// Row of the working image where the road straight ahead is `range_m` from the camera; the last one where it is not seen.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the image"
    )]
    fn row_at(&self, range_m: f64) -> usize {
        let height = self.rays.height();
        let plane = self.priors.plane_in_camera();
        let forward = Vector3::z() - plane.normal * plane.normal.z;
        let point = forward * range_m - plane.normal * plane.offset_m;
        let row = self
            .working_lens
            .project(&point)
            .map_or(height as f64, |pixel| pixel.y);
        row.clamp(0.0, height as f64) as usize
    }
}

/// What the map's lengths are multiplied by, without wheels: all that was measured at first, then a share of it, so that one
/// bad plane does not make the scale jump.
fn correction(scale: &ScaleEstimate, is_first: bool) -> f64 {
    if scale.confidence < SCALE_CONFIDENCE {
        1.0
    } else if is_first {
        scale.ratio
    } else {
        (SCALE_GAIN * scale.ratio.ln()).exp()
    }
}

/// What an answer had to do without.
struct Stale {
    is_lost: bool,
    /// A map that had no time, or has no landmark yet.
    map: bool,
    priors: bool,
    /// The priors ran, but found no plane: the one that mount and travel foretell stands in.
    plane: bool,
    scale: bool,
    network: bool,
    is_map_late: bool,
    is_cut_stopped: bool,
}

impl Stale {
    /// The ladder, read off what happened; and the stage that was done without.
    const fn level(&self) -> (QualityLevel, Option<Stage>) {
        if self.is_lost {
            (QualityLevel::NoFreshMap, Some(Stage::Track))
        } else if self.map {
            (QualityLevel::NoFreshMap, Some(Stage::Map))
        } else if self.priors {
            (QualityLevel::NoFreshMap, Some(Stage::Priors))
        } else if self.network {
            (QualityLevel::NoFreshNetwork, Some(Stage::Segmentation))
        } else if self.is_cut_stopped {
            (QualityLevel::NoRefinement, Some(Stage::Crf))
        } else if self.plane {
            (QualityLevel::NoRefinement, Some(Stage::Priors))
        } else if self.is_map_late || self.scale {
            (QualityLevel::NoRefinement, Some(Stage::Map))
        } else {
            (QualityLevel::Full, None)
        }
    }
}
