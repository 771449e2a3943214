//! What a key frame gives, and what is published of it.

use alloc::boxed::Box;
use alloc::vec;

use super::PipelineConfig;
use crate::budget::MAX_LANDMARKS;
use crate::emit::{CanFrame, FreeSpaceMessage, can::FRAMES};
use crate::grid::{Boundary, Grid};
use crate::health::{Blame, Faults, QualityLevel, ScaleState, TrackingState};
use crate::map::Landmark;
use crate::priors::Priors;
use crate::space::{Micros, Plane, Pose};
use crate::stage::{Cuts, StageTimes};

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
    /// What held it back, where the level is not full.
    pub blame: Option<Blame>,
    /// Whether it belongs to a frame; else it answers for an instant at which none came.
    pub has_frame: bool,
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
    /// Landmarks of the map, in world space.
    pub landmarks: heapless::Vec<Landmark, MAX_LANDMARKS>,
    /// The free-space message, `message_len` bytes of it.
    pub message: Box<[u8]>,
    /// See `message`.
    pub message_len: usize,
    /// The CAN frames.
    pub can_frames: heapless::Vec<CanFrame, FRAMES>,
    /// Time spent in each stage.
    pub times: StageTimes,
    /// Where the clock cut the work short.
    pub cuts: Cuts,
    /// Number of the publication, from 0; set when it leaves.
    pub publication: u64,
    /// From capture to publication; set when it leaves.
    pub latency_micros: u64,
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
            blame: None,
            has_frame: true,
            labels: vec![0; width * height].into_boxed_slice(),
            confidence: vec![0.0; width * height].into_boxed_slice(),
            energy_gap: 1.0,
            plane_in_camera: config.camera.mount.plane_in_camera(),
            priors: Priors::default(),
            grid,
            boundary: Boundary::new(0.0, 0.0),
            landmarks: heapless::Vec::new(),
            times: StageTimes::default(),
            cuts: Cuts::default(),
            publication: 0,
            latency_micros: 0,
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
        self.blame = other.blame;
        self.has_frame = other.has_frame;
        self.energy_gap = other.energy_gap;
        self.plane_in_camera = other.plane_in_camera;
        self.landmarks.clear();
        // Same capacity on both sides.
        let _ = self.landmarks.extend_from_slice(&other.landmarks);
        self.times = other.times;
        self.cuts = other.cuts;
    }

    /// Forgets what an earlier key frame left: nothing is known yet.
    pub(super) fn clear(&mut self) {
        self.labels.fill(0);
        self.confidence.fill(0.0);
        self.grid.clear();
        self.boundary.free_m.fill(0.0);
        self.landmarks.clear();
        self.faults = Faults::NONE;
        self.blame = None;
        self.level = QualityLevel::Invalid;
        self.tracking = TrackingState::DeadReckoning;
        self.speed_mps = 0.0;
        self.times = StageTimes::default();
        self.cuts = Cuts::default();
    }

    /// Whether something else than the awaited answer left, or it left late.
    #[must_use]
    pub fn is_miss(&self) -> bool {
        self.level >= QualityLevel::Moved || self.faults.contains(Faults::DEADLINE_MISSED)
    }
}
