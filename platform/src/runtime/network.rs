//! The network beside the other stages: on a thread of its own, or, for a reproducible replay, inline.
//!
//! Hand-over: one box goes back and forth between the key-frame task and the network's thread. An answer that missed its slice
//! comes back before the next picture is handed over.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

use freespace::frame::RgbImage;
use freespace::pipeline::PipelineConfig;
use freespace::port::{NetworkMiss, RoadNetwork};
use freespace::segmentation::{InputFiller, OutputResampler, RoadProbability, TileConfig};
use freespace::space::Micros;
use freespace::stage::{Progress, Stage, StageProbe as _};

use super::RunError;
use super::allocation::outside_scopes;
use super::handover::Mailbox;
use super::rights::{self, RealTimeConfig, ThreadRole};
use crate::clock::MonotonicClock;
use crate::segmenter::{Segmenter, SegmenterError, Stop};

/// A network with the tiles it works on.
struct TiledNetwork {
    segmenter: Box<dyn Segmenter>,
    filler: InputFiller,
    resampler: OutputResampler,
}

impl TiledNetwork {
    fn new(segmenter: Box<dyn Segmenter>, config: &PipelineConfig, tiles: &TileConfig) -> Self {
        let shape = segmenter.shape().clone();
        let filler = InputFiller::new(&shape, config.camera.width, config.camera.height, tiles);
        let (width, height) = config.working_size;
        let resampler = OutputResampler::new(&shape, filler.tiles(), width, height);
        Self {
            segmenter,
            filler,
            resampler,
        }
    }

    fn run(&mut self, image: &RgbImage, out: &mut RoadProbability) -> Result<(), SegmenterError> {
        for tile in 0..self.filler.tiles().len() {
            let Self {
                segmenter,
                filler,
                resampler,
            } = self;
            segmenter.run_in_place(&mut |input| filler.fill_rgb(image, tile, input), &mut |output| {
                resampler.add_tile(output, tile, out);
            })?;
        }
        Ok(())
    }
}

fn micros_since(begin: Instant) -> u64 {
    u64::try_from(begin.elapsed().as_micros()).unwrap_or(u64::MAX)
}

/// Runs the network when its answer is asked for.
pub struct InlineNetwork {
    network: TiledNetwork,
    image: RgbImage,
}

impl InlineNetwork {
    /// Allocates for the pictures of `config`.
    #[must_use]
    pub fn new(segmenter: Box<dyn Segmenter>, config: &PipelineConfig, tiles: &TileConfig) -> Self {
        let image = RgbImage::new(config.camera.width, config.camera.height);
        Self {
            network: TiledNetwork::new(segmenter, config, tiles),
            image,
        }
    }
}

impl RoadNetwork for InlineNetwork {
    fn begin(&mut self, image: &RgbImage) {
        self.image.pixels_mut().copy_from_slice(image.pixels());
    }

    fn finish(&mut self, _until: Option<Micros>, out: &mut RoadProbability) -> Result<u64, NetworkMiss> {
        let begin = Instant::now();
        // Engines allocate as they like; live, they do so on a thread of their own.
        outside_scopes(|| self.network.run(&self.image, out)).map_err(|_| NetworkMiss::Failed)?;
        Ok(micros_since(begin))
    }
}

/// What circulates between the key-frame task and the network's thread.
struct Task {
    image: RgbImage,
    probability: RoadProbability,
    answer: Result<u64, NetworkMiss>,
}

/// Runs the network on a thread of its own.
///
/// A run that is not over when its slice ends is told to stop. Until it does, the network is busy, and the pictures in between
/// are not segmented.
pub struct ThreadedNetwork {
    idle: Option<Box<Task>>,
    shared: Arc<Shared>,
    progress: Arc<Progress>,
    stopper: Option<Arc<dyn Stop>>,
    clock: MonotonicClock,
    is_begun: bool,
}

#[derive(Default)]
struct Shared {
    /// Pictures for the network's thread.
    pictures: Mailbox<Task>,
    /// Answers for the key-frame thread.
    answers: Mailbox<Task>,
}

impl ThreadedNetwork {
    /// Starts the thread; it ends when this is dropped.
    ///
    /// # Errors
    /// The thread could not be started.
    pub fn spawn(
        segmenter: Box<dyn Segmenter>,
        config: &PipelineConfig,
        tiles: &TileConfig,
        clock: MonotonicClock,
        real_time: RealTimeConfig,
    ) -> Result<Self, RunError> {
        let stopper = segmenter.stopper();
        let shared = Arc::new(Shared::default());
        let mut network = TiledNetwork::new(segmenter, config, tiles);
        let theirs = Arc::clone(&shared);
        let progress = Arc::<Progress>::default();
        let watched = Arc::clone(&progress);
        let thread = rights::thread_builder(ThreadRole::Network, &real_time).spawn(move || {
            // What is refused was told when the rights were tried, before the start.
            let _ = rights::enter(ThreadRole::Network, &real_time);
            theirs.pictures.claim();
            while let Some(mut task) = theirs.pictures.wait() {
                watched.enter(Stage::Segmentation);
                task.answer = answer(&mut network, &mut task);
                watched.rest();
                // There is one task, so nothing can be displaced.
                let _ = theirs.answers.post(task);
            }
        });
        thread.map_err(RunError::Thread)?;
        let (width, height) = config.working_size;
        let task = Task {
            image: RgbImage::new(config.camera.width, config.camera.height),
            probability: RoadProbability::new(width, height),
            answer: Err(NetworkMiss::Failed),
        };
        Ok(Self {
            idle: Some(Box::new(task)),
            shared,
            progress,
            stopper,
            clock,
            is_begun: false,
        })
    }

    /// Where its thread is, for whoever watches over threads that hang.
    pub(super) fn progress(&self) -> Arc<Progress> {
        Arc::clone(&self.progress)
    }

    /// Answers will be waited for by the calling thread.
    pub(super) fn claim(&self) {
        self.shared.answers.claim();
    }
}

/// One run; a panic of the engine is a failure like any other.
fn answer(network: &mut TiledNetwork, task: &mut Task) -> Result<u64, NetworkMiss> {
    let begin = Instant::now();
    let run = AssertUnwindSafe(|| network.run(&task.image, &mut task.probability));
    match catch_unwind(run) {
        Ok(Ok(())) => Ok(micros_since(begin)),
        Ok(Err(_)) | Err(_) => Err(NetworkMiss::Failed),
    }
}

impl Drop for ThreadedNetwork {
    fn drop(&mut self) {
        self.shared.pictures.close();
    }
}

impl RoadNetwork for ThreadedNetwork {
    fn begin(&mut self, image: &RgbImage) {
        // An answer that came too late for its key frame frees the network again.
        if self.idle.is_none() {
            self.idle = self.shared.answers.take();
        }
        self.is_begun = false;
        if let Some(mut task) = self.idle.take() {
            task.image.pixels_mut().copy_from_slice(image.pixels());
            self.is_begun = self.shared.pictures.post(task).is_none();
        }
    }

    fn finish(&mut self, until: Option<Micros>, out: &mut RoadProbability) -> Result<u64, NetworkMiss> {
        if !self.is_begun {
            return Err(NetworkMiss::Busy);
        }
        let until = until.unwrap_or(Micros(u64::MAX));
        let Some(task) = self.shared.answers.wait_until(&self.clock, until) else {
            if let Some(stopper) = &self.stopper {
                stopper.stop();
            }
            return Err(NetworkMiss::Late);
        };
        let answer = task.answer;
        if answer.is_ok() {
            out.road.copy_from_slice(&task.probability.road);
            out.not_road.copy_from_slice(&task.probability.not_road);
            out.vehicle.copy_from_slice(&task.probability.vehicle);
        }
        self.idle = Some(task);
        answer
    }
}
