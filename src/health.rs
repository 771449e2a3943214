//! Faults and the quality ladder: what every message says about itself.
//!
//! In: nothing. Out: [`QualityLevel`], [`Faults`] and the two states, small `Copy` values that every stage may set.
//! Invariant: their numbers are on the wire (shared memory, CAN, `config/freespace.dbc`) and never change meaning.

use core::ops::{BitOr, BitOrAssign};

use crate::frame::ImageFault;
use crate::stage::Stage;

/// How good a published grid is, best first (the deadline's ladder).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum QualityLevel {
    /// Every stage ran to its end on this key frame, and found what it looks for: all that is said is fresh.
    Full = 0,
    /// Every stage left its base result; refinement was cut short, or plane or scale are held though all ran.
    NoRefinement = 1,
    /// The network's last probabilities, moved by the pose, stand in for fresh ones.
    NoFreshNetwork = 2,
    /// There is no map, or it and the plane had to be held; or the pose comes from the wheels alone.
    NoFreshMap = 3,
    /// The last grid, moved by the wheels and aged.
    Moved = 4,
    /// Nothing to rely on; the faults say why.
    #[default]
    Invalid = 5,
}

impl QualityLevel {
    /// The level's one name, in reports and records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoRefinement => "no_refinement",
            Self::NoFreshNetwork => "no_fresh_network",
            Self::NoFreshMap => "no_fresh_map",
            Self::Moved => "moved",
            Self::Invalid => "invalid",
        }
    }

    /// The level of a number on the wire.
    #[must_use]
    pub const fn from_wire(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::Full,
            1 => Self::NoRefinement,
            2 => Self::NoFreshNetwork,
            3 => Self::NoFreshMap,
            4 => Self::Moved,
            5 => Self::Invalid,
            _ => return None,
        })
    }
}

/// What held an answer back, or lowered its level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blame {
    /// No frame came.
    Camera,
    /// A stage ran out of its slice, hung, failed or panicked.
    Stage(Stage),
}

impl Blame {
    /// Everyone who may be blamed, in the order of their numbers on the wire, which begin at 1.
    pub const ALL: [Self; Stage::ALL.len() + 1] = {
        let mut all = [Self::Camera; Stage::ALL.len() + 1];
        let mut index = 0;
        while index < Stage::ALL.len() {
            all[index] = Self::Stage(Stage::ALL[index]);
            index += 1;
        }
        all
    };

    /// The number on the wire; 0 is nobody.
    #[must_use]
    pub const fn to_wire(blame: Option<Self>) -> u8 {
        match blame {
            None => 0,
            Some(Self::Stage(stage)) => stage as u8 + 1,
            // One after the last stage.
            Some(Self::Camera) => Stage::Emit as u8 + 2,
        }
    }

    /// The blame of a number on the wire; none for numbers that mean nothing.
    #[must_use]
    pub fn from_wire(number: u8) -> Option<Option<Self>> {
        match usize::from(number).checked_sub(1) {
            None => Some(None),
            Some(index) => Self::ALL.get(index).map(|blame| Some(*blame)),
        }
    }

    /// Name in reports: the stage's, or `camera`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Stage(stage) => stage.name(),
        }
    }
}

/// Where the metric scale comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum ScaleState {
    /// No metric scale yet.
    #[default]
    Unknown = 0,
    /// Wheel travel between key frames.
    Wheels = 1,
    /// The known camera height over the road plane.
    CameraHeight = 2,
    /// Held since its source failed.
    Held = 3,
}

impl ScaleState {
    /// The state of a number on the wire.
    #[must_use]
    pub const fn from_wire(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::Unknown,
            1 => Self::Wheels,
            2 => Self::CameraHeight,
            3 => Self::Held,
            _ => return None,
        })
    }
}

/// How a frame's pose came about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum TrackingState {
    /// Only the wheels, or the last speed, and the last turn rate; so are the first frames.
    #[default]
    DeadReckoning = 0,
    /// Many tracks agree.
    Good = 1,
    /// The car stands: the pose is held on purpose.
    Standstill = 2,
    /// Few tracks agree: usable, less certain.
    Weak = 3,
}

impl TrackingState {
    /// The state of a number on the wire.
    #[must_use]
    pub const fn from_wire(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::DeadReckoning,
            1 => Self::Good,
            2 => Self::Standstill,
            3 => Self::Weak,
            _ => return None,
        })
    }
}

/// A set of faults, one bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Faults(pub u32);

impl Faults {
    /// No fault.
    pub const NONE: Self = Self(0);
    /// The image is black: lens cap, exposure or sensor failure.
    pub const IMAGE_BLACK: Self = Self(1);
    /// Most of the image is at its white end.
    pub const IMAGE_OVEREXPOSED: Self = Self(1 << 1);
    /// The same image arrives again and again.
    pub const IMAGE_FROZEN: Self = Self(1 << 2);
    /// Part of the image never changes while the car moves: dirt or an object on the lens.
    pub const IMAGE_BLOCKED: Self = Self(1 << 3);
    /// No frame was captured since the instant of the cadence that this message answers for.
    pub const CAMERA_SILENT: Self = Self(1 << 4);
    /// No wheel reading within the encoders' time-out.
    pub const WHEELS_SILENT: Self = Self(1 << 5);
    /// Wheel travel and visual travel disagree: slip, lock or a stuck encoder.
    pub const WHEELS_SLIP: Self = Self(1 << 6);
    /// Too few tracks agree on a pose, or on one that a car can have come to: it is dead-reckoned.
    pub const TRACKING_LOST: Self = Self(1 << 7);
    /// The network did not end within its slice.
    pub const NETWORK_LATE: Self = Self(1 << 8);
    /// The network failed or gave values that are no probabilities.
    pub const NETWORK_FAILED: Self = Self(1 << 9);
    /// The map did not end within its slice.
    pub const MAP_LATE: Self = Self(1 << 10);
    /// The minimum cut was stopped; its labelling may not be the best one.
    pub const CUT_STOPPED: Self = Self(1 << 11);
    /// No road plane was found; the last one or the mount's stands in.
    pub const PLANE_HELD: Self = Self(1 << 12);
    /// The metric scale is held since its source failed.
    pub const SCALE_HELD: Self = Self(1 << 13);
    /// The wanted quality was not ready at the deadline.
    pub const DEADLINE_MISSED: Self = Self(1 << 14);
    /// Camera and CAN clocks disagree by more than configured.
    pub const CLOCK_OFFSET: Self = Self(1 << 15);
    /// A bounded hand-over was full and something newer replaced it.
    pub const HANDOVER_DROPPED: Self = Self(1 << 16);
    /// A CAN frame could not be sent (queue full or bus off).
    pub const CAN_SEND_FAILED: Self = Self(1 << 17);
    /// A stage panicked; its part was started anew.
    pub const STAGE_PANICKED: Self = Self(1 << 18);
    /// The module is being shut down: no grid follows.
    pub const SHUTTING_DOWN: Self = Self(1 << 19);
    /// Running without real-time rights or locked memory: deadlines are kept as far as the machine lets it.
    pub const RIGHTS_LACKING: Self = Self(1 << 20);
    /// The last answer is too old to be moved any further.
    pub const GRID_STALE: Self = Self(1 << 21);
    /// A frame that should have become a key frame did not come through *frame* and *track* in time.
    pub const KEY_FRAME_MISSING: Self = Self(1 << 22);

    /// An earlier message did not reach shared memory.
    pub const SHARING_FAILED: Self = Self(1 << 23);

    /// Every fault with its name, in bit order.
    pub const NAMED: [(Self, &'static str); 24] = [
        (Self::IMAGE_BLACK, "image_black"),
        (Self::IMAGE_OVEREXPOSED, "image_overexposed"),
        (Self::IMAGE_FROZEN, "image_frozen"),
        (Self::IMAGE_BLOCKED, "image_blocked"),
        (Self::CAMERA_SILENT, "camera_silent"),
        (Self::WHEELS_SILENT, "wheels_silent"),
        (Self::WHEELS_SLIP, "wheels_slip"),
        (Self::TRACKING_LOST, "tracking_lost"),
        (Self::NETWORK_LATE, "network_late"),
        (Self::NETWORK_FAILED, "network_failed"),
        (Self::MAP_LATE, "map_late"),
        (Self::CUT_STOPPED, "cut_stopped"),
        (Self::PLANE_HELD, "plane_held"),
        (Self::SCALE_HELD, "scale_held"),
        (Self::DEADLINE_MISSED, "deadline_missed"),
        (Self::CLOCK_OFFSET, "clock_offset"),
        (Self::HANDOVER_DROPPED, "handover_dropped"),
        (Self::CAN_SEND_FAILED, "can_send_failed"),
        (Self::STAGE_PANICKED, "stage_panicked"),
        (Self::SHUTTING_DOWN, "shutting_down"),
        (Self::RIGHTS_LACKING, "rights_lacking"),
        (Self::GRID_STALE, "grid_stale"),
        (Self::KEY_FRAME_MISSING, "key_frame_missing"),
        (Self::SHARING_FAILED, "sharing_failed"),
    ];

    /// Whether all of `other` are in this set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Adds `other`.
    pub const fn insert(&mut self, other: Self) {
        self.0 |= other.0;
    }

    /// Takes `other` out.
    pub const fn remove(&mut self, other: Self) {
        self.0 &= !other.0;
    }

    /// This set with `other` in it where `present`.
    #[must_use]
    pub const fn with(self, other: Self, present: bool) -> Self {
        if present { Self(self.0 | other.0) } else { self }
    }

    /// Names of the faults in this set, in bit order.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMED
            .into_iter()
            .filter(move |(fault, _)| self.contains(*fault))
            .map(|(_, name)| name)
    }
}

impl BitOr for Faults {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Faults {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl From<ImageFault> for Faults {
    fn from(fault: ImageFault) -> Self {
        match fault {
            ImageFault::Frozen => Self::IMAGE_FROZEN,
            ImageFault::Black => Self::IMAGE_BLACK,
            ImageFault::OverExposed => Self::IMAGE_OVEREXPOSED,
            ImageFault::Blocked => Self::IMAGE_BLOCKED,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    #[test]
    fn every_fault_has_its_own_bit_and_name() {
        let mut all = Faults::NONE;
        for (index, (fault, _)) in Faults::NAMED.into_iter().enumerate() {
            assert_eq!(fault.0, 1 << index);
            assert!(!all.contains(fault));
            all |= fault;
        }
        assert_eq!(all.names().count(), Faults::NAMED.len());
        let two = Faults::PLANE_HELD | Faults::NETWORK_LATE;
        assert_eq!(two.names().collect::<Vec<_>>(), ["network_late", "plane_held"]);
    }

    #[test]
    fn blame_survives_the_wire() {
        for blame in Blame::ALL.map(Some).into_iter().chain([None]) {
            assert_eq!(Blame::from_wire(Blame::to_wire(blame)), Some(blame));
        }
        assert_eq!(Blame::from_wire(Stage::Emit as u8 + 3), None);
    }

    #[test]
    fn levels_order_best_first_and_survive_the_wire() {
        assert!(QualityLevel::Full < QualityLevel::Moved);
        for number in 0..=u8::MAX {
            if let Some(level) = QualityLevel::from_wire(number) {
                assert_eq!(level as u8, number);
            }
        }
    }
}
