//! What a recorded drive is made of: topics, their schemas, and the messages that are this program's own.
//!
//! Pictures, grid, landmarks, transforms, calibration and log are Foxglove's schemas in protobuf, so that viewers show them (Rerun
//! all but the grid); what only a replay needs is JSON with a schema beside it. `log_time` is the capture stamp, of a publication the instant at which it left,
//! in nanoseconds of the drive's monotonic clock. Numbers are written so that they are read back to the last bit.

use std::borrow::Cow;

use foxglove::Encode;
use foxglove::schemas::{CameraCalibration, FrameTransform, Grid, Log, PointCloud, RawImage};
use freespace::health::TrackingState;
use freespace::space::Micros;
use freespace::track::WheelReading;
use serde::{Deserialize, Serialize};

/// A stream of messages of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// Every frame as the pipeline got it, `foxglove.RawImage`; the sequence is its index.
    Image,
    /// Frames that had to become key frames, before their pictures.
    KeyFrameWanted,
    /// The lens, `foxglove.CameraCalibration`.
    Calibration,
    /// Poses, `foxglove.FrameTransform`.
    Transform,
    /// The grid, `foxglove.Grid`.
    Grid,
    /// The map's landmarks, `foxglove.PointCloud`.
    Landmarks,
    /// Wheel readings as the pipeline got them.
    Wheels,
    /// What *frame* and *track* made of each frame.
    Frame,
    /// What left for each key frame: level, reasons, times.
    KeyFrame,
    /// Work on a key frame that a fallback answered.
    LateWork,
    /// CAN frames sent.
    CanOut,
    /// Lines of the log, `foxglove.Log`.
    Log,
}

/// A topic's schema and the encoding of its messages.
pub(super) struct Layout {
    pub(super) schema: String,
    pub(super) schema_encoding: String,
    pub(super) schema_data: Cow<'static, [u8]>,
    pub(super) message_encoding: &'static str,
}

impl Topic {
    /// All topics.
    pub const ALL: [Self; 12] = [
        Self::Image,
        Self::KeyFrameWanted,
        Self::Calibration,
        Self::Transform,
        Self::Grid,
        Self::Landmarks,
        Self::Wheels,
        Self::Frame,
        Self::KeyFrame,
        Self::LateWork,
        Self::CanOut,
        Self::Log,
    ];

    /// Its name in the file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Image => "/camera/image",
            Self::KeyFrameWanted => "/camera/key_frame_wanted",
            Self::Calibration => "/camera/calibration",
            Self::Transform => "/tf",
            Self::Grid => "/freespace/grid",
            Self::Landmarks => "/freespace/landmarks",
            Self::Wheels => "/wheels",
            Self::Frame => "/freespace/frame",
            Self::KeyFrame => "/freespace/key_frame",
            Self::LateWork => "/freespace/late_work",
            Self::CanOut => "/can/out",
            Self::Log => "/log",
        }
    }

    /// The topic of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    pub(super) fn layout(self) -> Layout {
        match self {
            Self::Image => foxglove_layout::<RawImage>(),
            Self::Calibration => foxglove_layout::<CameraCalibration>(),
            Self::Transform => foxglove_layout::<FrameTransform>(),
            Self::Grid => foxglove_layout::<Grid>(),
            Self::Landmarks => foxglove_layout::<PointCloud>(),
            Self::Log => foxglove_layout::<Log>(),
            Self::KeyFrameWanted => json_layout("freespace.KeyFrameWanted", WANTED_SCHEMA),
            Self::Wheels => json_layout("freespace.WheelReading", WHEELS_SCHEMA),
            Self::Frame => json_layout("freespace.Frame", FRAME_SCHEMA),
            Self::KeyFrame => json_layout("freespace.KeyFrame", KEY_FRAME_SCHEMA),
            Self::LateWork => json_layout("freespace.LateWork", LATE_WORK_SCHEMA),
            Self::CanOut => json_layout("freespace.CanFrames", CAN_SCHEMA),
        }
    }
}

fn foxglove_layout<T: Encode>() -> Layout {
    // Every message of the package has a schema.
    let schema = T::get_schema();
    Layout {
        schema: schema
            .as_ref()
            .map_or_else(String::new, |schema| schema.name.clone()),
        schema_encoding: schema
            .as_ref()
            .map_or_else(String::new, |schema| schema.encoding.clone()),
        schema_data: schema.map_or(Cow::Borrowed(&[][..]), |schema| schema.data),
        message_encoding: "protobuf",
    }
}

fn json_layout(name: &str, schema: &'static str) -> Layout {
    Layout {
        schema: name.to_owned(),
        schema_encoding: "jsonschema".to_owned(),
        schema_data: Cow::Borrowed(schema.as_bytes()),
        message_encoding: "json",
    }
}

const WANTED_SCHEMA: &str = r#"{"type":"object","properties":{"frame":{"type":"integer"}}}"#;
const WHEELS_SCHEMA: &str = r#"{"type":"object","description":"front left, front right, rear left, rear right","properties":{
"stamp_micros":{"type":"integer"},"until_micros":{"type":"integer","description":"the pipeline took it when it asked until then"},
"counts":{"type":"array","items":{"type":"integer"}},"direction":{"type":"array","items":{"type":"integer"}},
"mps":{"type":"array","items":{"type":"number"}}}}"#;
const FRAME_SCHEMA: &str = r#"{"type":"object","properties":{"frame":{"type":"integer"},"stamp_micros":{"type":"integer"},
"micros":{"type":"integer"},"is_key_frame":{"type":"boolean"},"tracking":{"type":"string"},
"learnt":{"type":"integer","description":"the key frame whose map and plane were learnt since the frame before"}}}"#;
const KEY_FRAME_SCHEMA: &str = r#"{"type":"object","properties":{"frame":{"type":["integer","null"]},
"stamp_micros":{"type":"integer"},"latency_micros":{"type":"integer"},"level":{"type":"string"},"is_miss":{"type":"boolean"},
"blame":{"type":["string","null"]},"faults":{"type":"array","items":{"type":"string"}},
"stage_micros":{"type":"array","items":{"type":"integer"},"description":"frame, track, map, priors, segmentation, crf, grid, emit"},
"refused":{"type":"integer"},"stopped_after":{"type":"array","items":{"type":["integer","null"]}}}}"#;
const LATE_WORK_SCHEMA: &str = r#"{"type":"object","properties":{"frame":{"type":"integer"},"stamp_micros":{"type":"integer"},
"micros":{"type":"integer","description":"from the capture until the publisher heard of its answer, or until it was given up"},
"faults":{"type":"array","items":{"type":"string"}},"stage_micros":{"type":"array","items":{"type":"integer"}},
"refused":{"type":"integer"},"stopped_after":{"type":"array","items":{"type":["integer","null"]}}}}"#;
const CAN_SCHEMA: &str = r#"{"type":"object","properties":{"frames":{"type":"array","items":{"type":"object","properties":{
"id":{"type":"integer"},"extended":{"type":"boolean"},"data":{"type":"string","description":"hexadecimal"}}}}}}"#;

/// A frame that had to become a key frame.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct WantedNote {
    /// Its index.
    pub frame: u64,
}

/// A wheel reading, and when the pipeline took it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WheelNote {
    /// Receive stamp.
    pub stamp_micros: u64,
    /// The pipeline asked for readings until then, and got this one.
    pub until_micros: u64,
    /// Counter values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub counts: Option<[u32; 4]>,
    /// Signs of travel, with `counts`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[i8; 4]>,
    /// Speeds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mps: Option<[f64; 4]>,
}

impl WheelNote {
    /// Of a reading that was taken when readings until `until` were asked for.
    #[must_use]
    pub const fn new(reading: &WheelReading, until: Micros) -> Self {
        let (counts, direction, mps) = match *reading {
            WheelReading::Counts {
                counts, direction, ..
            } => (Some(counts), Some(direction), None),
            WheelReading::Speeds { mps, .. } => (None, None, Some(mps)),
        };
        Self {
            stamp_micros: reading.stamp().0,
            until_micros: until.0,
            counts,
            direction,
            mps,
        }
    }

    /// The reading; none where the note holds neither counters nor speeds.
    #[must_use]
    pub fn reading(&self) -> Option<WheelReading> {
        let stamp = Micros(self.stamp_micros);
        match (self.counts, self.direction, self.mps) {
            (Some(counts), Some(direction), _) => Some(WheelReading::Counts {
                stamp,
                counts,
                direction,
            }),
            (_, _, Some(mps)) if mps.iter().all(|mps| mps.is_finite()) => {
                Some(WheelReading::Speeds { stamp, mps })
            }
            _ => None,
        }
    }
}

/// What *frame* and *track* made of a frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FrameNote {
    /// Its index.
    pub frame: u64,
    /// Capture stamp.
    pub stamp_micros: u64,
    /// Time that both stages took.
    pub micros: u64,
    /// Whether it is a key frame.
    pub is_key_frame: bool,
    /// State of the tracker.
    pub tracking: String,
    /// The key frame whose lesson was learnt since the frame before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learnt: Option<u64>,
}

impl FrameNote {
    /// Whether its pose was tracked, not dead-reckoned.
    #[must_use]
    pub fn is_tracked(&self) -> bool {
        self.tracking != format!("{:?}", TrackingState::DeadReckoning)
    }
}

/// What left for a key frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct KeyFrameNote {
    /// Index of its frame; none where it answers for an instant at which none came.
    pub frame: Option<u64>,
    /// Capture stamp.
    pub stamp_micros: u64,
    /// From capture to publication.
    pub latency_micros: u64,
    /// Quality level.
    pub level: String,
    /// Whether a fallback left in the answer's place, or the answer left late.
    pub is_miss: bool,
    /// What held it back.
    pub blame: Option<String>,
    /// Why it is not better.
    pub faults: Vec<String>,
    /// Time of each stage, in their order.
    pub stage_micros: [u64; 8],
    /// Stages that might not start, one bit each.
    pub refused: u8,
    /// Quanta after which the refinement of each stage was stopped.
    pub stopped_after: [Option<u16>; 8],
}

/// Work on a key frame that a fallback answered.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LateWorkNote {
    /// Index of its frame.
    pub frame: u64,
    /// Capture stamp.
    pub stamp_micros: u64,
    /// From the capture until the publisher heard of its answer, or until it was given up.
    pub micros: u64,
    /// Its faults.
    pub faults: Vec<String>,
    /// Time of each stage, in their order.
    pub stage_micros: [u64; 8],
    /// Stages that might not start, one bit each.
    pub refused: u8,
    /// Quanta after which the refinement of each stage was stopped.
    pub stopped_after: [Option<u16>; 8],
}

/// CAN frames of one publication.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CanNote {
    /// The frames, in their order.
    pub frames: Vec<CanFrameNote>,
}

/// A CAN frame.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CanFrameNote {
    /// Identifier.
    pub id: u32,
    /// Whether it has 29 bits.
    pub extended: bool,
    /// Data in hexadecimal.
    pub data: String,
}
