//! A run written to a folder: trajectory, masks, overlays, bird's-eye views, grids, timing, report, and a page of it all.
//!
//! Everything is written into `DIR/.partial` and moved up when the run is finished, the report last; a run that fails
//! leaves nothing behind. A folder that holds anything but an earlier recording is refused.
//! Nothing here is bounded in time: call it from a thread of its own.

mod folder;
mod page;
mod picture;
mod report;
#[cfg(test)]
mod tests;
mod trajectory;

pub use picture::{ImageView, MaskView};
pub use report::{Percentiles, Report, RunCounts};

use std::io::Write;
use std::path::Path;

use freespace::emit::CanFrame;
use freespace::space::{Micros, Pose};
use serde::Serialize;

use crate::bad_input::BadInput;
use crate::eval::grid::GridLayout;
use crate::eval::{Truth, npy};
use folder::OutputFolder;

/// Why a recording failed.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum RecordingError {
    /// The folder is not ours to write to; choose another.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Folder(#[from] BadInput),
    /// A file could not be written: the disk is full or gone.
    #[error("{path}: cannot be written: {source}")]
    #[diagnostic(help("check that the disk has room and the folder may be written"))]
    Write {
        /// The file.
        path: String,
        /// The cause.
        source: std::io::Error,
    },
}

impl RecordingError {
    fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write {
            path: path.display().to_string(),
            source,
        }
    }
}

/// A frame's place on the path; every frame has one.
#[derive(Clone, Copy, Debug)]
pub struct FrameRecord {
    /// Place in the sequence, missing frames counted; ascending.
    pub index: usize,
    /// Capture stamp.
    pub stamp: Micros,
    /// Pose.
    pub world_from_camera: Pose,
}

/// What a key frame led to.
#[derive(Clone, Copy, Debug)]
pub struct KeyFrameRecord<'a> {
    /// Frame name; files are named after it.
    pub name: &'a str,
    /// Capture stamp.
    pub stamp: Micros,
    /// The frame, full size.
    pub image: ImageView<'a>,
    /// Road, at the working resolution.
    pub mask: MaskView<'a>,
    /// Where the grid's cells lie.
    pub layout: GridLayout,
    /// `[rows, columns]`, -1 unknown, 0 free to 100 occupied.
    pub cells: &'a [i8],
    /// Vehicle pose at the stamp.
    pub world_from_vehicle: Pose,
    /// Quality level, one word.
    pub level: &'a str,
    /// Whether the wanted level was out by the deadline.
    pub deadline_met: bool,
    /// Time from capture to publication.
    pub publish_latency_ms: f64,
    /// Time of each stage, in order of the pipeline; the same stages for each key frame.
    pub stages_ms: &'a [(&'static str, f64)],
    /// CAN frames of the publication: identifier and data.
    pub can_frames: &'a [CanFrame],
    /// Outlines of obstacle boxes and the like, as line segments in pixels of the full-size image.
    pub outlines: &'a [[(f32, f32); 2]],
}

/// The JSON header beside a grid.
#[derive(Serialize)]
struct GridHeader<'a> {
    name: &'a str,
    stamp_micros: u64,
    level: &'a str,
    #[serde(flatten)]
    layout: GridLayout,
    dtype: &'static str,
    values: &'static str,
    axes: &'static str,
    /// 3x4, row by row.
    world_from_vehicle: [f64; 12],
}

/// What a row of `timing.csv` and the page say of a key frame.
#[derive(Clone, Debug, Serialize)]
struct Row {
    name: String,
    stamp_micros: u64,
    latency_ms: f64,
    level: String,
    met: bool,
    stages_ms: Vec<f64>,
    /// Share of the image that is road.
    road_share: f64,
}

/// What is known of a run at its start.
#[derive(Clone, Debug, Default)]
pub struct RunTitle {
    /// Heading of the page: the command and its source.
    pub title: String,
    /// Deadline, shown in the histogram.
    pub deadline_ms: f64,
    /// Whether the same input gives the same bytes: nothing that was measured is written but to `timing.csv`, the report and
    /// the page.
    pub is_reproducible: bool,
}

/// A recording under way.
#[derive(Debug)]
pub struct Recording {
    folder: OutputFolder,
    title: RunTitle,
    frames: Vec<FrameRecord>,
    rows: Vec<Row>,
    stages: Vec<&'static str>,
    can_log: String,
    is_reproducible: bool,
}

impl Recording {
    /// Opens `dir`, made where it does not exist.
    ///
    /// # Errors
    /// A folder that holds anything but an earlier recording, or one that cannot be made.
    pub fn create(dir: &Path, title: RunTitle) -> Result<Self, RecordingError> {
        Ok(Self {
            folder: OutputFolder::create(dir)?,
            frames: Vec::new(),
            rows: Vec::new(),
            stages: Vec::new(),
            can_log: String::new(),
            is_reproducible: title.is_reproducible,
            title,
        })
    }

    /// Notes a frame's pose.
    pub fn frame(&mut self, frame: &FrameRecord) {
        self.frames.push(*frame);
    }

    /// Writes the files of a key frame.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn key_frame(&mut self, record: &KeyFrameRecord<'_>) -> Result<(), RecordingError> {
        let name = record.name;
        let mask = record.mask.upsampled(record.image.width, record.image.height);
        let (width, height) = (record.image.width, record.image.height);
        self.folder.png(
            &format!("masks/{name}.png"),
            &mask,
            width,
            height,
            image::ColorType::L8,
        )?;
        let overlay = picture::overlay(&record.image, &mask, record.outlines);
        self.folder.png(
            &format!("overlays/{name}.png"),
            &overlay,
            width,
            height,
            image::ColorType::Rgb8,
        )?;
        let view = picture::birdseye(&record.layout, record.cells);
        self.folder.png(
            &format!("birdseye/{name}.png"),
            &view.pixels,
            view.width,
            view.height,
            image::ColorType::Rgb8,
        )?;
        self.grid(record)?;
        self.log_can(record);
        if self.stages.is_empty() {
            self.stages = record.stages_ms.iter().map(|(stage, _)| *stage).collect();
        }
        let time_of = |stage: &&'static str| {
            let found = record.stages_ms.iter().find(|(name, _)| name == stage);
            found.map_or(0.0, |(_, ms)| *ms)
        };
        self.rows.push(Row {
            name: name.to_owned(),
            stamp_micros: record.stamp.0,
            latency_ms: record.publish_latency_ms,
            level: record.level.to_owned(),
            met: record.deadline_met,
            stages_ms: self.stages.iter().map(time_of).collect(),
            road_share: share(&mask),
        });
        Ok(())
    }

    fn grid(&self, record: &KeyFrameRecord<'_>) -> Result<(), RecordingError> {
        let name = record.name;
        let bytes = npy::encode_i8(record.layout.rows, record.layout.columns, record.cells);
        self.folder.file(&format!("grids/{name}.npy"), &bytes)?;
        let header = GridHeader {
            name,
            stamp_micros: record.stamp.0,
            level: record.level,
            layout: record.layout,
            dtype: "int8",
            values: "-1 unknown, 0 free to 100 occupied",
            axes: "[row, column]: row ahead, column left, cell [0, 0] nearest the car and to its right",
            world_from_vehicle: trajectory::rows_of(&record.world_from_vehicle),
        };
        self.folder.file(&format!("grids/{name}.json"), &json(&header))
    }

    /// Writes the truth of a key frame where it is known, as `eval grid` and `eval masks` read it: grid and full-size mask.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn truth(
        &self,
        name: &str,
        layout: &GridLayout,
        cells: &[i8],
        mask: &[u8],
        size: (usize, usize),
    ) -> Result<(), RecordingError> {
        let bytes = npy::encode_i8(layout.rows, layout.columns, cells);
        self.folder.file(&format!("truth/grids/{name}.npy"), &bytes)?;
        self.folder
            .file(&format!("truth/grids/{name}.json"), &json(layout))?;
        self.folder.png(
            &format!("truth/masks/{name}.png"),
            mask,
            size.0,
            size.1,
            image::ColorType::L8,
        )
    }

    /// Writes the true poses, a row a frame, as `eval trajectory` reads them.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn true_poses(&self, frames: &[FrameRecord]) -> Result<(), RecordingError> {
        self.folder
            .file("truth/poses.txt", trajectory::kitti(frames).as_bytes())
    }

    /// Adds the frames to the log that `emitted.candump` becomes, as `candump -L` would have seen them.
    fn log_can(&mut self, record: &KeyFrameRecord<'_>) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a latency of some milliseconds"
        )]
        let published = record
            .stamp
            .plus((record.publish_latency_ms.max(0.0) * 1e3) as u64);
        let stamp = if self.is_reproducible {
            record.stamp
        } else {
            published
        };
        for frame in record.can_frames {
            let hex: String = frame.data.iter().map(|byte| format!("{byte:02X}")).collect();
            self.can_log.push_str(&format!(
                "({}) can0 {:03X}#{hex}\n",
                trajectory::seconds(stamp),
                frame.id
            ));
        }
    }

    /// Where the masks written so far lie, for the comparison with truth.
    #[must_use]
    pub fn mask_folder(&self) -> std::path::PathBuf {
        self.folder.partial("masks")
    }

    /// Index and pose of every frame noted so far.
    pub fn poses(&self) -> impl Iterator<Item = (usize, Pose)> {
        self.frames
            .iter()
            .map(|frame| (frame.index, frame.world_from_camera))
    }

    /// Writes trajectory, timing, page and report, and moves everything into place.
    ///
    /// # Errors
    /// Where a file cannot be written or moved.
    pub fn finish(mut self, counts: &RunCounts, truth: Option<Truth>) -> Result<Report, RecordingError> {
        self.folder
            .file("trajectory.kitti", trajectory::kitti(&self.frames).as_bytes())?;
        self.folder
            .file("trajectory.tum", trajectory::tum(&self.frames).as_bytes())?;
        self.folder.file("emitted.candump", self.can_log.as_bytes())?;
        self.folder.file("timing.csv", &self.timing_csv())?;
        let report = Report::new(counts, &self.rows, &self.stages, truth);
        let page = page::html(
            &self.title,
            &self.folder,
            &report,
            &self.rows,
            &self.stages,
            &self.frames,
        )?;
        self.folder.file("index.html", page.as_bytes())?;
        self.folder.file("report.json", &json(&report))?;
        self.folder.publish()?;
        Ok(report)
    }

    fn timing_csv(&self) -> Vec<u8> {
        let mut csv = Vec::new();
        let _ = write!(csv, "name,stamp_s,publish_latency_ms,level,deadline_met");
        for stage in &self.stages {
            let _ = write!(csv, ",{stage}_ms");
        }
        csv.push(b'\n');
        for row in &self.rows {
            let _ = write!(
                csv,
                "{},{},{:.3},{},{}",
                row.name,
                trajectory::seconds(Micros(row.stamp_micros)),
                row.latency_ms,
                row.level,
                u8::from(row.met)
            );
            for ms in &row.stages_ms {
                let _ = write!(csv, ",{ms:.3}");
            }
            csv.push(b'\n');
        }
        csv
    }
}

#[expect(clippy::cast_precision_loss, reason = "pixel counts")]
fn share(mask: &[u8]) -> f64 {
    mask.iter().filter(|&&road| road != 0).count() as f64 / mask.len().max(1) as f64
}

/// Pretty JSON with a line feed at its end; the types here always have one.
fn json(value: &impl Serialize) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(value).unwrap_or_default();
    bytes.push(b'\n');
    bytes
}
