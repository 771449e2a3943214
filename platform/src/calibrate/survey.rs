//! A recording driven through the pipeline for what it says of the car: stretches of travel, and the road's plane.
//!
//! In: the pipeline's settings and the devices. Out: [`Stretch`]es, one for each key-frame interval in which the camera's pose was
//! tracked well throughout. Invariant: a stretch never spans an answer of the map, which moves and rescales the poses: it begins
//! with the first frame after a key frame and ends with the next key frame. Cost: that of a replay, the network left out.

use freespace::crf::CrfConfig;
use freespace::health::{ScaleState, TrackingState};
use freespace::pipeline::PipelineConfig;
use freespace::port::{CameraPort, WheelPort};
use freespace::segmentation::{ChannelOrder, NetworkShape, TileConfig};
use freespace::space::{Micros, Plane, Pose};
use nalgebra::Vector3;

use crate::clock::MonotonicClock;
use crate::runtime::memory::MemoryPlan;
use crate::runtime::rights::RealTimeConfig;
use crate::runtime::{Devices, FrameReport, KeyFrameReport, Observer, Setup, run_in_lockstep};
use crate::segmenter::{Segmenter, SegmenterError};

/// Travel between two frames of one chain of poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// Stamps of its first and last frame.
    pub stamps: (Micros, Micros),
    /// Travel in camera space as it lies half way.
    pub travel: Vector3<f64>,
    /// Turn about the camera's down axis from first to last frame, positive to the right.
    pub turn_rad: f64,
    /// What the wheels say of its length.
    pub wheel_m: Option<f64>,
    /// The road at its end, in camera space; none where too few landmarks lay on it.
    pub plane: Option<Plane>,
    /// Where the map's scale came from at its end.
    pub scale: ScaleState,
}

/// What a survey saw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Survey {
    /// Stretches in their order.
    pub stretches: Vec<Stretch>,
    /// Frames of the recording.
    pub frames: u64,
    /// Frames that were tracked well.
    pub tracked: u64,
}

impl Survey {
    /// Metres of all stretches.
    #[must_use]
    pub fn travelled_m(&self) -> f64 {
        self.stretches.iter().map(|stretch| stretch.travel.norm()).sum()
    }
}

/// A frame of the chain under way.
#[derive(Clone, Copy)]
struct Link {
    stamp: Micros,
    world_from_camera: Pose,
    wheel_m: Option<f64>,
}

/// Drives a recording through the pipeline; `progress` is told the number of each frame.
pub fn survey(
    mut config: PipelineConfig,
    camera: Box<dyn CameraPort + Send>,
    wheels: Option<Box<dyn WheelPort + Send>>,
    progress: &mut dyn FnMut(u64),
) -> Survey {
    let (width, height) = (config.camera.width, config.camera.height);
    // Masks and grids are not looked at: the smallest picture that every stage takes.
    config.working_size = (WORKING_WIDTH, (WORKING_WIDTH * height / width.max(1)).max(16));
    config.crf = CrfConfig::default();
    let mut surveyor = Surveyor {
        survey: Survey::default(),
        chain: Vec::new(),
        progress,
    };
    let devices = Devices {
        camera,
        wheels,
        segmenter: Box::new(Blind::new()),
        tiles: TileConfig::default(),
        sinks: Vec::new(),
    };
    run_in_lockstep(
        Setup {
            config,
            devices,
            real_time: RealTimeConfig::default(),
            plan: MemoryPlan::new(),
            lacks: Vec::new(),
            clock: MonotonicClock::default(),
            slow: None,
        },
        &mut surveyor,
    );
    surveyor.survey
}

const WORKING_WIDTH: usize = 128;

struct Surveyor<'a> {
    survey: Survey,
    chain: Vec<Link>,
    progress: &'a mut dyn FnMut(u64),
}

impl Observer for Surveyor<'_> {
    fn frame(&mut self, report: &FrameReport) {
        let estimate = &report.outcome.estimate;
        let is_good = estimate.state == TrackingState::Good;
        self.survey.frames += 1;
        self.survey.tracked += u64::from(is_good);
        (self.progress)(report.index);
        if is_good {
            self.chain.push(Link {
                stamp: report.stamp,
                world_from_camera: estimate.world_from_camera,
                wheel_m: estimate.travel.map(|travel| travel.distance_m),
            });
        } else {
            self.chain.clear();
        }
        if !report.outcome.is_key_frame {
            return;
        }
        self.survey.stretches.extend(stretch(&self.chain));
        self.chain.clear();
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        let output = report.output;
        let seen = output.priors.plane.filter(|plane| plane.inliers > 0);
        if let Some(last) = self.survey.stretches.last_mut()
            && last.stamps.1 == output.stamp
            && output.has_frame
        {
            last.plane = seen.map(|_| output.plane_in_camera);
            last.scale = output.scale;
        }
    }
}

fn stretch(chain: &[Link]) -> Option<Stretch> {
    let [first, .., last] = chain else {
        return None;
    };
    let (from, to) = (&first.world_from_camera, &last.world_from_camera);
    let turn = from.rotation.inverse() * to.rotation;
    let half_way = from.rotation * turn.powf(0.5);
    let travel = half_way.inverse() * (to.translation.vector - from.translation.vector);
    Some(Stretch {
        stamps: (first.stamp, last.stamp),
        travel,
        turn_rad: turn.scaled_axis().y,
        wheel_m: last.wheel_m.zip(first.wheel_m).map(|(end, begin)| end - begin),
        plane: None,
        scale: ScaleState::Unknown,
    })
}

/// Stands in for the network: nothing of what it says is looked at, and certainty costs the least.
struct Blind {
    shape: NetworkShape,
    input: Vec<f32>,
    output: Vec<f32>,
}

impl Blind {
    fn new() -> Self {
        let shape = NetworkShape {
            width: 32,
            height: 24,
            classes: 2,
            road: std::iter::once(0).collect(),
            vehicle: std::iter::empty().collect(),
            mean: [0.0; 3],
            scale: [1.0; 3],
            order: ChannelOrder::Rgb,
            out_width: 32,
            out_height: 24,
        };
        let mut output = vec![0.02; shape.output_len()];
        let half = output.len() / 2;
        output[half..].fill(0.98);
        Self {
            input: vec![0.0; shape.input_len()],
            output,
            shape,
        }
    }
}

impl Segmenter for Blind {
    fn name(&self) -> &str {
        "none"
    }

    fn shape(&self) -> &NetworkShape {
        &self.shape
    }

    fn run_in_place(
        &mut self,
        fill: &mut dyn FnMut(&mut [f32]),
        read: &mut dyn FnMut(&[f32]),
    ) -> Result<(), SegmenterError> {
        fill(&mut self.input);
        read(&self.output);
        Ok(())
    }
}
