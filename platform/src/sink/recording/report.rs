//! `report.json`: a run in numbers, under keys that stay.

use serde::{Serialize, Serializer};

use super::RunTitle;
use crate::eval::Truth;
use crate::statistics::{Counts, DriveStatistics, Drops, LatencyCounts, Percentiles};

/// What the pipeline counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunCounts {
    /// Key frames published, whether or not the observer saw them.
    pub key_frames: u64,
    /// Key frames whose grid was late or below the wanted level.
    pub deadline_misses: u64,
    /// Frames that reached the pipeline.
    pub frames: u64,
    /// Frames whose pose was tracked, not dead-reckoned.
    pub tracked_frames: u64,
    /// Frames missing, undecodable or overtaken by newer ones.
    pub dropped_frames: u64,
    /// Heap allocations after start; none where they were not counted.
    pub allocations_after_start: Option<u64>,
    /// Largest resident memory; none where the system does not say.
    pub peak_rss_mb: Option<f64>,
    /// Memory while it ran; none where it did not run live.
    pub memory: Option<LiveMemory>,
    /// Parts that panicked and were started anew.
    pub restarts: u32,
    /// A signal ended the run before its end.
    pub is_cut_short: bool,
}

/// The process's memory while a live run went on.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct LiveMemory {
    /// What the plan at the start added up to.
    pub planned_mb: f64,
    /// What the kernel holds locked at the end; 0 where locking was refused or not wanted.
    pub locked_mb: f64,
    /// Growth of the resident memory from the tenth second to the end.
    pub rss_growth_mb: f64,
    /// Growth of what C and C++ libraries hold of the heap, over the same time.
    pub library_heap_growth_mb: f64,
    /// Page faults of real-time threads after their warm-up.
    pub page_faults_after_warm_up: u64,
}

/// A run in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Key frames.
    pub key_frames: u64,
    /// Key frames whose grid was late or below the wanted level.
    pub deadline_misses: u64,
    /// Frames missing, undecodable or overtaken by newer ones.
    pub dropped_frames: u64,
    /// Frames whose pose was tracked.
    pub tracked_frames: u64,
    /// Frames that reached the pipeline.
    pub frames: u64,
    /// Heap allocations after start.
    pub allocations_after_start: Option<u64>,
    /// Of a replay whose recording is cut off: what the drive was after that is in no figure.
    pub is_source_cut: bool,
    /// Of a replay: deadlines and times are those of the drive that was recorded.
    pub has_recorded_times: bool,
    /// Whether frames came at the pace of their stamps; else there are no latencies, and no deadline applies.
    pub is_timed: bool,
    /// Time from capture to publication; null without key frames, and where nothing was timed.
    pub capture_to_publish_ms: Option<Percentiles>,
    /// The same times as counts, which add up over drives.
    pub capture_to_publish: LatencyCounts,
    /// Time of each stage where it ran, in the order of the pipeline.
    #[serde(serialize_with = "as_map")]
    pub stages_ms: Vec<(&'static str, Percentiles)>,
    /// Time of every frame in *frame* and *track* together; null where it was not measured.
    pub frame_ms: Option<Percentiles>,
    /// Key frames at each quality level.
    pub levels: Counts,
    /// Misses by what they are blamed on.
    pub misses_by_stage: Counts,
    /// Key frames with each fault.
    pub faults: Counts,
    /// Frames in each state of the tracker.
    pub tracking: Counts,
    /// Key frames by where their scale comes from.
    pub scale: Counts,
    /// What was lost on the way.
    pub drops: Drops,
    /// Parts that panicked and were started anew.
    pub restarts: u32,
    /// A signal ended the run before its end.
    pub is_cut_short: bool,
    /// Largest resident memory.
    pub peak_rss_mb: Option<f64>,
    /// Memory while it ran; null where it did not run live.
    pub memory: Option<LiveMemory>,
    /// Comparison with truth; null where there is none.
    pub truth: Option<Truth>,
}

fn as_map<S: Serializer>(stages: &[(&'static str, Percentiles)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(stages.iter().map(|(stage, times)| (stage, times)))
}

impl Report {
    /// The report of a run.
    #[must_use]
    pub fn new(
        title: &RunTitle,
        counts: &RunCounts,
        statistics: &DriveStatistics,
        truth: Option<Truth>,
    ) -> Self {
        Self {
            key_frames: counts.key_frames,
            deadline_misses: counts.deadline_misses,
            dropped_frames: counts.dropped_frames,
            tracked_frames: counts.tracked_frames,
            frames: counts.frames,
            allocations_after_start: counts.allocations_after_start,
            is_source_cut: title.is_source_cut,
            has_recorded_times: title.has_recorded_times,
            is_timed: statistics.is_timed(),
            capture_to_publish_ms: statistics.capture_to_publish().percentiles(),
            capture_to_publish: LatencyCounts::of(statistics.capture_to_publish()),
            stages_ms: statistics.stages_ms(),
            frame_ms: statistics.frame_ms(),
            levels: statistics.levels(),
            misses_by_stage: statistics.misses_by_stage(),
            faults: statistics.faults(),
            tracking: statistics.tracking(),
            scale: statistics.scale(),
            drops: statistics.drops(),
            restarts: counts.restarts,
            is_cut_short: counts.is_cut_short,
            peak_rss_mb: counts.peak_rss_mb,
            memory: counts.memory,
            truth,
        }
    }
}
