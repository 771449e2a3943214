//! `report.json`: a run in numbers, under keys that stay.

use std::collections::BTreeMap;

use serde::{Serialize, Serializer};

use super::Row;
use crate::eval::Truth;

/// Exact percentiles of all samples, by nearest rank: the smallest sample that the given share does not exceed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 99 in 100.
    pub p99: f64,
    /// 999 in 1000.
    pub p99_9: f64,
    /// Largest.
    pub max: f64,
}

impl Percentiles {
    /// Percentiles of `samples`; none of none.
    #[must_use]
    pub fn of(samples: &[f64]) -> Option<Self> {
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        let max = *sorted.last()?;
        let at = |per_mille: usize| sorted[(per_mille * sorted.len()).div_ceil(1000).max(1) - 1];
        Some(Self {
            p50: at(500),
            p99: at(990),
            p99_9: at(999),
            max,
        })
    }
}

/// What the pipeline counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunCounts {
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
}

/// A run in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Key frames.
    pub key_frames: usize,
    /// Key frames whose grid was late or below the wanted level.
    pub deadline_misses: usize,
    /// Frames missing, undecodable or overtaken by newer ones.
    pub dropped_frames: u64,
    /// Frames whose pose was tracked.
    pub tracked_frames: u64,
    /// Frames that reached the pipeline.
    pub frames: u64,
    /// Heap allocations after start.
    pub allocations_after_start: Option<u64>,
    /// Time from capture to publication; null without key frames.
    pub capture_to_publish_ms: Option<Percentiles>,
    /// Time of each stage, in the order of the pipeline.
    #[serde(serialize_with = "as_map")]
    pub stages_ms: Vec<(&'static str, Percentiles)>,
    /// Key frames at each quality level.
    pub levels: BTreeMap<String, usize>,
    /// Largest resident memory.
    pub peak_rss_mb: Option<f64>,
    /// Comparison with truth; null where there is none.
    pub truth: Option<Truth>,
}

fn as_map<S: Serializer>(stages: &[(&'static str, Percentiles)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(stages.iter().map(|(stage, times)| (stage, times)))
}

impl Report {
    pub(super) fn new(
        counts: &RunCounts,
        rows: &[Row],
        stages: &[&'static str],
        truth: Option<Truth>,
    ) -> Self {
        let latencies: Vec<f64> = rows.iter().map(|row| row.latency_ms).collect();
        let stages_ms = stages
            .iter()
            .enumerate()
            .filter_map(|(i, stage)| {
                let times: Vec<f64> = rows.iter().map(|row| row.stages_ms[i]).collect();
                Some((*stage, Percentiles::of(&times)?))
            })
            .collect();
        let mut levels = BTreeMap::new();
        for row in rows {
            *levels.entry(row.level.clone()).or_default() += 1;
        }
        Self {
            key_frames: rows.len(),
            deadline_misses: rows.iter().filter(|row| !row.met).count(),
            dropped_frames: counts.dropped_frames,
            tracked_frames: counts.tracked_frames,
            frames: counts.frames,
            allocations_after_start: counts.allocations_after_start,
            capture_to_publish_ms: Percentiles::of(&latencies),
            stages_ms,
            levels,
            peak_rss_mb: counts.peak_rss_mb,
            truth,
        }
    }
}
