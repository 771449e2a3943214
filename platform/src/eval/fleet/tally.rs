//! What is counted of a drive, and added up over drives.
//!
//! Everything in a [`Tally`] is an integer, so that sums are exact and do not depend on their order; lengths are rounded to
//! millimetres once a drive. What cannot be added (position errors) stands in each drive's [`TrajectoryRow`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::statistics::LatencyCounts;

/// Counts by name.
pub(super) type Named = BTreeMap<String, u64>;

/// Counts of one drive, or of many.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tally {
    /// Drives whose recording is cut off: what they were after that is not counted.
    pub cut_drives: u64,
    /// Key frames that were answered.
    pub key_frames: u64,
    /// Of them, those that had a deadline: not where frames went as fast as they were worked off.
    pub timed_key_frames: u64,
    /// Of those, the ones whose answer was late or below the wanted level.
    pub deadline_misses: u64,
    /// Misses by what they are blamed on.
    pub misses_by_stage: Named,
    /// Answers at each quality level.
    pub levels: Named,
    /// Times from capture to publication.
    pub capture_to_publish: LatencyCounts,
    /// Frames that reached the pipeline.
    pub frames: u64,
    /// Of them, those whose pose was tracked.
    pub tracked_frames: u64,
    /// Frames that were lost on their way.
    pub dropped_frames: u64,
    /// From the first frame to the last.
    pub driven_micros: u64,
    /// Length of the path as it was estimated.
    pub driven_mm: u64,
    /// Road pixels against truth.
    pub road: RoadTally,
    /// Cells of the grid against truth, 0 to 30 m ahead.
    pub grid: GridTally,
    /// Lengths of paths whose true length is known.
    pub path: PathTally,
}

/// Road pixels against truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoadTally {
    /// Masks compared.
    pub masks: u64,
    /// True masks of frames that got no answer with a picture.
    pub unanswered: u64,
    /// Road called road.
    pub hits: u64,
    /// Not road called road.
    pub false_alarms: u64,
    /// Road called not road.
    pub misses: u64,
    /// Not road called not road.
    pub rejections: u64,
}

/// Cells that the truth has seen; what is called unknown is not called free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridTally {
    /// Grids compared.
    pub grids: u64,
    /// True grids of frames that got no answer with a picture.
    pub unanswered: u64,
    /// Free called free.
    pub free: u64,
    /// Occupied called free: what a user must fear.
    pub falsely_free: u64,
    /// Free not called free.
    pub falsely_not_free: u64,
    /// Occupied not called free.
    pub not_free: u64,
}

/// Lengths of paths whose true length is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathTally {
    /// Drives.
    pub drives: u64,
    /// Their true length.
    pub true_mm: u64,
    /// Their estimated length over the same frames.
    pub estimated_mm: u64,
}

/// Position errors of one drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrajectoryRow {
    /// Poses compared.
    pub poses: u64,
    /// Root mean square position error after the best rigid motion.
    pub ate_se3_m: f64,
    /// The same after the best rigid motion and scale.
    pub ate_sim3_m: Option<f64>,
    /// `|s - 1|` of that scale.
    pub scale_error: Option<f64>,
    /// KITTI's translation error over segments of 100 to 800 m, in percent.
    pub segment_translation_percent: Option<f64>,
    /// KITTI's rotation error over the same segments.
    pub segment_rotation_deg_per_m: Option<f64>,
}

/// A drive of the list, evaluated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveScore {
    /// Its place in the sorted list, from 0.
    pub index: usize,
    /// Its name in the list.
    pub name: String,
    /// SHA-256 of the model of the network that it was replayed with; none of a finished run.
    pub network_sha256: Option<String>,
    /// What adds up.
    pub counts: Tally,
    /// What does not; none without true poses.
    pub trajectory: Option<TrajectoryRow>,
}

/// Adds each pair; none where a sum has no room.
fn sums<const N: usize>(pairs: [(&mut u64, u64); N]) -> Option<()> {
    for (sum, count) in pairs {
        *sum = sum.checked_add(count)?;
    }
    Some(())
}

fn named_sums(sums: &mut Named, counts: &Named) -> Option<()> {
    for (name, count) in counts {
        let sum = sums.entry(name.clone()).or_default();
        *sum = sum.checked_add(*count)?;
    }
    Some(())
}

impl Tally {
    /// Key frames that were answered by their deadline.
    #[must_use]
    pub const fn deadlines_met(&self) -> u64 {
        self.timed_key_frames.saturating_sub(self.deadline_misses)
    }

    /// The counts of both; none where a sum does not fit 64 bits.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Option<Self> {
        sums([
            (&mut self.cut_drives, other.cut_drives),
            (&mut self.key_frames, other.key_frames),
            (&mut self.timed_key_frames, other.timed_key_frames),
            (&mut self.deadline_misses, other.deadline_misses),
            (&mut self.frames, other.frames),
            (&mut self.tracked_frames, other.tracked_frames),
            (&mut self.dropped_frames, other.dropped_frames),
            (&mut self.driven_micros, other.driven_micros),
            (&mut self.driven_mm, other.driven_mm),
            (&mut self.path.drives, other.path.drives),
            (&mut self.path.true_mm, other.path.true_mm),
            (&mut self.path.estimated_mm, other.path.estimated_mm),
        ])?;
        named_sums(&mut self.misses_by_stage, &other.misses_by_stage)?;
        named_sums(&mut self.levels, &other.levels)?;
        self.capture_to_publish = self.capture_to_publish.plus(&other.capture_to_publish)?;
        self.road.add(&other.road)?;
        self.grid.add(&other.grid)?;
        Some(self)
    }
}

impl RoadTally {
    fn add(&mut self, other: &Self) -> Option<()> {
        sums([
            (&mut self.masks, other.masks),
            (&mut self.unanswered, other.unanswered),
            (&mut self.hits, other.hits),
            (&mut self.false_alarms, other.false_alarms),
            (&mut self.misses, other.misses),
            (&mut self.rejections, other.rejections),
        ])
    }
}

impl GridTally {
    fn add(&mut self, other: &Self) -> Option<()> {
        sums([
            (&mut self.grids, other.grids),
            (&mut self.unanswered, other.unanswered),
            (&mut self.free, other.free),
            (&mut self.falsely_free, other.falsely_free),
            (&mut self.falsely_not_free, other.falsely_not_free),
            (&mut self.not_free, other.not_free),
        ])
    }
}
