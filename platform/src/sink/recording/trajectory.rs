//! Trajectories as files, a row at a time.
//!
//! `trajectory.kitti` has a row for each place in the sequence, so that it lines up with the truth: a missing frame gets the
//! pose between its neighbours, one missing at the start that of the first. `trajectory.tum` has the frames that were there,
//! with their stamps. Both are relative to the first camera, as KITTI's are: its pose is the identity.
//! Memory: the first and the last frame, and the files' buffers.

use std::fmt;
use std::io::{self, Write};

use freespace::space::{Micros, Pose};

use super::folder::LineFile;
use super::{FrameRecord, RecordingError};

/// The 3x4 matrix of a pose, row by row.
pub(super) fn rows_of(pose: &Pose) -> [f64; 12] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|i| matrix[(i / 4, i % 4)])
}

/// A stamp as seconds with six decimals, exactly.
pub(super) struct Seconds(pub(super) Micros);

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:06}", self.0.0 / 1_000_000, self.0.0 % 1_000_000)
    }
}

/// `trajectory.kitti` under way.
#[derive(Debug)]
pub(super) struct KittiFile {
    file: LineFile,
    first_from_world: Option<Pose>,
    last: Option<FrameRecord>,
}

impl KittiFile {
    pub(super) const fn new(file: LineFile) -> Self {
        Self {
            file,
            first_from_world: None,
            last: None,
        }
    }

    /// Whether no frame was written.
    pub(super) const fn is_empty(&self) -> bool {
        self.last.is_none()
    }

    /// Writes a frame's row, and those of the frames missing before it.
    pub(super) fn frame(&mut self, frame: &FrameRecord) -> Result<(), RecordingError> {
        self.rows(frame).map_err(|error| self.file.fault(error))
    }

    fn rows(&mut self, frame: &FrameRecord) -> io::Result<()> {
        let to = &frame.world_from_camera;
        let first_from_world = *self.first_from_world.get_or_insert_with(|| to.inverse());
        let gap = self
            .last
            .map_or(frame.index + 1, |last| frame.index.saturating_sub(last.index));
        let from = self.last.map_or(*to, |last| last.world_from_camera);
        for part in 1..gap {
            row(
                &mut self.file,
                &(first_from_world * between(&from, to, fraction(part, gap))),
            )?;
        }
        self.last = Some(*frame);
        row(&mut self.file, &(first_from_world * to))
    }

    pub(super) fn finish(&mut self) -> Result<(), RecordingError> {
        self.file.finish()
    }
}

#[expect(clippy::cast_precision_loss, reason = "frame counts")]
fn fraction(part: usize, whole: usize) -> f64 {
    part as f64 / whole as f64
}

fn between(a: &Pose, b: &Pose, part: f64) -> Pose {
    // Opposite rotations have no path between them; two neighbouring frames never are.
    a.try_lerp_slerp(b, part, 1e-9).unwrap_or(*a)
}

fn row(file: &mut impl Write, pose: &Pose) -> io::Result<()> {
    for (i, value) in rows_of(pose).into_iter().enumerate() {
        let gap = if i == 0 { "" } else { " " };
        write!(file, "{gap}{value:.9e}")?;
    }
    writeln!(file)
}

/// `trajectory.tum` under way.
#[derive(Debug)]
pub(super) struct TumFile {
    file: LineFile,
    first_from_world: Option<Pose>,
}

impl TumFile {
    /// Writes the heading.
    pub(super) fn new(mut file: LineFile) -> Result<Self, RecordingError> {
        let heading = "# time_s x_m y_m z_m qx qy qz qw (first camera: x right, y down, z ahead)";
        file.line(format_args!("{heading}"))?;
        Ok(Self {
            file,
            first_from_world: None,
        })
    }

    /// Writes a frame's row.
    pub(super) fn frame(&mut self, frame: &FrameRecord) -> Result<(), RecordingError> {
        let first_from_world =
            *(self.first_from_world).get_or_insert_with(|| frame.world_from_camera.inverse());
        let pose = first_from_world * frame.world_from_camera;
        let (p, q) = (pose.translation.vector, pose.rotation.coords);
        self.file.line(format_args!(
            "{} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            Seconds(frame.stamp),
            p.x,
            p.y,
            p.z,
            q.x,
            q.y,
            q.z,
            q.w
        ))
    }

    pub(super) fn finish(&mut self) -> Result<(), RecordingError> {
        self.file.finish()
    }
}
