//! Stage 8, emit: the free-space message and its CAN frames.
//!
//! In: [`Publication`]: a [`Header`] of plain numbers and the fused grid. Out: bytes for shared memory ([`FreeSpaceMessage`])
//! and [`CanFrame`]s as `config/freespace.dbc` describes them. Invariant: whatever is encoded decodes to the same values;
//! damaged bytes are refused. Cost: one pass over the message; no allocation.

mod bus_load;
pub mod can;
pub mod crc;
pub mod grid_frames;
mod message;
mod shared;

pub use bus_load::{BitRates, BusLoad, FdFrameBits, fd_frame_bits, frame_bits};
pub use can::{CanEncoder, CanFrame};
pub use grid_frames::{GridEncoder, GridReader};
pub use message::{DecodeError, EncodeError, FreeSpaceMessage};
pub use shared::{Element, FIELDS, Field, SHARED_BYTES, SHARED_VERSION, SharedError, SharedMessage};

use crate::budget::SECTORS;
use crate::grid::Grid;
use crate::health::{Blame, Faults, QualityLevel, ScaleState, TrackingState};
use crate::space::Micros;

/// Everything a message says besides the cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// Counts key frames since start.
    pub sequence: u64,
    /// Capture stamp of the key frame.
    pub capture: Micros,
    /// When the message was handed over.
    pub publish: Micros,
    /// When it had to be.
    pub deadline: Micros,
    /// Time from capture to deadline.
    pub budget_micros: u32,
    /// Time from capture to the end of the last stage.
    pub used_micros: u32,
    /// Quality of the grid.
    pub level: QualityLevel,
    /// Why it is not better.
    pub faults: Faults,
    /// What held it back.
    pub blame: Option<Blame>,
    /// Where the metric scale comes from.
    pub scale: ScaleState,
    /// Where the pose comes from.
    pub tracking: TrackingState,
    /// Vehicle position in world space, metres.
    pub position_m: [f64; 3],
    /// Vehicle orientation in world space, quaternion `x y z w`.
    pub orientation: [f64; 4],
    /// Speed along the vehicle's x axis.
    pub speed_mps: f32,
    /// Yaw rate, positive left.
    pub yaw_rate_radps: f32,
    /// Unit normal of the road plane in camera space.
    pub plane_normal: [f32; 3],
    /// Height of the camera over the road plane.
    pub plane_offset_m: f32,
    /// Landmarks on the plane; zero where it was held.
    pub plane_inliers: u32,
    /// Robust spread of their heights.
    pub plane_sigma_m: f32,
    /// Bearing of sector 0's right edge, positive left.
    pub sector_first_rad: f32,
    /// Width of a sector.
    pub sector_rad: f32,
    /// Free distance in each sector from the vehicle's origin (on the ground under the rear axle), metres.
    pub free_m: [f32; SECTORS],
}

impl Default for Header {
    fn default() -> Self {
        Self {
            sequence: 0,
            capture: Micros(0),
            publish: Micros(0),
            deadline: Micros(0),
            budget_micros: 0,
            used_micros: 0,
            level: QualityLevel::Invalid,
            faults: Faults::NONE,
            blame: None,
            scale: ScaleState::Unknown,
            tracking: TrackingState::DeadReckoning,
            position_m: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            speed_mps: 0.0,
            yaw_rate_radps: 0.0,
            plane_normal: [0.0, -1.0, 0.0],
            plane_offset_m: 0.0,
            plane_inliers: 0,
            plane_sigma_m: 0.0,
            sector_first_rad: 0.0,
            sector_rad: 0.0,
            free_m: [0.0; SECTORS],
        }
    }
}

/// What is published for one key frame.
#[derive(Clone, Copy, Debug)]
pub struct Publication<'a> {
    /// Numbers.
    pub header: Header,
    /// Cells.
    pub grid: &'a Grid,
}
