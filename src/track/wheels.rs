//! Wheel odometry: counter values or speeds of four wheels in, distance and heading at any stamp out.
//!
//! Counters wrap; the increment between two readings is taken as the smallest signed one. Between readings the travel is
//! interpolated, after the last one it is extrapolated for at most [`WheelConfig::timeout_micros`]; older stamps than the
//! history holds have no answer. A full history forgets its oldest reading.

use heapless::Deque;

use crate::budget::WHEEL_HISTORY;
use crate::space::Micros;

/// One message of the wheel encoders, in the order front left, front right, rear left, rear right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WheelReading {
    /// Raw counters and the direction of travel: 1 ahead, -1 back, 0 unknown or standing.
    Counts {
        /// Receive stamp.
        stamp: Micros,
        /// Counter values, each below the configured modulus.
        counts: [u32; 4],
        /// Sign of travel of each wheel.
        direction: [i8; 4],
    },
    /// Wheel speeds in metres a second, negative when rolling back.
    Speeds {
        /// Receive stamp.
        stamp: Micros,
        /// Speed of each wheel.
        mps: [f64; 4],
    },
}

impl WheelReading {
    /// Receive stamp.
    #[must_use]
    pub const fn stamp(&self) -> Micros {
        match self {
            Self::Counts { stamp, .. } | Self::Speeds { stamp, .. } => *stamp,
        }
    }
}

/// What the odometer must know of the encoders.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize), serde(deny_unknown_fields))]
pub struct WheelConfig {
    /// Metres a raw count; unused for speeds.
    #[cfg_attr(feature = "serde", serde(default))]
    pub metres_per_count: f64,
    /// Counter modulus (256 for 8 bits); unused for speeds.
    #[cfg_attr(feature = "serde", serde(default))]
    pub modulus: u32,
    /// Distance between the wheels of an axle.
    pub track_m: f64,
    /// Silence after which the travel is unknown.
    pub timeout_micros: u64,
}

/// Distance and heading since the first reading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Travel {
    /// Signed distance of the rear axle's centre along its path.
    pub distance_m: f64,
    /// Heading from the rear wheels' difference, positive left.
    pub heading_rad: f64,
}

/// Integrates wheel readings.
#[derive(Clone, Debug)]
pub struct WheelOdometer {
    config: WheelConfig,
    last: Option<WheelReading>,
    wheel_m: [f64; 4],
    history: Deque<(Micros, Travel), WHEEL_HISTORY>,
    rejected: u64,
}
