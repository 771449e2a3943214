//! The occupancy grid in CAN FD frames of 64 bytes, each protected end to end: a head, then the cells.
//!
//! In: a [`FreeSpaceMessage`]. Out: [`CanFrame`]s, and from them the grid again ([`GridReader`]).
//! Invariant: a grid is complete, of one publication and undamaged, or it is not given out; unknown stays unknown, and what is
//! not surely free (0) never becomes free, for percents are rounded up. Cost: a frame for [`CELLS_PER_FRAME`] cells; no
//! allocation but the reader's one grid. Half a byte a cell halves the bus load: 0 free to 14 occupied, 15 unknown.
//! Source: AUTOSAR E2E profile 5: CRC-16 over bytes 2 to 63 and the implicit data id, then a counter of 8 bits, each
//! identifier its own. Longer headers (profiles 4, 6, 7) cost 6 to 27 % of such a frame and would repeat what ours has.
//!
//! | byte | head, [`GRID_HEAD_ID`]           | cells, [`GRID_CELLS_ID`]           |
//! |------|----------------------------------|------------------------------------|
//! | 0, 1 | CRC                              | CRC                                |
//! | 2    | counter                          | counter                            |
//! | 3    | quality level                    | sequence, low byte                 |
//! | 4    | `u32` sequence                   | `u16` index of the frame, from 0   |
//! | 6    |                                  | cells, two a byte, low half first  |
//! | 8    | `u64` capture stamp, us          |                                    |
//! | 16   | `u16` rows, `u16` columns        |                                    |
//! | 20   | `u16` cell edge, mm              |                                    |
//! | 22   | `u16` frames of cells            |                                    |
//! | 24   | `u32` CRC-32 of all their cells  |                                    |
//! | 28   | zero                             |                                    |

mod reader;

pub use reader::{GridReader, GridRefusal, GridStep, ReceivedGrid};

use super::FreeSpaceMessage;
use super::can::CanFrame;
use super::crc::{crc16, crc32_step};

/// Identifier of the frame that says what grid comes; see `config/freespace.dbc`.
pub const GRID_HEAD_ID: u32 = 0x620;
/// Identifier of the frames that carry the cells.
pub const GRID_CELLS_ID: u32 = 0x621;
/// Bytes of each frame.
pub const FRAME_BYTES: usize = 64;
/// Bytes of a frame before its cells.
const CELLS_AT: usize = 6;
/// Cells in a frame.
pub const CELLS_PER_FRAME: usize = 2 * (FRAME_BYTES - CELLS_AT);
/// Raw value of an unknown cell.
const UNKNOWN: u8 = 15;
/// Raw value of a surely occupied cell.
const OCCUPIED: u8 = 14;
/// E2E data id of a frame: its identifier, moved out of the way of other users of the same bus.
const DATA_ID_BASE: u16 = 0x4600;

/// Frames that a grid of `cells` takes, its head included.
#[must_use]
pub const fn frames_of(cells: usize) -> usize {
    1 + cells.div_ceil(CELLS_PER_FRAME)
}

/// Encodes grids; keeps the E2E counters.
#[derive(Clone, Debug, Default)]
pub struct GridEncoder {
    head_counter: u8,
    cells_counter: u8,
}

impl GridEncoder {
    /// Hands over the frames of a grid, in the order to send them.
    pub fn encode(&mut self, message: &FreeSpaceMessage<'_>, take: &mut dyn FnMut(&CanFrame)) {
        let cells = message.rows * message.columns;
        take(&self.head(message, cells));
        for index in 0..frames_of(cells) - 1 {
            let mut bytes = [0; FRAME_BYTES];
            bytes[3] = message.header.sequence.to_le_bytes()[0];
            bytes[4..6].copy_from_slice(&low_u16(index));
            pack(message, index, cells, &mut bytes);
            take(&protect(GRID_CELLS_ID, bytes, &mut self.cells_counter));
        }
    }

    fn head(&mut self, message: &FreeSpaceMessage<'_>, cells: usize) -> CanFrame {
        let mut bytes = [0; FRAME_BYTES];
        bytes[3] = message.header.level as u8;
        bytes[4..8].copy_from_slice(&message.header.sequence.to_le_bytes()[..4]);
        bytes[8..16].copy_from_slice(&message.header.capture.0.to_le_bytes());
        bytes[16..18].copy_from_slice(&low_u16(message.rows));
        bytes[18..20].copy_from_slice(&low_u16(message.columns));
        bytes[20..22].copy_from_slice(&millimetres(message.cell_m).to_le_bytes());
        bytes[22..24].copy_from_slice(&low_u16(frames_of(cells) - 1));
        let mut sum = u32::MAX;
        for index in 0..frames_of(cells) - 1 {
            let mut packed = [0; FRAME_BYTES];
            pack(message, index, cells, &mut packed);
            sum = crc32_step(sum, &packed[CELLS_AT..]);
        }
        bytes[24..28].copy_from_slice(&(!sum).to_le_bytes());
        protect(GRID_HEAD_ID, bytes, &mut self.head_counter)
    }
}

/// A grid has at most `MAX_CELLS` cells, so that rows, columns and frames fit; a longer side would be refused by the reader.
fn low_u16(number: usize) -> [u8; 2] {
    u16::try_from(number).unwrap_or(u16::MAX).to_le_bytes()
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the type's range"
)]
fn millimetres(metres: f32) -> u16 {
    // Cells are positive: half a millimetre more rounds.
    (metres * 1e3 + 0.5).clamp(0.0, 65_535.0) as u16
}

/// Writes the cells of frame `index`; behind the last cell all is unknown.
fn pack(message: &FreeSpaceMessage<'_>, index: usize, cells: usize, bytes: &mut [u8; FRAME_BYTES]) {
    let first = index * CELLS_PER_FRAME;
    for (at, byte) in bytes[CELLS_AT..].iter_mut().enumerate() {
        let raw = |cell: usize| {
            if cell < cells {
                raw_of(message.occupancy(cell))
            } else {
                UNKNOWN
            }
        };
        *byte = raw(first + 2 * at) | raw(first + 2 * at + 1) << 4;
    }
}

/// Percent to half a byte, rounded up: only 0 is free.
fn raw_of(occupancy: i8) -> u8 {
    u8::try_from(occupancy).map_or(UNKNOWN, |percent| {
        let raw = (u16::from(percent) * u16::from(OCCUPIED)).div_ceil(100);
        raw.to_le_bytes()[0].min(OCCUPIED)
    })
}

/// Half a byte to percent.
fn occupancy_of(raw: u8) -> i8 {
    if raw > OCCUPIED {
        return -1;
    }
    let percent = (u16::from(raw) * 100 + u16::from(OCCUPIED) / 2) / u16::from(OCCUPIED);
    i8::try_from(percent).unwrap_or(100)
}

fn protect(id: u32, mut bytes: [u8; FRAME_BYTES], counter: &mut u8) -> CanFrame {
    bytes[2] = *counter;
    *counter = counter.wrapping_add(1);
    let sum = checksum(id, &bytes);
    bytes[..2].copy_from_slice(&sum.to_le_bytes());
    let mut frame = CanFrame {
        id,
        ..CanFrame::default()
    };
    // All of 64 bytes have room.
    let _ = frame.data.extend_from_slice(&bytes);
    frame
}

/// Checks a frame's identifier, length, data id and CRC; returns its counter.
#[must_use]
pub fn check(frame: &CanFrame) -> Option<u8> {
    let bytes: &[u8; FRAME_BYTES] = frame.data.as_slice().try_into().ok()?;
    let is_ours = matches!(frame.id, GRID_HEAD_ID | GRID_CELLS_ID) && !frame.extended;
    (is_ours && bytes[..2] == checksum(frame.id, bytes).to_le_bytes()).then_some(bytes[2])
}

/// CRC of profile 5: all bytes but the CRC itself, then the data id, low byte first.
fn checksum(id: u32, bytes: &[u8; FRAME_BYTES]) -> u16 {
    let [low, high, ..] = id.to_le_bytes();
    let data_id = DATA_ID_BASE.wrapping_add(u16::from_le_bytes([low, high]));
    crc16(crc16(0xFFFF, &bytes[2..]), &data_id.to_le_bytes())
}

#[cfg(test)]
mod tests;
