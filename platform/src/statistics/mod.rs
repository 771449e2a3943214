//! What a drive was like: times in histograms, and counts.
//!
//! In: every frame and every publication as it happens. Out: percentiles and named counts for `report.json`, one line of
//! text for a service manager, and what the latency picture is drawn from. Invariant: memory is [`DriveStatistics::BYTES`]
//! whatever the drive's length, all of it resident from the start. Cost: O(1) a record, without allocation; so the
//! publisher's thread may record too. Only what asks for a summary at the end allocates. A counter that is full stays so.

mod counts;
mod histogram;
mod summary;
#[cfg(test)]
mod tests;

pub use counts::LatencyCounts;
pub use histogram::{LatencyHistogram, Percentiles};
pub use summary::{Counts, Drops, Status};
pub(crate) use summary::{SCALE, TRACKING};

use freespace::health::{Blame, Faults, QualityLevel, ScaleState, TrackingState};
use freespace::pipeline::KeyFrameOutput;
use freespace::space::Micros;
use freespace::stage::{Cuts, Stage, StageTimes};

/// What the statistics take of one publication; `Copy`, so that it passes through any ring.
#[derive(Clone, Copy, Debug)]
pub struct Publication {
    /// Number of the frame in its source; none where it answers for an instant at which none came.
    pub frame: Option<u64>,
    /// Capture stamp.
    pub stamp: Micros,
    /// Quality.
    pub level: QualityLevel,
    /// Its reasons.
    pub faults: Faults,
    /// Where the scale comes from.
    pub scale: ScaleState,
    /// Time of each stage; zero where it did not run for this publication.
    pub times: StageTimes,
    /// Where the clock cut the work short.
    pub cuts: Cuts,
    /// From capture to publication.
    pub latency_micros: u64,
    /// Whether the wanted level was not out by the deadline.
    pub is_miss: bool,
    /// What held the answer back, or lowered its level.
    pub blame: Option<Blame>,
}

impl Publication {
    /// Of an output that has left.
    #[must_use]
    pub fn of(output: &KeyFrameOutput) -> Self {
        Self {
            frame: output.has_frame.then_some(output.frame),
            stamp: output.stamp,
            level: output.level,
            faults: output.faults,
            scale: output.scale,
            times: output.times,
            cuts: output.cuts,
            latency_micros: output.latency_micros,
            is_miss: output.is_miss(),
            blame: output.blame,
        }
    }
}

const LEVELS: [QualityLevel; 6] = [
    QualityLevel::Full,
    QualityLevel::NoRefinement,
    QualityLevel::NoFreshNetwork,
    QualityLevel::NoFreshMap,
    QualityLevel::Moved,
    QualityLevel::Invalid,
];

/// Names of the quality levels, best first.
pub(crate) const LEVEL_NAMES: [&str; LEVELS.len()] = {
    let mut names = [""; LEVELS.len()];
    let mut level = 0;
    while level < LEVELS.len() {
        names[level] = LEVELS[level].name();
        level += 1;
    }
    names
};

/// A drive in numbers.
#[derive(Clone, Debug)]
pub struct DriveStatistics {
    /// Whether frames come at the pace of their stamps, so that there are latencies and deadlines.
    is_timed: bool,
    capture_to_publish: LatencyHistogram,
    stages: [LatencyHistogram; Stage::ALL.len()],
    frame: LatencyHistogram,
    frames: u64,
    key_frames: u64,
    misses: u64,
    misses_by_blame: [u64; Blame::ALL.len()],
    levels: [u64; LEVELS.len()],
    faults: [u64; Faults::NAMED.len()],
    tracking: [u64; summary::TRACKING.len()],
    scale: [u64; summary::SCALE.len()],
    drops: Drops,
}

impl Default for DriveStatistics {
    fn default() -> Self {
        Self::new()
    }
}

impl DriveStatistics {
    /// Memory of the whole.
    pub const BYTES: usize = size_of::<Self>() + (2 + Stage::ALL.len()) * LatencyHistogram::BYTES;

    /// Of a run as fast as it goes: its clock stands still while a frame is worked on.
    #[must_use]
    pub fn untimed() -> Self {
        Self {
            is_timed: false,
            ..Self::new()
        }
    }

    /// Allocates everything.
    #[must_use]
    pub fn new() -> Self {
        Self {
            is_timed: true,
            capture_to_publish: LatencyHistogram::new(),
            stages: std::array::from_fn(|_| LatencyHistogram::new()),
            frame: LatencyHistogram::new(),
            frames: 0,
            key_frames: 0,
            misses: 0,
            misses_by_blame: [0; Blame::ALL.len()],
            levels: [0; LEVELS.len()],
            faults: [0; Faults::NAMED.len()],
            tracking: [0; summary::TRACKING.len()],
            scale: [0; summary::SCALE.len()],
            drops: Drops::default(),
        }
    }

    /// A frame went through *frame* and *track*.
    pub fn frame(&mut self, tracking: TrackingState) {
        add(&mut self.frames);
        add(&mut self.tracking[tracking as usize]);
    }

    /// Time that a frame took in *frame* and *track* together; for every frame, key frame or not.
    pub fn frame_micros(&mut self, micros: u64) {
        self.frame.record(micros);
    }

    /// A key frame's answer, fallbacks among them, was published.
    pub fn publication(&mut self, publication: &Publication) {
        add(&mut self.key_frames);
        if self.is_timed {
            self.capture_to_publish.record(publication.latency_micros);
        }
        add(&mut self.levels[publication.level as usize]);
        add(&mut self.scale[publication.scale as usize]);
        if publication.is_miss {
            add(&mut self.misses);
            if let Some(blame) = publication.blame {
                add(&mut self.misses_by_blame[usize::from(Blame::to_wire(Some(blame))) - 1]);
            }
        }
        for (count, (fault, _)) in self.faults.iter_mut().zip(Faults::NAMED) {
            if publication.faults.contains(fault) {
                add(count);
            }
        }
        for (histogram, micros) in self.stages.iter_mut().zip(publication.times.0) {
            // A fallback ran no stage but the last: that is no sample of zero.
            if micros > 0 {
                histogram.record(micros);
            }
        }
    }

    /// Sets what was lost so far.
    pub fn set_drops(&mut self, drops: Drops) {
        self.drops = drops;
    }
}

fn add(count: &mut u64) {
    *count = count.saturating_add(1);
}
