//! The state at an instant, in names and SI units: what the page polls, and what text and terminal say.
//!
//! In: a [`State`] and the time. Out: [`Snapshot`], as JSON. Invariant: every number is finite or null; a device is called
//! good only by a message that is recent. Cost: one pass over the history; the grid is not in it.

use freespace::health::{Blame, Faults, QualityLevel};
use freespace::stage::Stage;
use serde::Serialize;

use super::state::{BIN_MICROS, Entry, Last, Now, State};
use crate::statistics::{Percentiles, SCALE, TRACKING};
use crate::view::ViewStatus;

/// Whether messages come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Link {
    /// They do.
    Live,
    /// They did, and stopped.
    Silent,
    /// The module said that it ends.
    Ended,
    /// There was none yet.
    Waiting,
}

impl Link {
    /// Its one name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Live => "live",
            Self::Silent => "silent",
            Self::Ended => "ended",
            Self::Waiting => "waiting",
        }
    }
}

/// A name and how often.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Count {
    /// The name.
    pub name: &'static str,
    /// How often.
    pub count: u64,
}

/// The state at an instant.
#[derive(Clone, Debug, Serialize)]
pub struct Snapshot {
    /// Name of the service.
    pub service: String,
    /// Whether messages come.
    pub link: Link,
    /// Why there are none, and what to do.
    pub reason: Option<String>,
    /// Since the last message was handed over.
    pub silent_s: Option<f64>,
    /// The last message.
    pub message: Option<MessageView>,
    /// What messages add up to since the monitor started.
    pub totals: Totals,
    /// Capture to publication.
    pub latency: Latency,
    /// Last key frames, oldest first.
    pub history: Vec<KeyFrame>,
    /// Last misses, newest first.
    pub misses: Vec<KeyFrame>,
    /// What the module's observer tells.
    pub module: Option<ViewStatus>,
    /// Whether there is a picture.
    pub has_picture: bool,
    /// Number of the message that the picture belongs to; it may be an earlier one than the last.
    pub picture_sequence: Option<u64>,
    /// How warm the computer is, by sensor; empty where that is not known.
    pub temperatures: Vec<Temperature>,
    /// What is to be said of sensors that are not there, or not shown.
    pub temperature_note: Option<String>,
    /// Names of the stages, in their order.
    pub stages: [&'static str; Stage::ALL.len()],
}

/// One sensor of the computer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Temperature {
    /// What it measures, in the kernel's words.
    pub zone: String,
    /// Degrees Celsius.
    pub celsius: f64,
}

/// The last message in names and numbers.
#[derive(Clone, Debug, Serialize)]
pub struct MessageView {
    /// Number of the message.
    pub sequence: u64,
    /// Time from capture to publication.
    pub used_ms: f64,
    /// Time from capture to deadline.
    pub budget_ms: f64,
    /// Quality level.
    pub level: &'static str,
    /// 0 best to 5 invalid.
    pub level_number: u8,
    /// Whom to blame.
    pub blame: Option<&'static str>,
    /// Faults.
    pub faults: Vec<&'static str>,
    /// Source of the metric scale.
    pub scale: &'static str,
    /// Source of the pose.
    pub tracking: &'static str,
    /// State of the camera, as the faults tell it.
    pub camera: &'static str,
    /// State of the wheel encoders.
    pub wheels: &'static str,
    /// State of what is sent over CAN.
    pub can: &'static str,
    /// Speed, m/s.
    pub speed_mps: f32,
    /// Yaw rate, positive left.
    pub yaw_rate_radps: f32,
    /// Free distance straight ahead from the rear axle.
    pub free_ahead_m: f32,
    /// Vehicle in the world.
    pub position_m: [f64; 3],
    /// Camera over the road.
    pub camera_height_m: f32,
    /// Spread of the landmarks about the plane.
    pub plane_sigma_m: f32,
    /// Landmarks on the plane.
    pub plane_inliers: u32,
    /// The grid's size; its cells are fetched apart.
    pub grid: GridSize,
    /// Free distance by bearing.
    pub boundary: Boundary,
}

/// Size and place of the grid.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct GridSize {
    /// Rows, the nearest first.
    pub rows: usize,
    /// Columns, from right to left.
    pub columns: usize,
    /// Edge of a cell.
    pub cell_m: f32,
    /// Near right corner in the vehicle: ahead, left.
    pub origin_m: [f32; 2],
}

/// Free distance by bearing.
#[derive(Clone, Debug, Serialize)]
pub struct Boundary {
    /// Right edge of sector 0, positive left.
    pub first_rad: f32,
    /// Width of a sector.
    pub sector_rad: f32,
    /// Free distance of each.
    pub free_m: Vec<f32>,
}

/// Counts since the monitor started.
#[derive(Clone, Debug, Serialize)]
pub struct Totals {
    /// Messages read.
    pub messages: u64,
    /// Messages that the monitor missed.
    pub lost: u64,
    /// Starts of the module, the first one seen among them.
    pub starts: u64,
    /// Deadline misses.
    pub misses: u64,
    /// Misses by what they are blamed on.
    pub misses_by_blame: Vec<Count>,
    /// Messages at each level.
    pub levels: Vec<Count>,
    /// Messages with each fault.
    pub faults: Vec<Count>,
}

/// Capture to publication.
#[derive(Clone, Debug, Serialize)]
pub struct Latency {
    /// Samples.
    pub count: u64,
    /// Percentiles, milliseconds.
    pub percentiles: Option<Percentiles>,
    /// Width of a bin.
    pub bin_ms: f64,
    /// Samples in each; the last one is open.
    pub bins: Vec<u64>,
}

/// A key frame of the history.
#[derive(Clone, Debug, Serialize)]
pub struct KeyFrame {
    /// Number of the message.
    pub sequence: u64,
    /// When the monitor got it, milliseconds since 1970.
    pub unix_ms: u64,
    /// Time from capture to publication.
    pub used_ms: f64,
    /// Time from capture to deadline.
    pub budget_ms: f64,
    /// Quality level.
    pub level: &'static str,
    /// 0 best to 5 invalid.
    pub level_number: u8,
    /// Whom to blame.
    pub blame: Option<&'static str>,
    /// Faults.
    pub faults: Vec<&'static str>,
    /// Whether the deadline was missed.
    pub is_miss: bool,
    /// Time in each stage, where it is known.
    pub stages_ms: Option<Vec<f64>>,
}

#[expect(clippy::cast_precision_loss, reason = "microseconds of a key frame")]
pub(super) fn millis(micros: u64) -> f64 {
    micros as f64 / 1e3
}

impl KeyFrame {
    fn of(entry: &Entry) -> Self {
        Self {
            sequence: entry.sequence,
            unix_ms: entry.received.unix_ms,
            used_ms: millis(entry.used_micros.into()),
            budget_ms: millis(entry.budget_micros.into()),
            level: entry.level.name(),
            level_number: entry.level as u8,
            blame: entry.blame.map(Blame::name),
            faults: entry.faults.names().collect(),
            is_miss: entry.is_miss,
            stages_ms: entry.stage_micros.map(|stages| stages.map(millis).to_vec()),
        }
    }
}

/// The first of `named` that is in `faults`.
fn first(faults: Faults, named: &[(Faults, &'static str)]) -> Option<&'static str> {
    let found = named.iter().find(|(fault, _)| faults.contains(*fault));
    found.map(|(_, name)| *name)
}

fn camera(faults: Faults) -> &'static str {
    let known = [
        (Faults::CAMERA_SILENT, "silent"),
        (Faults::IMAGE_BLACK, "black"),
        (Faults::IMAGE_FROZEN, "frozen"),
        (Faults::IMAGE_BLOCKED, "blocked"),
        (Faults::IMAGE_OVEREXPOSED, "overexposed"),
        (Faults::KEY_FRAME_MISSING, "frames missing"),
    ];
    first(faults, &known).unwrap_or("good")
}

fn wheels(faults: Faults, scale: &str) -> &'static str {
    let known = [
        (Faults::WHEELS_SILENT, "silent"),
        (Faults::WHEELS_SLIP, "slip"),
        (Faults::CLOCK_OFFSET, "clock offset"),
    ];
    let unused = if scale == "camera_height" {
        "not used"
    } else {
        "good"
    };
    first(faults, &known).unwrap_or(unused)
}

impl MessageView {
    fn of(last: &Last, link: Link) -> Self {
        let header = &last.header;
        let faults = header.faults;
        // A message that is old, or the last one, says nothing of now.
        let if_live = |state| if link == Link::Live { state } else { "unknown" };
        let scale = SCALE.get(usize::from(header.scale)).copied().unwrap_or("unknown");
        let tracking = TRACKING.get(usize::from(header.tracking)).copied();
        let can = [(Faults::CAN_SEND_FAILED, "sending fails")];
        Self {
            sequence: header.sequence,
            used_ms: millis(header.used_micros.into()),
            budget_ms: millis(header.budget_micros.into()),
            level: header.level.name(),
            level_number: header.level as u8,
            blame: header.blame.map(Blame::name),
            faults: faults.names().collect(),
            scale: if_live(scale),
            tracking: if_live(tracking.unwrap_or("unknown")),
            camera: if_live(camera(faults)),
            wheels: if_live(wheels(faults, scale)),
            can: if_live(first(faults, &can).unwrap_or("no fault")),
            speed_mps: header.speed_mps,
            yaw_rate_radps: header.yaw_rate_radps,
            free_ahead_m: if link == Link::Live {
                header.free_ahead_m
            } else {
                0.0
            },
            position_m: header.position_m.map(|m| if m.is_finite() { m } else { 0.0 }),
            camera_height_m: header.plane_offset_m,
            plane_sigma_m: header.plane_sigma_m,
            plane_inliers: header.plane_inliers,
            grid: GridSize {
                rows: header.rows,
                columns: header.columns,
                cell_m: header.cell_m,
                origin_m: header.origin_m,
            },
            boundary: Boundary {
                first_rad: header.sector_first_rad,
                sector_rad: header.sector_rad,
                free_m: header.free_m.to_vec(),
            },
        }
    }
}

/// Those counted at least once.
fn counts(named: impl Iterator<Item = (&'static str, u64)>) -> Vec<Count> {
    named
        .filter(|(_, count)| *count > 0)
        .map(|(name, count)| Count { name, count })
        .collect()
}

/// Everyone who may be blamed, in the order of their numbers on the wire.
pub(super) fn blamed(state: &State) -> impl Iterator<Item = (&'static str, u64)> {
    let names = std::iter::once("unknown").chain(Blame::ALL.map(Blame::name));
    names.zip(state.misses_by_blame)
}

/// The quality levels, best first.
pub(super) fn levels(state: &State) -> impl Iterator<Item = (&'static str, u64)> {
    let level = |number| QualityLevel::from_wire(number).unwrap_or_default().name();
    (0..6).map(level).zip(state.levels)
}

/// The sensors that are shown, and what is to be said of the others.
fn temperatures(state: &State, now: Now) -> (Vec<Temperature>, Option<String>) {
    let Some(read) = state.fresh_temperatures(now) else {
        let why = if state.temperatures.is_none() {
            "not read yet"
        } else {
            "a sensor has not answered for 10 s"
        };
        return (Vec::new(), Some(why.to_owned()));
    };
    let zones = read.zones.iter().map(|zone| Temperature {
        zone: zone.name.clone(),
        celsius: zone.celsius,
    });
    let note = match (read.zones.len() + read.unreadable, read.unreadable, read.left_out) {
        (0, ..) => Some("this computer shows no sensor in /sys/class/thermal or /sys/class/hwmon".to_owned()),
        (_, 0, 0) => None,
        (_, 0, left_out) => Some(format!("{left_out} more are not shown")),
        (_, unreadable, 0) => Some(format!("{unreadable} cannot be read")),
        (_, unreadable, left_out) => Some(format!(
            "{unreadable} cannot be read, {left_out} more are not shown"
        )),
    };
    (zones.collect(), note)
}

impl Snapshot {
    /// Of a state, now.
    #[must_use]
    pub fn of(state: &State, now: Now) -> Self {
        let link = match &state.last {
            None => Link::Waiting,
            Some(_) if state.is_ended() => Link::Ended,
            Some(_) if state.is_live(now) => Link::Live,
            Some(_) => Link::Silent,
        };
        let silent = "the module publishes nothing: look at its service, or start it";
        let reason = match (link, state.fault) {
            (Link::Live | Link::Ended, _) => None,
            (_, Some(fault)) => Some(fault.to_string()),
            (_, None) => Some(silent.to_owned()),
        };
        let faults = Faults::NAMED.map(|(_, name)| name).into_iter();
        let (temperatures, temperature_note) = temperatures(state, now);
        Self {
            service: state.name.clone(),
            link,
            reason,
            silent_s: state.silent_micros(now).map(|micros| millis(micros) / 1e3),
            message: state.last.as_ref().map(|last| MessageView::of(last, link)),
            totals: Totals {
                messages: state.messages,
                lost: state.lost,
                starts: state.starts,
                misses: state.misses,
                misses_by_blame: counts(blamed(state)),
                levels: counts(levels(state)),
                faults: counts(faults.zip(state.faults)),
            },
            latency: Latency {
                count: state.latency.count(),
                percentiles: state.latency.percentiles(),
                bin_ms: millis(BIN_MICROS),
                bins: state.bins.to_vec(),
            },
            history: state.history.iter().map(KeyFrame::of).collect(),
            misses: state.missed.iter().rev().map(KeyFrame::of).collect(),
            module: state.view.as_ref().map(|view| view.status.clone()),
            has_picture: state.view.as_ref().is_some_and(|view| !view.picture.is_empty()),
            picture_sequence: state.picture_sequence,
            temperatures,
            temperature_note,
            stages: Stage::ALL.map(Stage::name),
        }
    }
}
