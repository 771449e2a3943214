//! The shared-memory message: a fixed little-endian layout, without padding.
//!
//! | offset | type      | field |
//! |--------|-----------|-------|
//! | 0      | `u32`     | magic `FREE` (0x4545_5246) |
//! | 4      | `u16 u16` | version, header length in bytes |
//! | 8      | `u32`     | total length in bytes, check sum included |
//! | 12     | `u32`     | fault bits |
//! | 16     | `u64` x 4 | sequence; capture, publish and deadline stamps in microseconds |
//! | 48     | `u32 u32` | budget and used microseconds |
//! | 56     | `u8` x 4  | quality level, scale state, tracking state, blame |
//! | 60     | `u32`     | plane inliers |
//! | 64     | `f64` x 7 | position (m), orientation (x y z w) of the vehicle in the world |
//! | 120    | `f32` x 2 | speed (m/s), yaw rate (rad/s) |
//! | 128    | `f32` x 5 | plane normal (camera space), offset (m), sigma (m) |
//! | 148    | `u32` x 2 | grid rows, columns |
//! | 156    | `f32`     | cell edge (m) |
//! | 160    | `f32` x 2 | first bearing, sector width (rad) |
//! | 168    | `u32`     | sectors |
//! | 172    | `f32` x 32| free distance of each sector (m) |
//! | 300    | `i8` x n  | occupancy; then `u8` x n reason, `u8` x n age, row-major |
//! | last 4 | `u32`     | CRC-32 of everything before it |

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "cells are bounded by MAX_CELLS; occupancy keeps its bits"
)]

use super::crc::crc32;
use super::{Header, Publication};
use crate::budget::{MAX_CELLS, SECTORS};
use crate::health::{Blame, Faults, QualityLevel, ScaleState, TrackingState};
use crate::space::Micros;

/// First bytes of a message.
pub(super) const MAGIC: u32 = u32::from_le_bytes(*b"FREE");
/// Layout version.
const VERSION: u16 = 1;
/// Bytes before the cells.
const HEADER_BYTES: usize = 172 + 4 * SECTORS;

/// Why a message was not written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodeError {
    /// The buffer is shorter than [`FreeSpaceMessage::encoded_len`]: allocate it by that.
    BufferTooSmall,
    /// The grid's buffers do not match its rows and columns: a bug of its maker.
    GridMismatch,
}

/// Why bytes are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// Fewer bytes than the message says or needs: read again.
    TooShort,
    /// Not a free-space message: wrong source.
    WrongMagic,
    /// Another layout: update the reader.
    WrongVersion,
    /// The lengths inside contradict each other: drop it.
    WrongSize,
    /// The check sum differs: drop it.
    WrongChecksum,
    /// A state has a number that no version has given: drop it.
    UnknownState,
}

/// A message read from bytes that it borrows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeSpaceMessage<'a> {
    /// Numbers.
    pub header: Header,
    /// Grid rows.
    pub rows: usize,
    /// Grid columns.
    pub columns: usize,
    /// Edge of a cell.
    pub cell_m: f32,
    /// Occupancy of each cell as its bits, row-major; see [`FreeSpaceMessage::occupancy`].
    pub(super) occupancy: &'a [u8],
    /// Reason of each cell, row-major.
    pub reason: &'a [u8],
    /// Age of each cell in 0.1 s, row-major.
    pub age: &'a [u8],
}

struct Writer<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl Writer<'_> {
    fn put(&mut self, field: &[u8]) {
        self.bytes[self.at..self.at + field.len()].copy_from_slice(field);
        self.at += field.len();
    }

    fn floats(&mut self, values: &[f32]) {
        for value in values {
            self.put(&value.to_le_bytes());
        }
    }
}

impl Publication<'_> {
    /// Writes the message; returns its length in bytes.
    ///
    /// # Errors
    /// See [`EncodeError`]; nothing useful is in `out` then.
    pub fn encode_into(&self, out: &mut [u8]) -> Result<usize, EncodeError> {
        let (h, grid) = (&self.header, self.grid);
        let cells = grid.rows * grid.columns;
        if [grid.occupancy.len(), grid.reason.len(), grid.age.len()] != [cells; 3] || cells > MAX_CELLS {
            return Err(EncodeError::GridMismatch);
        }
        let length = FreeSpaceMessage::encoded_len(cells);
        let bytes = out.get_mut(..length).ok_or(EncodeError::BufferTooSmall)?;
        let mut w = Writer { bytes, at: 0 };
        w.put(&MAGIC.to_le_bytes());
        w.put(&VERSION.to_le_bytes());
        w.put(&(HEADER_BYTES as u16).to_le_bytes());
        w.put(&(length as u32).to_le_bytes());
        w.put(&h.faults.0.to_le_bytes());
        for value in [h.sequence, h.capture.0, h.publish.0, h.deadline.0] {
            w.put(&value.to_le_bytes());
        }
        w.put(&h.budget_micros.to_le_bytes());
        w.put(&h.used_micros.to_le_bytes());
        w.put(&[
            h.level as u8,
            h.scale as u8,
            h.tracking as u8,
            Blame::to_wire(h.blame),
        ]);
        w.put(&h.plane_inliers.to_le_bytes());
        for value in h.position_m.iter().chain(&h.orientation) {
            w.put(&value.to_le_bytes());
        }
        w.floats(&[h.speed_mps, h.yaw_rate_radps]);
        w.floats(&h.plane_normal);
        w.floats(&[h.plane_offset_m, h.plane_sigma_m]);
        w.put(&(grid.rows as u32).to_le_bytes());
        w.put(&(grid.columns as u32).to_le_bytes());
        w.floats(&[grid.cell_m, h.sector_first_rad, h.sector_rad]);
        w.put(&(SECTORS as u32).to_le_bytes());
        w.floats(&h.free_m);
        for (byte, &occupancy) in w.bytes[w.at..w.at + cells].iter_mut().zip(&grid.occupancy) {
            *byte = occupancy as u8;
        }
        w.at += cells;
        w.put(&grid.reason);
        w.put(&grid.age);
        let check = crc32(&w.bytes[..w.at]);
        w.put(&check.to_le_bytes());
        Ok(length)
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let field = self.slice(N)?;
        field.try_into().map_err(|_| DecodeError::TooShort)
    }

    fn slice(&mut self, length: usize) -> Result<&'a [u8], DecodeError> {
        let end = self.at.checked_add(length).ok_or(DecodeError::TooShort)?;
        let field = self.bytes.get(self.at..end).ok_or(DecodeError::TooShort)?;
        self.at = end;
        Ok(field)
    }

    fn u16(&mut self) -> Result<u16, DecodeError> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, DecodeError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, DecodeError> {
        self.take().map(u64::from_le_bytes)
    }

    fn f32(&mut self) -> Result<f32, DecodeError> {
        self.take().map(f32::from_le_bytes)
    }

    fn f32s<const N: usize>(&mut self) -> Result<[f32; N], DecodeError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f32()?;
        }
        Ok(values)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], DecodeError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.take().map(f64::from_le_bytes)?;
        }
        Ok(values)
    }
}

impl<'a> FreeSpaceMessage<'a> {
    /// Bytes of a message with `cells` cells.
    #[must_use]
    pub const fn encoded_len(cells: usize) -> usize {
        HEADER_BYTES + 3 * cells + 4
    }

    /// Occupancy of a cell, row-major; -1 (unknown) outside.
    #[must_use]
    pub fn occupancy(&self, cell: usize) -> i8 {
        self.occupancy.get(cell).map_or(-1, |&byte| byte as i8)
    }

    /// Reads a message at the start of `bytes`; what follows it is left alone.
    ///
    /// # Errors
    /// See [`DecodeError`].
    pub fn decode(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let (mut reader, body) = Self::begin(bytes)?;
        let mut tail = Reader { bytes, at: body };
        if tail.u32()? != crc32(&bytes[..body]) {
            return Err(DecodeError::WrongChecksum);
        }
        Self::fields(&mut reader, body)
    }

    /// The same for a message that never left the process that encoded it: the check sum, which takes longer than all the rest,
    /// is not computed again.
    ///
    /// # Errors
    /// See [`DecodeError`].
    pub fn decode_own(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let (mut reader, body) = Self::begin(bytes)?;
        Self::fields(&mut reader, body)
    }

    /// Reads what says how long the message is: the rest of it, and where its check sum stands.
    fn begin(bytes: &'a [u8]) -> Result<(Reader<'a>, usize), DecodeError> {
        let mut r = Reader { bytes, at: 0 };
        if r.u32()? != MAGIC {
            return Err(DecodeError::WrongMagic);
        }
        if r.u16()? != VERSION {
            return Err(DecodeError::WrongVersion);
        }
        if usize::from(r.u16()?) != HEADER_BYTES {
            return Err(DecodeError::WrongSize);
        }
        let length = r.u32()? as usize;
        let body = length.checked_sub(4).ok_or(DecodeError::WrongSize)?;
        let whole = bytes.get(..length).ok_or(DecodeError::TooShort)?;
        r.bytes = &whole[..body];
        Ok((r, body))
    }

    fn fields(r: &mut Reader<'a>, body: usize) -> Result<Self, DecodeError> {
        let mut header = Header {
            faults: Faults(r.u32()?),
            sequence: r.u64()?,
            capture: Micros(r.u64()?),
            publish: Micros(r.u64()?),
            deadline: Micros(r.u64()?),
            budget_micros: r.u32()?,
            used_micros: r.u32()?,
            ..Header::default()
        };
        let [level, scale, tracking, blame] = r.take()?;
        header.level = QualityLevel::from_wire(level).ok_or(DecodeError::UnknownState)?;
        header.scale = ScaleState::from_wire(scale).ok_or(DecodeError::UnknownState)?;
        header.tracking = TrackingState::from_wire(tracking).ok_or(DecodeError::UnknownState)?;
        header.blame = Blame::from_wire(blame).ok_or(DecodeError::UnknownState)?;
        header.plane_inliers = r.u32()?;
        header.position_m = r.f64s()?;
        header.orientation = r.f64s()?;
        [header.speed_mps, header.yaw_rate_radps] = r.f32s()?;
        header.plane_normal = r.f32s()?;
        [header.plane_offset_m, header.plane_sigma_m] = r.f32s()?;
        let (rows, columns) = (r.u32()? as usize, r.u32()? as usize);
        let [cell_m, first_rad, sector_rad] = r.f32s()?;
        (header.sector_first_rad, header.sector_rad) = (first_rad, sector_rad);
        if r.u32()? as usize != SECTORS {
            return Err(DecodeError::WrongSize);
        }
        header.free_m = r.f32s()?;
        let cells = rows.checked_mul(columns).filter(|&cells| cells <= MAX_CELLS);
        let cells = cells.ok_or(DecodeError::WrongSize)?;
        if HEADER_BYTES + 3 * cells != body {
            return Err(DecodeError::WrongSize);
        }
        Ok(Self {
            header,
            rows,
            columns,
            cell_m,
            occupancy: r.slice(cells)?,
            reason: r.slice(cells)?,
            age: r.slice(cells)?,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::grid::Grid;
    use alloc::vec;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    fn publication(seed: u32, grid: &mut Grid) -> Header {
        for (i, cell) in grid.occupancy.iter_mut().enumerate() {
            *cell = ((i as u32).wrapping_mul(seed | 1) % 102) as i8 - 1;
        }
        grid.reason.fill((seed % 5) as u8);
        grid.age.fill((seed % 256) as u8);
        Header {
            sequence: u64::from(seed),
            capture: Micros(u64::from(seed) * 7),
            publish: Micros(u64::from(seed) * 7 + 90_000),
            deadline: Micros(u64::from(seed) * 7 + 500_000),
            budget_micros: 500_000,
            used_micros: 88_000,
            level: QualityLevel::from_wire((seed % 6) as u8).unwrap(),
            faults: Faults(seed),
            blame: Blame::from_wire((seed % 10) as u8).unwrap(),
            scale: ScaleState::Wheels,
            tracking: TrackingState::Standstill,
            position_m: [1.0, -2.0, f64::from(seed)],
            free_m: core::array::from_fn(|i| i as f32 + 0.5),
            ..Header::default()
        }
    }

    proptest! {
        #[test]
        fn decoding_inverts_encoding(seed: u32, rows in 1usize..20, columns in 1usize..20) {
            let mut grid = Grid::new(rows, columns, 0.2);
            let header = publication(seed, &mut grid);
            let mut bytes = vec![0; FreeSpaceMessage::encoded_len(rows * columns)];
            let length = Publication { header, grid: &grid }.encode_into(&mut bytes).unwrap();
            let back = FreeSpaceMessage::decode(&bytes[..length]).unwrap();
            prop_assert_eq!(back.header, header);
            prop_assert_eq!((back.rows, back.columns, back.cell_m), (rows, columns, 0.2));
            let occupancy: Vec<i8> = (0..rows * columns).map(|cell| back.occupancy(cell)).collect();
            prop_assert_eq!(&occupancy[..], &grid.occupancy[..]);
            prop_assert_eq!(back.reason, &grid.reason[..]);
            prop_assert_eq!(back.age, &grid.age[..]);
        }

        #[test]
        fn one_flipped_bit_is_noticed(place in 0usize..3000, bit in 0u32..8) {
            let mut grid = Grid::new(9, 9, 0.2);
            let header = publication(77, &mut grid);
            let mut bytes = vec![0; FreeSpaceMessage::encoded_len(81)];
            let length = Publication { header, grid: &grid }.encode_into(&mut bytes).unwrap();
            bytes[place % length] ^= 1 << bit;
            prop_assert!(FreeSpaceMessage::decode(&bytes[..length]).is_err());
        }

        #[test]
        fn garbage_and_cut_messages_are_refused(mut bytes in prop::collection::vec(any::<u8>(), 0..600), cut in 0usize..300) {
            prop_assert!(FreeSpaceMessage::decode(&bytes).is_err());
            if bytes.len() >= 4 {
                bytes[..4].copy_from_slice(&MAGIC.to_le_bytes());
                prop_assert!(FreeSpaceMessage::decode(&bytes).is_err());
            }
            let mut grid = Grid::new(2, 2, 0.2);
            let header = publication(3, &mut grid);
            let mut whole = vec![0; FreeSpaceMessage::encoded_len(4)];
            Publication { header, grid: &grid }.encode_into(&mut whole).unwrap();
            prop_assert!(FreeSpaceMessage::decode(&whole[..cut]).is_err());
        }
    }

    #[test]
    fn small_buffer_is_an_error() {
        let grid = Grid::new(2, 2, 0.2);
        let header = Header::default();
        let written = Publication { header, grid: &grid }.encode_into(&mut [0; 100]);
        assert_eq!(written, Err(EncodeError::BufferTooSmall));
    }
}
