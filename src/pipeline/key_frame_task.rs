//! The work of every key frame: *map*, *priors*, *segmentation*, *crf*, *grid*.

use alloc::boxed::Box;
use alloc::vec;

use super::{KeyFrameJob, PipelineConfig, Stage, StageTimes};
use nalgebra::Vector3;

use crate::budget::{BUNDLE_REFINEMENTS, CUT_QUANTA, CUT_QUANTUM_STEPS, ISLAND_RANGE_M};
use crate::crf::{Ablation, CrfInputs, CrfStage, Islands};
use crate::deadline::{Announcement, Slices};
use crate::emit::{CanFrame, FreeSpaceMessage, can::FRAMES};
use crate::frame::{Camera, Lens, PixelFormat, RawFrame, RayTable, RgbImage};
use crate::grid::{Boundary, Grid, GridStage};
use crate::health::{Faults, QualityLevel, ScaleState, TrackingState};
use crate::map::{Map, MapUpdate};
use crate::port::{Clock, NetworkMiss, RoadNetwork};
use crate::priors::{Priors, PriorsStage, ScaleEstimate};
use crate::segmentation::{ColourLines, RoadProbability, reproject};
use crate::space::{Micros, Plane, Pose};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

/// Confidence in road of what an island was, at most.
const ISLAND_CONFIDENCE: f32 = 0.45;
/// A scale measured with less confidence than this is not used (see [`ScaleEstimate::confidence`]).
const SCALE_CONFIDENCE: f32 = 0.1;
/// Share of a measured scale error that one key frame corrects.
const SCALE_GAIN: f64 = 0.25;
/// How much of a probability's distance from undecided survives where it stands in for a fresh one.
const REPROJECTED_TRUST: f32 = 0.8;

/// Everything a key frame gives.
#[derive(Clone, Debug)]
pub struct KeyFrameOutput {
    /// Number of the key frame.
    pub sequence: u32,
    /// Index of its frame.
    pub frame: u64,
    /// Capture stamp.
    pub stamp: Micros,
    /// Refined pose.
    pub world_from_camera: Pose,
    /// State of the tracker.
    pub tracking: TrackingState,
    /// Where the scale comes from.
    pub scale: ScaleState,
    /// Speed over ground.
    pub speed_mps: f64,
    /// Quality.
    pub level: QualityLevel,
    /// Its reasons.
    pub faults: Faults,
    /// Labels at working size, `[height, width] u8`, 1 = road.
    pub labels: Box<[u8]>,
    /// Confidence in road at working size, `[height, width] f32` in 0..1.
    pub confidence: Box<[f32]>,
    /// Bound on the relative gap between the labelling's energy and the minimum.
    pub energy_gap: f32,
    /// Road plane in camera space.
    pub plane_in_camera: Plane,
    /// Road plane and boxes in world space.
    pub priors: Priors,
    /// The grid.
    pub grid: Grid,
    /// Free distance in each bearing sector.
    pub boundary: Boundary,
    /// Landmarks in the map.
    pub landmarks: usize,
    /// The free-space message, `message_len` bytes of it.
    pub message: Box<[u8]>,
    /// See `message`.
    pub message_len: usize,
    /// The CAN frames.
    pub can_frames: heapless::Vec<CanFrame, FRAMES>,
    /// Time spent in each stage.
    pub times: StageTimes,
}

impl KeyFrameOutput {
    /// An empty output of the sizes of `config`.
    #[must_use]
    pub fn new(config: &PipelineConfig) -> Box<Self> {
        let (width, height) = config.working_size;
        let grid = Grid::sized(&config.grid);
        Box::new(Self {
            message: vec![0; FreeSpaceMessage::encoded_len(grid.rows * grid.columns)].into_boxed_slice(),
            message_len: 0,
            can_frames: heapless::Vec::new(),
            sequence: 0,
            frame: 0,
            stamp: Micros::default(),
            world_from_camera: Pose::identity(),
            tracking: TrackingState::DeadReckoning,
            scale: ScaleState::default(),
            speed_mps: 0.0,
            level: QualityLevel::Invalid,
            faults: Faults::NONE,
            labels: vec![0; width * height].into_boxed_slice(),
            confidence: vec![0.0; width * height].into_boxed_slice(),
            energy_gap: 1.0,
            plane_in_camera: config.camera.mount.plane_in_camera(),
            priors: Priors::default(),
            grid,
            boundary: Boundary::new(0.0, 0.0),
            landmarks: 0,
            times: StageTimes::default(),
        })
    }

    /// Takes over another output of the same sizes, but for what was emitted of it.
    pub fn copy_from(&mut self, other: &Self) {
        let Self {
            labels,
            confidence,
            grid,
            ..
        } = self;
        labels.copy_from_slice(&other.labels);
        confidence.copy_from_slice(&other.confidence);
        grid.copy_from(&other.grid);
        self.boundary = other.boundary;
        self.priors.clone_from(&other.priors);
        self.sequence = other.sequence;
        self.frame = other.frame;
        self.stamp = other.stamp;
        self.world_from_camera = other.world_from_camera;
        self.tracking = other.tracking;
        self.scale = other.scale;
        self.speed_mps = other.speed_mps;
        self.level = other.level;
        self.faults = other.faults;
        self.energy_gap = other.energy_gap;
        self.plane_in_camera = other.plane_in_camera;
        self.landmarks = other.landmarks;
        self.times = other.times;
    }

    /// Becomes the answer to a key frame whose own is late: the last grid, moved by the ego motion and aged, or an invalid
    /// one before there was any. `carrier` has adopted the last grid.
    pub fn fall_back(
        &mut self,
        last: Option<&Self>,
        awaited: &Announcement,
        camera: &Camera,
        carrier: &mut GridStage,
    ) {
        if let Some(last) = last {
            self.copy_from(last);
            carrier.carry(
                &camera.world_from_vehicle(&awaited.world_from_camera),
                awaited.stamp,
            );
            self.grid.copy_from(carrier.grid());
            self.boundary = *carrier.boundary();
            self.level = QualityLevel::Moved;
        } else {
            self.labels.fill(0);
            self.confidence.fill(0.0);
            self.level = QualityLevel::Invalid;
            self.faults = Faults::NONE;
        }
        self.sequence = awaited.sequence;
        self.frame = awaited.frame;
        self.stamp = awaited.stamp;
        self.world_from_camera = awaited.world_from_camera;
        self.faults.insert(Faults::DEADLINE_MISSED);
        self.times = StageTimes::default();
    }
}

/// Whether the clock may cut refinement short.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Slices end by the clock.
    Real,
    /// Slices end by their work caps only, so that the same input gives the same output.
    Reproducible,
}

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
    pub fn step(
        &mut self,
        job: &KeyFrameJob,
        network: &mut impl RoadNetwork,
        clock: &impl Clock,
        output: &mut KeyFrameOutput,
        lesson: &mut Lesson,
    ) {
        let mut lap = Lap::new(clock, job.times);
        output.faults = job.faults;
        network.begin(&job.image);
        lap.end(Stage::Segmentation);

        self.refine_map(job, clock, output);
        lap.end(Stage::Map);

        let world_from_camera = self.refined_pose(job);
        self.priors
            .step(self.map.landmarks(), &world_from_camera, job.stamp);
        self.teach(lesson);
        lap.end(Stage::Priors);

        let is_fresh = self.segment(job, &world_from_camera, network, output, &mut lap);
        self.learn_colours();
        lap.end(Stage::Segmentation);

        self.label(job, clock, output);
        lap.end(Stage::Crf);

        let plane_in_camera = self.priors.plane_in_camera();
        let grid = self.grid.step(
            &output.labels,
            &output.confidence,
            &self.probability.vehicle,
            self.priors.surface(),
            &plane_in_camera,
            &self.camera.world_from_vehicle(&world_from_camera),
            job.stamp,
        );
        output.grid.copy_from(grid);
        output.boundary = *self.grid.boundary();
        lap.end(Stage::Grid);

        output.sequence = job.sequence;
        output.frame = job.frame;
        output.stamp = job.stamp;
        output.world_from_camera = world_from_camera;
        output.tracking = job.tracking;
        output.scale = self.map.scale_state();
        output.speed_mps = job.speed_mps;
        output.plane_in_camera = plane_in_camera;
        output.priors.clone_from(self.priors.priors());
        if self.priors.priors().plane.is_none_or(|plane| plane.inliers == 0) {
            output.faults.insert(Faults::PLANE_HELD);
        }
        if self.map.scale_state() == ScaleState::Held {
            output.faults.insert(Faults::SCALE_HELD);
        }
        output.landmarks = self.map.landmarks().len();
        output.level = level(output.faults, is_fresh, self.crf.solved());
        output.times = lap.times;
        self.last_pose = Some(world_from_camera);
    }

    /// Stage 3: the batch goes into the map, which is refined until its slice ends.
    fn refine_map(&mut self, job: &KeyFrameJob, clock: &impl Clock, output: &mut KeyFrameOutput) {
        self.map.insert(&job.batch);
        let ends = job.stamp.plus(self.slices.map_micros);
        for _ in 0..BUNDLE_REFINEMENTS {
            if self.is_over(clock, ends) {
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
    }

    /// The key frame's pose, moved as the map moved its newest view.
    fn refined_pose(&mut self, job: &KeyFrameJob) -> Pose {
        self.map.update_into(&mut self.update);
        match (&job.world_from_view, self.update.stamp) {
            (Some(world_from_view), Some(_)) => self.update.moved(world_from_view, &job.world_from_camera),
            _ => job.world_from_camera,
        }
    }

    fn teach(&mut self, lesson: &mut Lesson) {
        lesson.update.copy_from(&self.update);
        lesson.plane_in_camera = self.priors.plane_in_camera();
    }

    /// Stage 5, first half: the network's answer, or the last one moved by the pose; whether it is fresh.
    fn segment(
        &mut self,
        job: &KeyFrameJob,
        world_from_camera: &Pose,
        network: &mut impl RoadNetwork,
        output: &mut KeyFrameOutput,
        lap: &mut Lap<'_, impl Clock>,
    ) -> bool {
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
        let until = job.stamp.plus(self.slices.segmentation_micros);
        let until = (self.pace == Pace::Real).then_some(until);
        match network.finish(until, &mut self.probability) {
            Ok(micros) => {
                lap.times.add(Stage::Segmentation, micros);
                true
            }
            Err(miss) => {
                output.faults.insert(match miss {
                    NetworkMiss::Late | NetworkMiss::Busy => Faults::NETWORK_LATE,
                    NetworkMiss::Failed => Faults::NETWORK_FAILED,
                });
                self.reproject_last(world_from_camera);
                false
            }
        }
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

    /// Stage 5, second half: the colours of road and not-road, learnt from the network's own pixels, or from the third
    /// dimension alone in its ablation.
    fn learn_colours(&mut self) {
        match self.ablation {
            Ablation::Joint | Ablation::TwoD => self.colour_lines.learn(&self.image, &self.probability.road),
            Ablation::ThreeD => self.colour_lines.learn(&self.image, self.priors.belief()),
        }
        self.colour_lines
            .score_into(&self.image, &mut self.road_score, &mut self.not_road_score);
    }

    /// Stage 6: the unaries' labels, then the cut until its slice ends.
    fn label(&mut self, job: &KeyFrameJob, clock: &impl Clock, output: &mut KeyFrameOutput) {
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
        let ends = job.stamp.plus(self.slices.crf_micros);
        for _ in 0..CUT_QUANTA {
            if self.is_over(clock, ends) || !self.crf.refine(CUT_QUANTUM_STEPS) {
                break;
            }
        }
        if !self.crf.solved() {
            output.faults.insert(Faults::CUT_STOPPED);
        }
        output.energy_gap = self.crf.gap();
        self.take_labels(output);
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

    fn is_over(&self, clock: &impl Clock, ends: Micros) -> bool {
        self.pace == Pace::Real && clock.now() >= ends
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

/// The ladder, read off what happened.
fn level(faults: Faults, is_network_fresh: bool, is_solved: bool) -> QualityLevel {
    if faults.contains(Faults::TRACKING_LOST) {
        QualityLevel::NoFreshMap
    } else if !is_network_fresh {
        QualityLevel::NoFreshNetwork
    } else if !is_solved || faults.contains(Faults::MAP_LATE) {
        QualityLevel::NoRefinement
    } else {
        QualityLevel::Full
    }
}

/// Laps of the clock, added up a stage.
struct Lap<'a, C> {
    clock: &'a C,
    begin: Micros,
    times: StageTimes,
}

impl<'a, C: Clock> Lap<'a, C> {
    fn new(clock: &'a C, times: StageTimes) -> Self {
        Self {
            clock,
            begin: clock.now(),
            times,
        }
    }

    fn end(&mut self, stage: Stage) {
        let now = self.clock.now();
        self.times.add(stage, now.since(self.begin));
        self.begin = now;
    }
}
