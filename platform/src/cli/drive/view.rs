//! Shows a run to whoever watches it: the observer's counters, stage times and picture, a view a key frame.

use std::collections::VecDeque;

use freespace::pipeline::PipelineConfig;

use crate::cli::Pace;
use crate::config::{Config, Sharing};
use crate::runtime::{KeyFrameReport, Status};
use crate::view::{PictureSource, ViewStatus, ViewWriter};

/// Lines that a view repeats.
const LINES: usize = 8;

/// Feeds the views of a run.
pub(in crate::cli) struct ViewFeed {
    writer: ViewWriter,
    labels_size: (usize, usize),
    status: Status,
    lines: VecDeque<String>,
}

impl ViewFeed {
    /// The views of a run at a pace, where its messages are shared; none where they cannot be had, which is told.
    pub(in crate::cli) fn open(config: &Config, pipeline: &PipelineConfig, pace: Pace) -> Option<Self> {
        let sharing = match config.sharing() {
            _ if pace == Pace::Fast => return None,
            Sharing::Off => return None,
            Sharing::Wanted(sharing) | Sharing::Required(sharing) => sharing,
        };
        match ViewWriter::open(&sharing) {
            Ok(writer) => Some(Self {
                writer,
                labels_size: pipeline.working_size,
                status: Status::default(),
                lines: VecDeque::with_capacity(LINES),
            }),
            Err(error) => {
                crate::cli::terminal::tell(format_args!(
                    "freespace: the monitor will see no picture: {error}"
                ));
                None
            }
        }
    }

    pub(super) const fn status(&mut self, status: &Status) {
        self.status = *status;
    }

    pub(super) fn line(&mut self, line: &str) {
        if self.lines.len() == LINES {
            self.lines.pop_front();
        }
        self.lines.push_back(line.to_owned());
    }

    /// A view that is lost is no loss to the run.
    pub(super) fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        let output = report.output;
        let status = ViewStatus {
            sequence: output.publication,
            stage_micros: output.times.0,
            frames: self.status.frames,
            dropped_frames: self.status.dropped_frames,
            key_frames: self.status.key_frames,
            deadline_misses: self.status.deadline_misses,
            restarts: self.status.restarts,
            landmarks: output.landmarks.len(),
            boxes: output.priors.boxes.len(),
            energy_gap: output.energy_gap,
            events: self.lines.iter().cloned().collect(),
        };
        let picture = report.job.map(|job| PictureSource {
            size: (job.image.width(), job.image.height()),
            pixels: job.image.pixels(),
            labels_size: self.labels_size,
            labels: &output.labels,
        });
        let _ = self.writer.write(&status, picture.as_ref());
    }
}
