//! Records a run.

use std::collections::BTreeMap;

use freespace::frame::Camera;
use freespace::pipeline::{KeyFrameOutput, PipelineConfig};
use nalgebra::{Point3, Vector3};

use super::layout;
use super::watch::Watch;
use crate::cli::Failure;
use crate::eval::grid::GridLayout;
use crate::runtime::{FrameReport, KeyFrameReport, Observer, RunSummary, Start, Status, Trace};
use crate::sink::recording::{
    FrameRecord, ImageView, KeyFrameRecord, Recording, RecordingError, RunCounts, ScoreOf, Upsampler,
};
use crate::statistics::{DriveStatistics, Publication};

/// Watches a run and writes what it gives; its memory does not grow with the run.
pub(in crate::cli) struct Recorder {
    watch: Watch,
    recording: Recording,
    camera: Camera,
    layout: GridLayout,
    names: BTreeMap<u64, String>,
    /// Stands in for the picture of a key frame that a fallback answered, one byte a pixel.
    black: Box<[u8]>,
    upsampler: Upsampler,
    /// Road of the last key frame, at the size of the camera.
    mask: Box<[u8]>,
    error: Option<RecordingError>,
}

/// What is left of a recorder when its run is over.
pub(in crate::cli) struct Recorded {
    pub(in crate::cli) recording: Recording,
    pub(in crate::cli) counts: RunCounts,
    pub(in crate::cli) statistics: DriveStatistics,
}

impl Recorder {
    /// A recorder for a run of `config`; frames without a name are named by their number.
    pub(in crate::cli) fn new(
        recording: Recording,
        config: &PipelineConfig,
        names: BTreeMap<u64, String>,
        watch: Watch,
    ) -> Self {
        let size = (config.camera.width, config.camera.height);
        Self {
            watch,
            recording,
            camera: config.camera,
            layout: layout(&config.grid),
            names,
            black: vec![0; size.0 * size.1].into_boxed_slice(),
            upsampler: Upsampler::new(config.working_size, size),
            mask: vec![0; size.0 * size.1].into_boxed_slice(),
            error: None,
        }
    }

    pub(in crate::cli) const fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// Name of a frame.
    fn name(&self, index: u64) -> String {
        self.names
            .get(&index)
            .cloned()
            .unwrap_or_else(|| format!("{index:06}"))
    }

    /// Labels of the key frame seen last, at the size of the camera, 1 = road.
    pub(in crate::cli) const fn mask(&self) -> &[u8] {
        &self.mask
    }

    /// Writes what is known to be true of a key frame, and the intersection over union of its free cells with those.
    pub(in crate::cli) fn record_truth(&mut self, index: u64, cells: &[i8], mask: &[u8], iou: Option<f64>) {
        let size = (self.camera.width, self.camera.height);
        let name = self.name(index);
        let written = self.recording.truth(&name, &self.layout, cells, mask, size);
        self.note(written);
        if let Some(iou) = iou {
            let written = self.recording.score(&name, ScoreOf::FreeSpace, iou);
            self.note(written);
        }
    }

    /// Writes a frame's true pose.
    pub(in crate::cli) fn record_true_pose(&mut self, frame: &FrameRecord) {
        let written = self.recording.true_pose(frame);
        self.note(written);
    }

    /// Keeps the first fault: a run goes on, and fails at its end.
    fn note(&mut self, written: Result<(), RecordingError>) {
        if self.error.is_none() {
            self.error = written.err();
        }
    }

    /// The recording and its counts, or the first fault that it met.
    pub(in crate::cli) fn finish(self, summary: &RunSummary) -> Result<Recorded, Failure> {
        let (counts, statistics) = self.watch.finish(summary);
        match self.error {
            Some(error) => Err(error.into()),
            None => Ok(Recorded {
                recording: self.recording,
                counts,
                statistics,
            }),
        }
    }

    fn record_can(&mut self, output: &KeyFrameOutput) -> Result<(), RecordingError> {
        let published = output.stamp.plus(output.latency_micros);
        self.recording
            .can_frames(output.stamp, published, &output.can_frames)
    }

    #[expect(clippy::cast_precision_loss, reason = "milliseconds")]
    fn record(&mut self, report: &KeyFrameReport<'_>) -> Result<(), RecordingError> {
        let output = report.output;
        let name = self.name(report.index);
        let outlines = self.outlines(report);
        let (channels, bytes) = report
            .job
            .map_or((1, &*self.black), |job| (3, job.image.pixels()));
        self.recording.key_frame(&KeyFrameRecord {
            name: &name,
            stamp: output.stamp,
            image: ImageView {
                width: self.camera.width,
                height: self.camera.height,
                channels,
                bytes,
            },
            mask: &self.mask,
            layout: self.layout,
            cells: &output.grid.occupancy,
            world_from_vehicle: self.camera.world_from_vehicle(&output.world_from_camera),
            level: output.level.name(),
            deadline_met: !report.output.is_miss(),
            publish_latency_ms: self
                .watch
                .is_timed()
                .then_some(output.latency_micros as f64 * 1e-3),
            times: output.times,
            can_frames: &output.can_frames,
            outlines: &outlines,
        })
    }

    /// Edges of the obstacle boxes in the picture.
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    fn outlines(&self, report: &KeyFrameReport<'_>) -> Vec<[(f32, f32); 2]> {
        let camera_from_world = report.output.world_from_camera.inverse();
        let mut segments = Vec::new();
        for obstacle in &report.output.priors.boxes {
            let corner = |bits: usize| {
                let sign = |axis: usize| if bits >> axis & 1 == 1 { 1.0 } else { -1.0 };
                let half = &obstacle.half_m;
                let local = Vector3::new(sign(0) * half.x, sign(1) * half.y, sign(2) * half.z);
                let point: Point3<f64> = camera_from_world * (obstacle.centre + obstacle.axes * local);
                if point.z < 0.3 {
                    return None;
                }
                self.camera
                    .lens
                    .project(&point.coords)
                    .map(|pixel| (pixel.x as f32, pixel.y as f32))
            };
            for from in 0..8 {
                for axis in 0..3 {
                    let to = from | 1 << axis;
                    if to != from
                        && let (Some(a), Some(b)) = (corner(from), corner(to))
                    {
                        segments.push([a, b]);
                    }
                }
            }
        }
        segments
    }
}

impl Observer for Recorder {
    fn started(&mut self, start: &Start<'_>) {
        self.watch.started(start);
    }

    fn frame(&mut self, report: &FrameReport) {
        self.watch.frame(report);
        let written = self.recording.frame(&FrameRecord {
            index: usize::try_from(report.index).unwrap_or(usize::MAX),
            stamp: report.stamp,
            world_from_camera: report.outcome.estimate.world_from_camera,
        });
        self.note(written);
    }

    fn publication(&mut self, publication: &Publication) {
        self.watch.publication(publication);
    }

    fn trace(&mut self, trace: &Trace) {
        self.watch.trace(trace);
    }

    fn last_word(&mut self, output: &KeyFrameOutput) {
        let written = self.record_can(output);
        self.note(written);
    }

    fn status(&mut self, status: &Status) {
        self.watch.status(status);
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        self.watch.key_frame(report);
        // What answers for an instant without a frame has no picture and no name: what the bus was told of it is all there is.
        if !report.output.has_frame {
            let written = self.record_can(report.output);
            self.note(written);
            return;
        }
        self.upsampler.upsample(&report.output.labels, &mut self.mask);
        if self.error.is_none() {
            self.error = self.record(report).err();
        }
    }
}
