//! The network beside the other stages: on a thread of its own, or, for a reproducible replay, inline.
//!
//! Hand-over: two boxes circulate between the key-frame task and the network's thread, over bounded channels. An answer that
//! missed its slice comes back before the next picture is handed over; while it is still under way the network is busy, and
//! the pictures in between are not segmented.

use std::io;
use std::thread;
use std::time::Instant;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use freespace::frame::RgbImage;
use freespace::pipeline::PipelineConfig;
use freespace::port::{NetworkMiss, RoadNetwork};
use freespace::segmentation::{InputFiller, OutputResampler, RoadProbability, TileConfig};
use freespace::space::Micros;

use super::allocation::outside_scopes;
use super::live::warm_up;
use crate::clock::MonotonicClock;
use crate::segmenter::{Segmenter, SegmenterError};

/// A network with the tiles, input and output it works on.
struct TiledNetwork {
    segmenter: Box<dyn Segmenter>,
    filler: InputFiller,
    resampler: OutputResampler,
    input: Vec<f32>,
    output: Vec<f32>,
}

impl TiledNetwork {
    fn new(segmenter: Box<dyn Segmenter>, config: &PipelineConfig, tiles: &TileConfig) -> Self {
        let shape = segmenter.shape().clone();
        let filler = InputFiller::new(&shape, config.camera.width, config.camera.height, tiles);
        let (width, height) = config.working_size;
        let resampler = OutputResampler::new(&shape, filler.tiles(), width, height);
        Self {
            input: vec![0.0; shape.input_len()],
            output: vec![0.0; shape.output_len()],
            segmenter,
            filler,
            resampler,
        }
    }

    fn run(&mut self, image: &RgbImage, out: &mut RoadProbability) -> Result<(), SegmenterError> {
        for tile in 0..self.filler.tiles().len() {
            self.filler.fill_rgb(image, tile, &mut self.input);
            self.segmenter.run(&self.input, &mut self.output)?;
            self.resampler.add_tile(&self.output, tile, out);
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
    number: u64,
    answer: Result<u64, NetworkMiss>,
}

/// Runs the network on a thread of its own.
pub struct ThreadedNetwork {
    idle: Option<Box<Task>>,
    to: Sender<Box<Task>>,
    from: Receiver<Box<Task>>,
    clock: MonotonicClock,
    number: u64,
    is_begun: bool,
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
    ) -> io::Result<Self> {
        let (to, queue) = bounded::<Box<Task>>(1);
        let (answers, from) = bounded::<Box<Task>>(1);
        warm_up(&from);
        let mut network = TiledNetwork::new(segmenter, config, tiles);
        thread::Builder::new().name("network".to_owned()).spawn(move || {
            for mut task in queue {
                let begin = Instant::now();
                let Task {
                    image,
                    probability,
                    answer,
                    ..
                } = &mut *task;
                *answer = network
                    .run(image, probability)
                    .map(|()| micros_since(begin))
                    .map_err(|_| NetworkMiss::Failed);
                if answers.send(task).is_err() {
                    return;
                }
            }
        })?;
        let (width, height) = config.working_size;
        let task = Task {
            image: RgbImage::new(config.camera.width, config.camera.height),
            probability: RoadProbability::new(width, height),
            number: 0,
            answer: Err(NetworkMiss::Failed),
        };
        Ok(Self {
            idle: Some(Box::new(task)),
            to,
            from,
            clock,
            number: 0,
            is_begun: false,
        })
    }
}

impl RoadNetwork for ThreadedNetwork {
    fn begin(&mut self, image: &RgbImage) {
        self.number += 1;
        // An answer that came too late for its key frame frees the network again.
        if self.idle.is_none() {
            self.idle = self.from.try_recv().ok();
        }
        self.is_begun = false;
        if let Some(mut task) = self.idle.take() {
            task.image.pixels_mut().copy_from_slice(image.pixels());
            task.number = self.number;
            self.is_begun = self.to.try_send(task).is_ok();
        }
    }

    fn finish(&mut self, until: Option<Micros>, out: &mut RoadProbability) -> Result<u64, NetworkMiss> {
        if !self.is_begun {
            return Err(NetworkMiss::Busy);
        }
        let received = match until {
            Some(until) => self.from.recv_timeout(self.clock.until(until)),
            None => self.from.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        let task = received.map_err(|error| match error {
            RecvTimeoutError::Timeout => NetworkMiss::Late,
            RecvTimeoutError::Disconnected => NetworkMiss::Failed,
        })?;
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
