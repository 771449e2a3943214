//! An observer that notes what it sees, and hands it on to another.
//!
//! In: reports of a run, on the caller's normal thread. Out: messages through a bounded channel; one that is full loses the
//! newest, counted. Cost: the encoding, 0.1 ms a key frame.

use std::sync::Arc;
use std::sync::mpsc::SyncSender;

use foxglove::schemas::packed_element_field::NumericType;
use foxglove::schemas::{Grid, Log, PackedElementField, Pose, Quaternion, Vector2, Vector3, log};
use freespace::emit::CanFrame;
use freespace::frame::Camera;
use freespace::health::QualityLevel;
use freespace::pipeline::KeyFrameOutput;

use super::cloud::cloud;
use super::format::{CanFrameNote, CanNote, FrameNote, KeyFrameNote, LateWorkNote, Topic};
use super::note::{Note, timestamp, transform};
use super::parts::{Counters, add};
use crate::eval::grid::GridLayout;
use crate::runtime::{FrameReport, KeyFrameReport, LateWork, Observer, Start, Status, Trace};
use crate::statistics::Publication;

/// Notes for the recorder.
pub(super) struct NoteTaker {
    pub(super) notes: SyncSender<Note>,
    pub(super) counters: Arc<Counters>,
    pub(super) camera: Camera,
    pub(super) layout: GridLayout,
}

impl NoteTaker {
    fn note(&self, note: Note) {
        if self.notes.try_send(note).is_err() {
            add(&self.counters.dropped_messages, 1);
        }
    }

    fn frame(&self, report: &FrameReport) {
        let estimate = &report.outcome.estimate;
        let pose = self.camera.world_from_vehicle(&estimate.world_from_camera);
        let placed = transform("world", "vehicle", &pose, report.stamp);
        self.note(Note::encoded(Topic::Transform, report.stamp, &placed));
        let note = FrameNote {
            frame: report.index,
            stamp_micros: report.stamp.0,
            micros: report.outcome.micros,
            is_key_frame: report.outcome.is_key_frame,
            tracking: format!("{:?}", estimate.state),
            learnt: report.learnt,
        };
        self.note(Note::json(Topic::Frame, report.stamp, &note));
    }

    fn publication(&self, publication: &Publication) {
        let note = KeyFrameNote {
            frame: publication.frame,
            stamp_micros: publication.stamp.0,
            latency_micros: publication.latency_micros,
            level: publication.level.name().to_owned(),
            is_miss: publication.is_miss,
            blame: publication.blame.map(|blame| blame.name().to_owned()),
            faults: publication.faults.names().map(str::to_owned).collect(),
            stage_micros: publication.times.0,
            refused: publication.cuts.refused,
            stopped_after: publication.cuts.stopped_after,
        };
        let left = publication.stamp.plus(publication.latency_micros);
        self.note(Note::json(Topic::KeyFrame, left, &note));
    }

    fn late_work(&self, work: &LateWork) {
        let note = LateWorkNote {
            frame: work.frame,
            stamp_micros: work.stamp.0,
            micros: work.micros,
            faults: work.faults.names().map(str::to_owned).collect(),
            stage_micros: work.times.0,
            refused: work.cuts.refused,
            stopped_after: work.cuts.stopped_after,
        };
        self.note(Note::json(Topic::LateWork, work.stamp.plus(work.micros), &note));
    }

    fn key_frame(&self, output: &KeyFrameOutput) {
        let left = output.stamp.plus(output.latency_micros);
        self.note(Note::encoded(Topic::Grid, left, &self.grid(output)));
        // What stands in for an answer holds the landmarks of an earlier one.
        if output.level < QualityLevel::Moved && !output.landmarks.is_empty() {
            let points = cloud(&output.landmarks, output.stamp);
            self.note(Note::encoded(Topic::Landmarks, left, &points));
        }
        self.can_frames(output);
    }

    fn can_frames(&self, output: &KeyFrameOutput) {
        let left = output.stamp.plus(output.latency_micros);
        if !output.can_frames.is_empty() {
            let frames = output.can_frames.iter().map(can_note).collect();
            self.note(Note::json(Topic::CanOut, left, &CanNote { frames }));
        }
    }

    /// The grid with x ahead along its columns and y left along its rows, as the schema has it.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "sizes of a grid, bytes as they are"
    )]
    fn grid(&self, output: &KeyFrameOutput) -> Grid {
        let GridLayout {
            rows,
            columns,
            cell_m,
            origin_in_vehicle_m: [ahead_m, left_m],
        } = self.layout;
        let cells = &output.grid.occupancy;
        let data: Vec<u8> = (0..columns)
            .flat_map(|column| (0..rows).map(move |row| cells[row * columns + column] as u8))
            .collect();
        Grid {
            timestamp: timestamp(output.stamp),
            frame_id: "vehicle".to_owned(),
            pose: Some(Pose {
                position: Some(Vector3 {
                    x: ahead_m,
                    y: left_m,
                    z: 0.0,
                }),
                orientation: Some(Quaternion {
                    x: 0.0,
                    y: 0.0,
                    z: 0.0,
                    w: 1.0,
                }),
            }),
            column_count: rows as u32,
            cell_size: Some(Vector2 { x: cell_m, y: cell_m }),
            row_stride: rows as u32,
            cell_stride: 1,
            fields: vec![PackedElementField {
                name: "occupancy".to_owned(),
                offset: 0,
                r#type: NumericType::Int8 as i32,
            }],
            data: data.into(),
        }
    }

    fn trace(&self, trace: &Trace) {
        let line = Log {
            timestamp: timestamp(trace.at),
            level: log::Level::Warning as i32,
            message: trace.event.to_string(),
            name: "freespace".to_owned(),
            file: String::new(),
            line: 0,
        };
        self.note(Note::encoded(Topic::Log, trace.at, &line));
    }
}

fn can_note(frame: &CanFrame) -> CanFrameNote {
    use std::fmt::Write as _;
    let mut data = String::with_capacity(2 * frame.data.len());
    for byte in &frame.data {
        // Writing to memory that grows cannot fail.
        let _ = write!(data, "{byte:02X}");
    }
    CanFrameNote {
        id: frame.id,
        extended: frame.extended,
        data,
    }
}

/// Notes what it sees, where a drive is recorded, and hands it on.
pub struct Noted<'a> {
    pub(super) taker: Option<&'a NoteTaker>,
    pub(super) inner: &'a mut dyn Observer,
    /// Reports that never came, as counted so far.
    pub(super) unreported: u64,
}

impl Observer for Noted<'_> {
    fn started(&mut self, start: &Start<'_>) {
        self.inner.started(start);
    }

    fn frame(&mut self, report: &FrameReport) {
        if let Some(taker) = self.taker {
            taker.frame(report);
        }
        self.inner.frame(report);
    }

    fn publication(&mut self, publication: &Publication) {
        if let Some(taker) = self.taker {
            taker.publication(publication);
        }
        self.inner.publication(publication);
    }

    fn late_work(&mut self, work: &LateWork) {
        if let Some(taker) = self.taker {
            taker.late_work(work);
        }
        self.inner.late_work(work);
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        if let Some(taker) = self.taker {
            taker.key_frame(report.output);
        }
        self.inner.key_frame(report);
    }

    fn trace(&mut self, trace: &Trace) {
        if let Some(taker) = self.taker {
            taker.trace(trace);
        }
        self.inner.trace(trace);
    }

    fn last_word(&mut self, output: &KeyFrameOutput) {
        if let Some(taker) = self.taker {
            taker.can_frames(output);
        }
        self.inner.last_word(output);
    }

    fn status(&mut self, status: &Status) {
        let unreported = status.drops.unreported.unwrap_or(0);
        if let Some(taker) = self.taker {
            let more = unreported.saturating_sub(self.unreported);
            add(&taker.counters.dropped_messages, more);
        }
        self.unreported = unreported;
        self.inner.status(status);
    }
}

#[cfg(test)]
#[path = "observer_tests.rs"]
mod tests;
