//! What the monitor knows: the last message, and what the messages so far add up to.
//!
//! In: messages and views, each with the time they came. Out: fields for [`super::snapshot`] and the views. Invariant: counts
//! are since the monitor started, and only grow; a miss is what the module calls one. Cost: O(cells) a message. When full:
//! the oldest of [`HISTORY`] key frames and of [`MISSES`] misses goes.

use std::collections::VecDeque;

use freespace::emit::SharedMessage;
use freespace::health::{Blame, Faults, QualityLevel};
use freespace::space::Micros;
use freespace::stage::Stage;
use freespace_reader::ReaderError;

use super::temperatures::Temperatures;
use crate::statistics::LatencyHistogram;
use crate::view::{View, ViewStatus};

/// Key frames kept: a minute at one each half second.
pub const HISTORY: usize = 120;
/// Misses kept.
pub const MISSES: usize = 50;
/// A module that has been silent for this long is not trusted to be alive: four key frames.
pub(super) const STALE_MICROS: u64 = 2_000_000;
/// Temperatures read this long ago are not those of now.
const STALE_TEMPERATURE_MICROS: u64 = 10_000_000;
/// Width of a bin of the latency histogram.
pub(super) const BIN_MICROS: u64 = 10_000;
/// Its bins; the last one is open.
pub(super) const BINS: usize = 61;
/// Upper ends of the buckets that metrics have, microseconds: fine around the target of 100 ms and the deadline of 500 ms.
pub(super) const BUCKETS_MICROS: [u64; 14] = [
    20_000, 30_000, 40_000, 50_000, 75_000, 100_000, 150_000, 200_000, 250_000, 300_000, 400_000, 500_000,
    750_000, 1_000_000,
];

/// When something came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// `CLOCK_MONOTONIC`, to reckon with.
    pub monotonic: Micros,
    /// Milliseconds since 1970, to show.
    pub unix_ms: u64,
}

impl Now {
    /// This instant.
    #[must_use]
    pub fn read() -> Self {
        let unix = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        Self {
            monotonic: freespace_reader::monotonic_now(),
            unix_ms: unix
                .ok()
                .and_then(|since| u64::try_from(since.as_millis()).ok())
                .unwrap_or(0),
        }
    }
}

/// What the cells of the grid are coloured by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layer {
    /// Free, occupied, unknown.
    #[default]
    Occupancy,
    /// Why a cell is what it is.
    Reason,
    /// How long ago it was seen.
    Age,
}

/// The last message.
#[derive(Clone, Debug)]
pub(super) struct Last {
    /// The message but for its cells.
    pub(super) header: Header,
    pub(super) occupancy: Vec<i8>,
    pub(super) reason: Vec<u8>,
    pub(super) age: Vec<u8>,
}

/// Numbers of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Header {
    pub(super) sequence: u64,
    pub(super) used_micros: u32,
    pub(super) budget_micros: u32,
    pub(super) level: QualityLevel,
    pub(super) faults: Faults,
    pub(super) blame: Option<Blame>,
    pub(super) scale: u8,
    pub(super) tracking: u8,
    pub(super) handed_over: Micros,
    pub(super) position_m: [f64; 3],
    pub(super) speed_mps: f32,
    pub(super) yaw_rate_radps: f32,
    pub(super) plane_offset_m: f32,
    pub(super) plane_sigma_m: f32,
    pub(super) plane_inliers: u32,
    pub(super) free_ahead_m: f32,
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) cell_m: f32,
    pub(super) origin_m: [f32; 2],
    pub(super) sector_first_rad: f32,
    pub(super) sector_rad: f32,
    pub(super) free_m: [f32; freespace::budget::SECTORS],
}

/// Half of the bearing that counts as straight ahead: a lane at 20 m.
const AHEAD_HALF_RAD: f32 = 0.08;

impl Header {
    fn of(message: &SharedMessage) -> Self {
        let finite = |value: f32| if value.is_finite() { value } else { 0.0 };
        Self {
            sequence: message.sequence,
            used_micros: message.used_micros,
            budget_micros: message.budget_micros,
            // What a later version may say is nothing to rely on.
            level: QualityLevel::from_wire(message.level).unwrap_or(QualityLevel::Invalid),
            faults: Faults(message.faults),
            blame: Blame::from_wire(message.blame).flatten(),
            scale: message.scale,
            tracking: message.tracking,
            handed_over: Micros(message.handed_over_micros),
            position_m: message.position_m,
            speed_mps: finite(message.speed_mps),
            yaw_rate_radps: finite(message.yaw_rate_radps),
            plane_offset_m: finite(message.plane_offset_m),
            plane_sigma_m: finite(message.plane_sigma_m),
            plane_inliers: message.plane_inliers,
            free_ahead_m: finite(message.free_ahead_m(AHEAD_HALF_RAD)),
            rows: message.rows as usize,
            columns: message.columns as usize,
            cell_m: finite(message.cell_m),
            origin_m: [finite(message.origin_x_m), finite(message.origin_y_m)],
            sector_first_rad: finite(message.sector_first_rad),
            sector_rad: finite(message.sector_rad),
            free_m: message.free_m.map(finite),
        }
    }

    /// Whether something else than the awaited answer left, or it left late.
    pub(super) fn is_miss(&self) -> bool {
        self.level >= QualityLevel::Moved || self.faults.contains(Faults::DEADLINE_MISSED)
    }

    /// Whether it is the module's last word: no key frame asked for it.
    fn is_last_word(&self) -> bool {
        self.faults.contains(Faults::SHUTTING_DOWN)
    }
}

/// One key frame of the history.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) sequence: u64,
    pub(super) received: Now,
    pub(super) used_micros: u32,
    pub(super) budget_micros: u32,
    pub(super) level: QualityLevel,
    pub(super) blame: Option<Blame>,
    pub(super) faults: Faults,
    pub(super) is_miss: bool,
    /// Known where the module shows views.
    pub(super) stage_micros: Option<[u64; Stage::ALL.len()]>,
}

/// Time spent in a stage so far, as its views tell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct StageTotal {
    pub(super) runs: u64,
    pub(super) micros: u64,
}

/// Everything the monitor knows.
#[derive(Clone, Debug)]
pub struct State {
    pub(super) name: String,
    pub(super) fault: Option<ReaderError>,
    pub(super) last: Option<Last>,
    pub(super) view: Option<View>,
    /// Message that the view's picture belongs to: an earlier one than the view's, where that came without.
    pub(super) picture_sequence: Option<u64>,
    pub(super) latency: LatencyHistogram,
    pub(super) bins: [u64; BINS],
    pub(super) buckets: [u64; BUCKETS_MICROS.len() + 1],
    pub(super) latency_sum_micros: u64,
    pub(super) messages: u64,
    pub(super) lost: u64,
    pub(super) starts: u64,
    pub(super) misses: u64,
    pub(super) misses_by_blame: [u64; Blame::ALL.len() + 1],
    pub(super) levels: [u64; 6],
    pub(super) faults: [u64; Faults::NAMED.len()],
    pub(super) stages: [StageTotal; Stage::ALL.len()],
    pub(super) history: VecDeque<Entry>,
    pub(super) missed: VecDeque<Entry>,
    /// None before they are read first.
    pub(super) temperatures: Option<Temperatures>,
}

impl State {
    /// Knows nothing yet of the module that publishes under `name`.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            fault: Some(ReaderError::NoModule),
            last: None,
            view: None,
            picture_sequence: None,
            latency: LatencyHistogram::new(),
            bins: [0; BINS],
            buckets: [0; BUCKETS_MICROS.len() + 1],
            latency_sum_micros: 0,
            messages: 0,
            lost: 0,
            starts: 0,
            misses: 0,
            misses_by_blame: [0; Blame::ALL.len() + 1],
            levels: [0; 6],
            faults: [0; Faults::NAMED.len()],
            stages: Default::default(),
            history: VecDeque::with_capacity(HISTORY),
            missed: VecDeque::with_capacity(MISSES),
            temperatures: None,
        }
    }

    /// Messages taken so far.
    #[must_use]
    pub const fn messages(&self) -> u64 {
        self.messages
    }

    /// Whether the module showed a view.
    #[must_use]
    pub const fn has_view(&self) -> bool {
        self.view.is_some()
    }

    /// The service is open, or why it is not.
    pub fn link(&mut self, opened: Result<(), ReaderError>) {
        self.fault = opened.err();
    }

    /// Takes a message that passed its check.
    pub fn message(&mut self, message: &SharedMessage, now: Now) {
        let header = Header::of(message);
        if self.is_known(&header) {
            return;
        }
        self.follow_on(&header);
        self.count(&header);
        if !header.is_last_word() {
            self.answer(&header, now);
        }
        let cells = message.cells();
        let (mut occupancy, mut reason, mut age) = self
            .last
            .take()
            .map_or_else(Default::default, |last| (last.occupancy, last.reason, last.age));
        occupancy.clear();
        occupancy.extend_from_slice(&message.occupancy[..cells]);
        reason.clear();
        reason.extend_from_slice(&message.reason[..cells]);
        age.clear();
        age.extend_from_slice(&message.age[..cells]);
        self.last = Some(Last {
            header,
            occupancy,
            reason,
            age,
        });
    }

    /// Takes a view; its stage times go to the key frame that they belong to.
    pub fn view(&mut self, mut view: View) {
        let ViewStatus {
            sequence,
            stage_micros,
            ..
        } = view.status;
        let entries = self.history.iter_mut().chain(&mut self.missed);
        for entry in entries.filter(|entry| entry.sequence == sequence) {
            entry.stage_micros = Some(stage_micros);
        }
        for (total, micros) in self.stages.iter_mut().zip(stage_micros) {
            // A fallback ran no stage but the last: that is no sample of zero.
            if micros > 0 {
                total.runs += 1;
                total.micros += micros;
            }
        }
        // An instant without a frame has no picture; the last one stays, under its own number.
        if !view.picture.is_empty() {
            self.picture_sequence = Some(sequence);
        } else if let Some(earlier) = self.view.take() {
            view.picture = earlier.picture;
        }
        self.view = Some(view);
    }

    /// Takes how warm the computer is.
    pub fn temperatures(&mut self, temperatures: Temperatures) {
        self.temperatures = Some(temperatures);
    }

    /// How warm the computer is; none before that is known, and where a sensor has held up the readings.
    #[must_use]
    pub(super) fn fresh_temperatures(&self, now: Now) -> Option<&Temperatures> {
        let read = self.temperatures.as_ref();
        read.filter(|read| now.monotonic.since(read.at) < STALE_TEMPERATURE_MICROS)
    }

    /// How long the module has been silent; none before its first message.
    #[must_use]
    pub fn silent_micros(&self, now: Now) -> Option<u64> {
        let last = self.last.as_ref()?;
        Some(now.monotonic.since(last.header.handed_over))
    }

    /// Whether the last message is recent.
    #[must_use]
    pub fn is_live(&self, now: Now) -> bool {
        self.silent_micros(now)
            .is_some_and(|micros| micros < STALE_MICROS)
            && !self.is_ended()
    }

    /// Whether the module said that it ends.
    pub(super) fn is_ended(&self) -> bool {
        let last = self.last.as_ref();
        last.is_some_and(|last| last.header.is_last_word())
    }

    /// Whether this is the last message once more: a reader that is opened anew gets it again.
    fn is_known(&self, header: &Header) -> bool {
        self.last.as_ref().is_some_and(|last| {
            (last.header.sequence, last.header.handed_over) == (header.sequence, header.handed_over)
        })
    }

    /// Counts messages lost, and starts of the module.
    fn follow_on(&mut self, header: &Header) {
        match &self.last {
            Some(last) if header.sequence > last.header.sequence => {
                self.lost += header.sequence - last.header.sequence - 1;
            }
            // It counts from 0 anew; a picture of before is no picture of it.
            _ => {
                self.starts += 1;
                self.picture_sequence = None;
                if let Some(view) = &mut self.view {
                    view.picture.clear();
                }
            }
        }
    }

    fn count(&mut self, header: &Header) {
        self.messages += 1;
        self.levels[header.level as usize] += 1;
        for (count, (fault, _)) in self.faults.iter_mut().zip(Faults::NAMED) {
            *count += u64::from(header.faults.contains(fault));
        }
    }

    /// Takes an answer to a key frame.
    fn answer(&mut self, header: &Header, now: Now) {
        let micros = u64::from(header.used_micros);
        self.latency.record(micros);
        self.latency_sum_micros = self.latency_sum_micros.saturating_add(micros);
        self.bins[usize::try_from(micros / BIN_MICROS).map_or(BINS - 1, |bin| bin.min(BINS - 1))] += 1;
        self.buckets[BUCKETS_MICROS.partition_point(|end| *end < micros)] += 1;
        let entry = Entry {
            sequence: header.sequence,
            received: now,
            used_micros: header.used_micros,
            budget_micros: header.budget_micros,
            level: header.level,
            blame: header.blame,
            faults: header.faults,
            is_miss: header.is_miss(),
            stage_micros: None,
        };
        push(&mut self.history, entry, HISTORY);
        if entry.is_miss {
            self.misses += 1;
            self.misses_by_blame[usize::from(Blame::to_wire(header.blame))] += 1;
            push(&mut self.missed, entry, MISSES);
        }
    }
}

fn push(ring: &mut VecDeque<Entry>, entry: Entry, room: usize) {
    if ring.len() == room {
        ring.pop_front();
    }
    ring.push_back(entry);
}
