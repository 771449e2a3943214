//! Puts a grid together from its frames, or says why not.

use alloc::boxed::Box;
use alloc::vec;

use super::{
    CELLS_AT, CELLS_PER_FRAME, FRAME_BYTES, GRID_CELLS_ID, GRID_HEAD_ID, check, frames_of, occupancy_of,
};
use crate::budget::MAX_CELLS;
use crate::emit::CanFrame;
use crate::emit::crc::crc32_step;
use crate::health::QualityLevel;
use crate::space::Micros;

/// Why a grid is given up, or a frame is not taken; counted by whoever reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridRefusal {
    /// Length, data id or CRC of a frame are wrong.
    Damaged,
    /// A frame is missing: its successor, or the next head, came in its place.
    Missing,
    /// A frame of another publication.
    Mixed,
    /// The head contradicts itself, or the grid is larger than the reader's.
    WrongSize,
}

/// What a frame did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridStep {
    /// It is no frame of the grid, or came before the first head.
    Ignored,
    /// It was taken; more are needed.
    Taken,
    /// It was the last: [`GridReader::grid`] has it.
    Complete,
}

/// A complete grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceivedGrid<'a> {
    /// Low 32 bits of the publication's number.
    pub sequence: u32,
    /// Capture stamp on the sender's clock.
    pub capture: Micros,
    /// Quality of the grid.
    pub level: QualityLevel,
    /// Grid rows.
    pub rows: usize,
    /// Grid columns.
    pub columns: usize,
    /// Edge of a cell in millimetres.
    pub cell_mm: u16,
    /// -1 unknown, 0 free to 100 occupied, row-major.
    pub occupancy: &'a [i8],
}

/// What the head of the grid that is being read says.
#[derive(Clone, Copy, Debug)]
struct Head {
    sequence: u32,
    capture: Micros,
    level: QualityLevel,
    rows: usize,
    columns: usize,
    cell_mm: u16,
    frames: u16,
    sum: u32,
}

/// Reads grids of up to the cells it was made for.
#[derive(Clone, Debug)]
pub struct GridReader {
    occupancy: Box<[i8]>,
    head: Option<Head>,
    /// Index and counter of the next frame.
    next: u16,
    counter: Option<u8>,
    sum: u32,
    is_complete: bool,
}

impl GridReader {
    /// Allocates for grids of up to `cells` cells.
    #[must_use]
    pub fn new(cells: usize) -> Self {
        Self {
            occupancy: vec![-1; cells.min(MAX_CELLS)].into_boxed_slice(),
            head: None,
            next: 0,
            counter: None,
            sum: u32::MAX,
            is_complete: false,
        }
    }

    /// Takes a frame.
    ///
    /// # Errors
    /// See [`GridRefusal`]: the grid under way is given up, and the next head begins a new one.
    pub fn take(&mut self, frame: &CanFrame) -> Result<GridStep, GridRefusal> {
        if frame.extended || !matches!(frame.id, GRID_HEAD_ID | GRID_CELLS_ID) {
            return Ok(GridStep::Ignored);
        }
        let bytes: &[u8; FRAME_BYTES] = match frame.data.as_slice().try_into() {
            Ok(bytes) if check(frame).is_some() => bytes,
            _ => return Err(self.give_up(GridRefusal::Damaged)),
        };
        if frame.id == GRID_HEAD_ID {
            self.begin(bytes)
        } else {
            self.cells(bytes)
        }
    }

    /// The grid, once it is complete and until the next head comes.
    #[must_use]
    pub fn grid(&self) -> Option<ReceivedGrid<'_>> {
        let head = self.head.filter(|_| self.is_complete)?;
        Some(ReceivedGrid {
            sequence: head.sequence,
            capture: head.capture,
            level: head.level,
            rows: head.rows,
            columns: head.columns,
            cell_mm: head.cell_mm,
            occupancy: self.occupancy.get(..head.rows * head.columns)?,
        })
    }

    fn give_up(&mut self, why: GridRefusal) -> GridRefusal {
        self.head = None;
        self.is_complete = false;
        why
    }

    fn begin(&mut self, bytes: &[u8; FRAME_BYTES]) -> Result<GridStep, GridRefusal> {
        let is_cut_short = self.head.is_some() && !self.is_complete;
        let head = Head::read(bytes).filter(|head| head.rows * head.columns <= self.occupancy.len());
        self.head = head;
        self.next = 0;
        self.sum = u32::MAX;
        self.is_complete = false;
        match head {
            None => Err(self.give_up(GridRefusal::WrongSize)),
            // The new grid is under way all the same.
            Some(_) if is_cut_short => Err(GridRefusal::Missing),
            Some(_) => Ok(GridStep::Taken),
        }
    }

    fn cells(&mut self, bytes: &[u8; FRAME_BYTES]) -> Result<GridStep, GridRefusal> {
        let Some(head) = self.head.filter(|_| !self.is_complete) else {
            return Ok(GridStep::Ignored);
        };
        if bytes[3] != head.sequence.to_le_bytes()[0] {
            return Err(self.give_up(GridRefusal::Mixed));
        }
        let index = u16::from_le_bytes([bytes[4], bytes[5]]);
        let is_next = self.next == 0 || self.counter == Some(bytes[2].wrapping_sub(1));
        if index != self.next || !is_next || index >= head.frames {
            return Err(self.give_up(GridRefusal::Missing));
        }
        let first = usize::from(index) * CELLS_PER_FRAME;
        let cells = (first..head.rows * head.columns).zip(self.occupancy.iter_mut().skip(first));
        let halves = bytes[CELLS_AT..].iter().flat_map(|byte| [byte & 0xF, byte >> 4]);
        for ((_, cell), raw) in cells.zip(halves) {
            *cell = occupancy_of(raw);
        }
        self.sum = crc32_step(self.sum, &bytes[CELLS_AT..]);
        self.counter = Some(bytes[2]);
        self.next += 1;
        if self.next < head.frames {
            return Ok(GridStep::Taken);
        }
        if !self.sum != head.sum {
            return Err(self.give_up(GridRefusal::Mixed));
        }
        self.is_complete = true;
        Ok(GridStep::Complete)
    }
}

impl Head {
    fn read(bytes: &[u8; FRAME_BYTES]) -> Option<Self> {
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let u32_at = |at: usize| u32::from(u16_at(at)) | u32::from(u16_at(at + 2)) << 16;
        let (rows, columns) = (usize::from(u16_at(16)), usize::from(u16_at(18)));
        let head = Self {
            sequence: u32_at(4),
            capture: Micros(u64::from(u32_at(8)) | u64::from(u32_at(12)) << 32),
            level: QualityLevel::from_wire(bytes[3])?,
            rows,
            columns,
            cell_mm: u16_at(20),
            frames: u16_at(22),
            sum: u32_at(24),
        };
        let is_consistent = rows * columns > 0 && usize::from(head.frames) + 1 == frames_of(rows * columns);
        is_consistent.then_some(head)
    }
}
