//! A run written to a folder: trajectory, masks, overlays, bird's-eye views, grids, timing, report, and a page of it all.
//!
//! Everything is written into `DIR/.partial` and moved up when the run is finished, the report last; a run that fails
//! leaves nothing behind. A folder that holds anything but an earlier recording is refused.
//! Memory does not grow with the run: rows go to their files as they come, pictures are drawn into one buffer, and what the
//! page shows is read from the files again. Nothing here is bounded in time: call it from a normal thread. Cost of a key
//! frame at 640x480: see [`Recording::key_frame`].

mod canvas;
mod folder;
mod font;
mod latency;
mod page;
mod picture;
mod report;
mod scores;
#[cfg(test)]
mod tests;
mod timing;
mod trajectory;

pub(crate) use picture::birdseye;
pub use picture::{ImageView, Upsampler};
pub use report::{LiveMemory, Report, RunCounts};
pub use scores::ScoreOf;

use std::io::{self, Write};
use std::path::Path;

use freespace::emit::CanFrame;
use freespace::space::{Micros, Pose};
use freespace::stage::StageTimes;
use serde::Serialize;

use crate::bad_input::BadInput;
use crate::eval::grid::GridLayout;
use crate::eval::{self, Truth, npy};
use crate::statistics::DriveStatistics;
use folder::{LineFile, OutputFolder};
use scores::ScoresFile;
use timing::TimingFile;
use trajectory::{KittiFile, Seconds, TumFile};

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
    /// Road, `[height, width] u8` of the image's size, 0 or 1; see [`Upsampler`].
    pub mask: &'a [u8],
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
    /// Time from capture to publication; none where frames went as fast as they were worked off.
    pub publish_latency_ms: Option<f64>,
    /// Time of each stage.
    pub times: StageTimes,
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

/// What is known of a run at its start.
#[derive(Clone, Debug, Default)]
pub struct RunTitle {
    /// Heading of the page: the command and its source.
    pub title: String,
    /// Deadline, shown in the histogram.
    pub deadline_ms: f64,
    /// Whether the same input gives the same bytes: nothing that was measured is written but to `timing.csv`, `latency.png`,
    /// the report and the page.
    pub is_reproducible: bool,
    /// Of a replay whose recording is cut off: what the drive was after that is in no figure.
    pub is_source_cut: bool,
    /// Of a replay that tells the times of the drive that was recorded, not its own.
    pub has_recorded_times: bool,
}

/// A recording under way.
#[derive(Debug)]
pub struct Recording {
    folder: OutputFolder,
    title: RunTitle,
    kitti: KittiFile,
    tum: TumFile,
    /// Only a simulated drive knows its true poses.
    truth: Option<KittiFile>,
    /// True poses of a replay, relative to the first.
    known_path: Vec<Pose>,
    scores: ScoresFile,
    timing: TimingFile,
    can_log: LineFile,
    /// The picture being drawn.
    pixels: Vec<u8>,
}

impl Recording {
    /// Opens `dir`, made where it does not exist.
    ///
    /// # Errors
    /// A folder that holds anything but an earlier recording, or one that cannot be made.
    pub fn create(dir: &Path, title: RunTitle) -> Result<Self, RecordingError> {
        let folder = OutputFolder::create(dir)?;
        Ok(Self {
            kitti: KittiFile::new(folder.lines("trajectory.kitti")?),
            tum: TumFile::new(folder.lines("trajectory.tum")?)?,
            truth: None,
            known_path: Vec::new(),
            scores: ScoresFile::default(),
            timing: TimingFile::new(folder.lines("timing.csv")?)?,
            can_log: folder.lines("emitted.candump")?,
            pixels: Vec::new(),
            folder,
            title,
        })
    }

    /// Writes a frame's pose.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn frame(&mut self, frame: &FrameRecord) -> Result<(), RecordingError> {
        let mut frame = *frame;
        // Rounding adds up over the products of a long drive; what reads the files wants rotations.
        frame.world_from_camera.rotation.renormalize();
        self.kitti.frame(&frame)?;
        self.tum.frame(&frame)
    }

    /// Writes a frame's true pose to `truth/poses.txt`, as `eval trajectory` reads it.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn true_pose(&mut self, frame: &FrameRecord) -> Result<(), RecordingError> {
        if self.truth.is_none() {
            self.truth = Some(KittiFile::new(self.folder.lines("truth/poses.txt")?));
        }
        self.truth.as_mut().map_or(Ok(()), |file| file.frame(frame))
    }

    /// Says where the car truly went, for the page; by place in the sequence.
    pub fn know_path(&mut self, world_from_camera: &[Pose]) {
        let first_from_world = world_from_camera.first().map(Pose::inverse).unwrap_or_default();
        self.known_path = world_from_camera
            .iter()
            .map(|pose| first_from_world * pose)
            .collect();
    }

    /// Writes how well a key frame agrees with the truth.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn score(&mut self, name: &str, of: ScoreOf, iou: f64) -> Result<(), RecordingError> {
        self.scores.score(&self.folder, name, of, iou)
    }

    /// Writes the files of a key frame; a few milliseconds of one core at 640x480.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn key_frame(&mut self, record: &KeyFrameRecord<'_>) -> Result<(), RecordingError> {
        use image::ColorType::{L8, Rgb8};
        let name = record.name;
        let (width, height) = (record.image.width, record.image.height);
        let path = |kind: &str| format!("{kind}/{name}.png");
        (self.folder).png(&path("masks"), record.mask, width, height, L8)?;
        picture::overlay(&record.image, record.mask, record.outlines, &mut self.pixels);
        (self.folder).png(&path("overlays"), &self.pixels, width, height, Rgb8)?;
        let (width, height) = picture::birdseye(&record.layout, record.cells, &mut self.pixels);
        (self.folder).png(&path("birdseye"), &self.pixels, width, height, Rgb8)?;
        self.grid(record)?;
        self.log_can(record)?;
        self.timing.key_frame(record)
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

    /// Adds the frames to the log that `emitted.candump` becomes, as `candump -L` would have seen them.
    fn log_can(&mut self, record: &KeyFrameRecord<'_>) -> Result<(), RecordingError> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a latency of some milliseconds"
        )]
        let published = record
            .stamp
            .plus((record.publish_latency_ms.unwrap_or(0.0).max(0.0) * 1e3) as u64);
        self.can_frames(record.stamp, published, record.can_frames)
    }

    /// Adds the frames of a publication that has no picture: its fallback, or the last word.
    ///
    /// # Errors
    /// Where a file cannot be written.
    pub fn can_frames(
        &mut self,
        stamp: Micros,
        published: Micros,
        frames: &[CanFrame],
    ) -> Result<(), RecordingError> {
        let stamp = if self.title.is_reproducible {
            stamp
        } else {
            published
        };
        for frame in frames {
            let log = &mut self.can_log;
            let mut row = || -> io::Result<()> {
                write!(log, "({}) can0 {:03X}#", Seconds(stamp), frame.id)?;
                for byte in &frame.data {
                    write!(log, "{byte:02X}")?;
                }
                writeln!(log)
            };
            row().map_err(|error| self.can_log.fault(error))?;
        }
        Ok(())
    }

    /// Where the masks written so far lie, for the comparison with truth.
    #[must_use]
    pub fn mask_folder(&self) -> std::path::PathBuf {
        self.folder.partial("masks")
    }

    /// Poses written so far, relative to the first, by their place in the sequence: those of `trajectory.kitti`. None where one
    /// of them is not finite.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn poses(&mut self) -> Result<Vec<Pose>, RecordingError> {
        read_back(&self.folder, "trajectory.kitti", Some(&mut self.kitti))
    }

    /// The same of the true poses; none where there are none.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn true_poses(&mut self) -> Result<Vec<Pose>, RecordingError> {
        read_back(&self.folder, "truth/poses.txt", self.truth.as_mut())
    }

    /// Writes latency picture, page and report, and moves everything into place.
    ///
    /// # Errors
    /// Where a file cannot be written or moved.
    pub fn finish(
        mut self,
        counts: &RunCounts,
        statistics: &DriveStatistics,
        truth: Option<Truth>,
    ) -> Result<Report, RecordingError> {
        self.tum.finish()?;
        self.can_log.finish()?;
        self.timing.finish()?;
        self.scores.finish()?;
        if let Some(truth) = &mut self.truth {
            truth.finish()?;
        }
        let (width, height) = latency::draw(statistics, self.title.deadline_ms, &mut self.pixels);
        let rgb = image::ColorType::Rgb8;
        (self.folder).png("latency.png", &self.pixels, width, height, rgb)?;
        let report = Report::new(&self.title, counts, statistics, truth);
        let positions =
            |poses: &[Pose]| -> Vec<_> { poses.iter().map(|pose| pose.translation.vector).collect() };
        let run_positions = positions(&self.poses()?);
        let simulated = self.true_poses()?;
        let true_positions = positions(if simulated.is_empty() {
            &self.known_path
        } else {
            &simulated
        });
        let run = page::Run {
            title: &self.title,
            folder: &self.folder,
            report: &report,
            rows: self.timing.rows(),
            positions: &run_positions,
            // A run that ended early went but a part of the way.
            true_positions: &true_positions[..true_positions.len().min(run_positions.len())],
        };
        page::write(&run)?;
        self.folder.file("report.json", &json(&report))?;
        self.folder.publish()?;
        Ok(report)
    }
}

/// The poses of a file that is still being written; none where one of them is no pose, for a run that lost its way is recorded
/// all the same.
fn read_back(
    folder: &OutputFolder,
    name: &str,
    file: Option<&mut KittiFile>,
) -> Result<Vec<Pose>, RecordingError> {
    let Some(file) = file.filter(|file| !file.is_empty()) else {
        return Ok(Vec::new());
    };
    file.finish()?;
    let read = eval::trajectory::read(&folder.partial(name));
    Ok(read.map(|file| file.poses).unwrap_or_default())
}

/// Pretty JSON with a line feed at its end; the types here always have one.
fn json(value: &impl Serialize) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(value).unwrap_or_default();
    bytes.push(b'\n');
    bytes
}
