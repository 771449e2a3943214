//! Statistics as names and numbers: for `report.json`, and for one line of status.

use std::fmt;

use freespace::health::{Blame, Faults, QualityLevel};
use freespace::stage::Stage;
use serde::{Serialize, Serializer};

use super::{DriveStatistics, LEVELS, LatencyHistogram, Percentiles};

/// Names of the tracking states, in the order of their numbers.
pub(crate) const TRACKING: [&str; 4] = ["dead_reckoning", "good", "standstill", "weak"];
/// Names of the scale states, in the order of their numbers.
pub(crate) const SCALE: [&str; 4] = ["unknown", "wheels", "camera_height", "held"];

/// What was lost on the way; null where it was not counted apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Drops {
    /// Frames that the camera lost, or that could not be decoded.
    pub camera: Option<u64>,
    /// Frames displaced by newer ones before they were tracked.
    pub hand_over: Option<u64>,
    /// Publications and frames that the observer was too slow to see: neither recorded nor measured against truth.
    pub unobserved: Option<u64>,
    /// Frames, publications and late work of which not even the numbers reached the observer: a recording lacks them, and says so.
    pub unreported: Option<u64>,
    /// Instants of the cadence that nothing answered, for the publisher itself did not run.
    pub unanswered: Option<u64>,
    /// Answers and announcements that came after their fallback had left.
    pub late: Option<u64>,
    /// Views that found the batch of their key frame full.
    pub rejected_views: Option<u64>,
}

impl Drops {
    /// Frames that were lost on their way to the pipeline.
    #[must_use]
    pub fn frames(&self) -> u64 {
        [self.camera, self.hand_over].iter().flatten().sum()
    }
}

/// Names with their counts, in a fixed order; a name that is absent has the count zero.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts(pub Vec<(&'static str, u64)>);

impl Counts {
    fn of(named: impl IntoIterator<Item = (&'static str, u64)>) -> Self {
        Self(named.into_iter().filter(|(_, count)| *count > 0).collect())
    }

    /// The names and counts, `name count` each, two spaces apart.
    #[must_use]
    pub fn line(&self) -> String {
        let named = self.0.iter().map(|(name, count)| format!("{name} {count}"));
        named.collect::<Vec<_>>().join("  ")
    }
}

impl Serialize for Counts {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().copied())
    }
}

impl DriveStatistics {
    /// Whether there are latencies and deadlines.
    #[must_use]
    pub const fn is_timed(&self) -> bool {
        self.is_timed
    }

    /// Publications.
    #[must_use]
    pub const fn key_frames(&self) -> u64 {
        self.key_frames
    }

    /// Publications below the wanted level, or late.
    #[must_use]
    pub const fn misses(&self) -> u64 {
        self.misses
    }

    /// Times from capture to publication.
    #[must_use]
    pub const fn capture_to_publish(&self) -> &LatencyHistogram {
        &self.capture_to_publish
    }

    /// Times of the stages that ran, in the order of the pipeline.
    #[must_use]
    pub fn stages_ms(&self) -> Vec<(&'static str, Percentiles)> {
        let named = Stage::ALL.into_iter().zip(&self.stages);
        named
            .filter_map(|(stage, times)| Some((stage.name(), times.percentiles()?)))
            .collect()
    }

    /// Time of each frame in *frame* and *track* together.
    #[must_use]
    pub fn frame_ms(&self) -> Option<Percentiles> {
        self.frame.percentiles()
    }

    /// Publications at each quality level, best first.
    #[must_use]
    pub fn levels(&self) -> Counts {
        Counts::of(LEVELS.map(QualityLevel::name).into_iter().zip(self.levels))
    }

    /// Misses by what they are blamed on.
    #[must_use]
    pub fn misses_by_stage(&self) -> Counts {
        let blamed: u64 = self.misses_by_blame.iter().sum();
        let named = Blame::ALL.map(Blame::name).into_iter().zip(self.misses_by_blame);
        Counts::of(named.chain([("unknown", self.misses.saturating_sub(blamed))]))
    }

    /// Publications with each fault.
    #[must_use]
    pub fn faults(&self) -> Counts {
        Counts::of(Faults::NAMED.map(|(_, name)| name).into_iter().zip(self.faults))
    }

    /// Frames in each state of the tracker.
    #[must_use]
    pub fn tracking(&self) -> Counts {
        Counts::of(TRACKING.into_iter().zip(self.tracking))
    }

    /// Publications by where their scale comes from.
    #[must_use]
    pub fn scale(&self) -> Counts {
        Counts::of(SCALE.into_iter().zip(self.scale))
    }

    /// What was lost.
    #[must_use]
    pub const fn drops(&self) -> Drops {
        self.drops
    }

    /// The drive in one line; written without allocation into whatever does not allocate.
    #[must_use]
    pub const fn status(&self) -> Status<'_> {
        Status(self)
    }
}

/// See [`DriveStatistics::status`].
#[derive(Clone, Copy, Debug)]
pub struct Status<'a>(&'a DriveStatistics);

impl fmt::Display for Status<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let statistics = self.0;
        write!(
            f,
            "{} key frames, {} misses",
            statistics.key_frames, statistics.misses
        )?;
        if let Some(times) = statistics.capture_to_publish.percentiles() {
            write!(
                f,
                ", capture to publish p50 {:.0} p99 {:.0} max {:.0} ms",
                times.p50, times.p99, times.max
            )?;
        }
        for (level, count) in LEVELS.into_iter().zip(statistics.levels) {
            if count > 0 {
                write!(f, ", {} {count}", level.name())?;
            }
        }
        write!(
            f,
            ", {} frames, {} dropped",
            statistics.frames,
            statistics.drops.frames()
        )?;
        for (name, count) in [
            ("unanswered", statistics.drops.unanswered),
            ("late", statistics.drops.late),
        ] {
            if let Some(count) = count.filter(|count| *count > 0) {
                write!(f, ", {count} {name}")?;
            }
        }
        Ok(())
    }
}
