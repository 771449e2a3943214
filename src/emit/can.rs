//! Classic CAN frames of eight bytes, protected end to end; `config/freespace.dbc` is their description.
//!
//! In: a [`Header`]. Out: status, timing, ego motion, plane and eight sector frames. Invariant: signals are little-endian,
//! clamped to their range, never wrapped; every frame carries CRC and counter. Cost: twelve frames, constant.
//! Source: AUTOSAR E2E profile 11 with both data-id bytes implicit (11A): byte 0 is the CRC-8 over data id and bytes 1 to
//! 7, the low nibble of byte 1 a counter 0 to 14.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "signals are clamped to their range before the cast"
)]

#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::Header;
use super::crc::crc8;
use crate::budget::SECTORS;
use crate::health::Blame;

/// A frame for any CAN driver.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CanFrame {
    /// Identifier.
    pub id: u32,
    /// Whether the identifier has 29 bits.
    pub extended: bool,
    /// Up to 8 bytes, 64 with CAN FD.
    pub data: heapless::Vec<u8, 64>,
}

impl CanFrame {
    /// Whether the frame is one of CAN FD: it is where it must be.
    #[must_use]
    pub fn is_fd(&self) -> bool {
        self.data.len() > CLASSIC_BYTES
    }
}

/// Largest data of a classic frame.
pub const CLASSIC_BYTES: usize = 8;

/// Identifier of the status frame; see `config/freespace.dbc`.
pub const STATUS_ID: u32 = 0x600;
/// Identifier of the timing frame.
pub const TIMING_ID: u32 = 0x601;
/// Identifier of the ego-motion frame.
pub const EGO_ID: u32 = 0x602;
/// Identifier of the plane frame.
pub const PLANE_ID: u32 = 0x603;
/// Identifier of the first sector frame; the others follow.
pub const SECTORS_ID: u32 = 0x610;
/// Sectors in a frame.
pub const SECTORS_PER_FRAME: usize = 4;
/// Frames of one publication.
pub const FRAMES: usize = 4 + SECTORS / SECTORS_PER_FRAME;

/// E2E data id of a frame: its identifier, moved out of the way of other users of the same bus.
const DATA_ID_BASE: u16 = 0x4600;
/// Counter values of profile 11: 0 to 14.
const COUNTERS: u8 = 15;

/// Encodes publications; keeps the E2E counters.
#[derive(Clone, Debug, Default)]
pub struct CanEncoder {
    counter: u8,
}

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanCheckError {
    /// Not eight bytes.
    WrongLength,
    /// CRC or data id differ: damaged, or another message under this identifier.
    WrongChecksum,
}

impl CanEncoder {
    /// All frames of one publication, in the order to send them.
    #[must_use]
    pub fn encode(&mut self, header: &Header) -> heapless::Vec<CanFrame, FRAMES> {
        let mut frames = heapless::Vec::new();
        for frame in [status(header), timing(header), ego(header), plane(header)] {
            self.protect(frame.0, frame.1, &mut frames);
        }
        for group in 0..SECTORS / SECTORS_PER_FRAME {
            self.protect(SECTORS_ID + group as u32, sectors(header, group), &mut frames);
        }
        // All frames of a publication carry the same counter: a reader can tell sectors that belong together.
        self.counter = (self.counter + 1) % COUNTERS;
        frames
    }

    fn protect(&self, id: u32, mut payload: u64, frames: &mut heapless::Vec<CanFrame, FRAMES>) {
        payload |= u64::from(self.counter) << 8;
        let mut bytes = payload.to_le_bytes();
        bytes[0] = checksum(id, &bytes);
        let mut frame = CanFrame {
            id,
            ..CanFrame::default()
        };
        // Eight of 64 bytes, and FRAMES frames: neither can be full.
        let _ = frame.data.extend_from_slice(&bytes);
        let _ = frames.push(frame);
    }
}

/// Checks a frame's length, data id and CRC; returns its counter.
///
/// # Errors
/// See [`CanCheckError`].
pub fn check(frame: &CanFrame) -> Result<u8, CanCheckError> {
    let bytes: &[u8; 8] = frame
        .data
        .as_slice()
        .try_into()
        .map_err(|_| CanCheckError::WrongLength)?;
    if bytes[0] == checksum(frame.id, bytes) {
        Ok(bytes[1] & 0x0F)
    } else {
        Err(CanCheckError::WrongChecksum)
    }
}

/// CRC of profile 11A: data id low and high byte, then all bytes but the CRC itself.
fn checksum(id: u32, bytes: &[u8; 8]) -> u8 {
    let data_id = DATA_ID_BASE.wrapping_add(id as u16);
    crc8(crc8(0, &data_id.to_le_bytes()), &bytes[1..])
}

/// An unsigned signal of `bits` at `start`; not a number becomes the largest value, which the DBC calls invalid.
fn unsigned(value: f64, unit: f64, start: u32, bits: u32) -> u64 {
    let largest = (1u64 << bits) - 1;
    let raw = if value.is_nan() {
        largest
    } else {
        (value / unit).round().clamp(0.0, (largest - 1) as f64) as u64
    };
    raw << start
}

/// A signed 16-bit signal at `start`; not a number becomes the smallest value, which the DBC calls invalid.
fn signed(value: f64, unit: f64, start: u32) -> u64 {
    let raw = if value.is_nan() {
        i16::MIN
    } else {
        (value / unit).round().clamp(-32767.0, 32767.0) as i16
    };
    u64::from(raw.cast_unsigned()) << start
}

fn status(h: &Header) -> (u32, u64) {
    let payload = (h.level as u64) << 12
        | u64::from(h.faults.0) << 16
        | (h.scale as u64) << 48
        | (h.tracking as u64) << 52
        | (h.sequence & 0xFF) << 56;
    (STATUS_ID, payload)
}

fn timing(h: &Header) -> (u32, u64) {
    let millis = |micros: u64| micros as f64 * 1e-3;
    let payload = unsigned(millis(h.publish.since(h.capture)), 0.1, 16, 16)
        | unsigned(millis(u64::from(h.used_micros)), 0.1, 32, 16)
        | unsigned(millis(u64::from(h.budget_micros)), 1.0, 48, 12)
        | u64::from(Blame::to_wire(h.blame)) << 60
        | u64::from(h.publish > h.deadline) << 12;
    (TIMING_ID, payload)
}

fn ego(h: &Header) -> (u32, u64) {
    let [x, y, z, w] = h.orientation;
    let heading_rad = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    let payload = signed(f64::from(h.speed_mps), 0.01, 16)
        | signed(f64::from(h.yaw_rate_radps), 1e-4, 32)
        | signed(heading_rad, 1e-4, 48);
    (EGO_ID, payload)
}

fn plane(h: &Header) -> (u32, u64) {
    let [x, y, z] = h.plane_normal.map(f64::from);
    let payload = unsigned(f64::from(h.plane_offset_m), 0.001, 16, 16)
        | signed((-z).atan2(-y), 1e-4, 32)
        | signed((-x).atan2(-y), 1e-4, 48)
        | u64::from(h.plane_inliers == 0) << 12;
    (PLANE_ID, payload)
}

fn sectors(h: &Header, group: usize) -> u64 {
    let free_m = &h.free_m[group * SECTORS_PER_FRAME..][..SECTORS_PER_FRAME];
    let start = |slot: usize| 16 + 12 * slot as u32;
    free_m.iter().enumerate().fold(0, |payload, (slot, &m)| {
        payload | unsigned(f64::from(m), 0.02, start(slot), 12)
    })
}

#[cfg(test)]
mod tests;
