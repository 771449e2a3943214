//! The free-space message as it lies in shared memory: one fixed `#[repr(C)]` struct for writer and readers.
//!
//! In: a [`FreeSpaceMessage`] and the time it is handed over. Out: [`SharedMessage`], in place. The table below is the layout,
//! to the byte: struct, C header, Python class and compile-time checks are all made from it. Invariant: no padding; every bit
//! pattern is a value, so that a reader needs no trust in the writer; cells beyond `rows * columns` are unknown, never free;
//! numbers keep their meaning, and a change of the layout is a new [`SHARED_VERSION`]. The first 300 bytes are those of the
//! wire format but for `header_bytes` and `total_bytes`. Integers and floats are the machine's own: readers run on it.
//! No check sum: a message is handed over when it is complete, and is read-only from then on. Cost: one copy of the header and
//! of the used cells; a slot's first use also marks its other cells unknown. A grid always fits: it has at most [`MAX_CELLS`].

use core::mem::{offset_of, size_of};

use super::message::{FreeSpaceMessage, MAGIC};
use crate::budget::{MAX_CELLS, SECTORS};
use crate::health::{Blame, QualityLevel};
use crate::space::Micros;

/// Layout version of [`SharedMessage`].
pub const SHARED_VERSION: u16 = 1;

/// Type of a field's elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element {
    /// `int8_t`
    I8,
    /// `uint8_t`
    U8,
    /// `uint16_t`
    U16,
    /// `uint32_t`
    U32,
    /// `uint64_t`
    U64,
    /// `float`
    F32,
    /// `double`
    F64,
}

/// One field of [`SharedMessage`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Type of its elements.
    pub element: Element,
    /// Number of its elements; none where it is no array.
    pub count: Option<usize>,
    /// Bytes from the start of the message.
    pub offset: usize,
    /// What it says.
    pub doc: &'static str,
}

/// A type that a field may have.
trait FieldType {
    const ELEMENT: Element;
    const COUNT: Option<usize> = None;
}

macro_rules! elements {
    ($($type:ty => $element:ident),*) => {$(
        impl FieldType for $type {
            const ELEMENT: Element = Element::$element;
        }
    )*};
}
elements!(i8 => I8, u8 => U8, u16 => U16, u32 => U32, u64 => U64, f32 => F32, f64 => F64);

impl<T: FieldType, const N: usize> FieldType for [T; N] {
    const ELEMENT: Element = T::ELEMENT;
    const COUNT: Option<usize> = Some(N);
}

macro_rules! layout {
    ($($offset:literal $name:ident: $type:ty, $doc:literal;)*) => {
        /// The message in shared memory; see the module for its rules and [`FIELDS`] for its offsets.
        #[derive(Clone, Debug, PartialEq)]
        #[repr(C)]
        pub struct SharedMessage {
            $(#[doc = $doc] pub $name: $type,)*
        }

        /// The layout, in the order of the offsets.
        pub const FIELDS: &[Field] = &[$(Field {
            name: stringify!($name),
            element: <$type as FieldType>::ELEMENT,
            count: <$type as FieldType>::COUNT,
            offset: $offset,
            doc: $doc,
        }),*];

        const _: () = {
            $(assert!(offset_of!(SharedMessage, $name) == $offset, stringify!($name));)*
            let sum = 0 $(+ size_of::<$type>())*;
            assert!(size_of::<SharedMessage>() == sum, "there is padding");
        };
    };
}

layout! {
    0 magic: u32, "`FREE`, 0x45455246.";
    4 version: u16, "Layout version, 1; a reader refuses others.";
    6 header_bytes: u16, "Bytes before the cells: the offset of `occupancy`.";
    8 total_bytes: u32, "Size of the message.";
    12 faults: u32, "Faults, one bit each.";
    16 sequence: u64, "Counts the module's messages, from 0 at its start; a gap is a message that this reader missed.";
    24 capture_micros: u64, "Capture stamp of the key frame, microseconds; CLOCK_MONOTONIC for a live camera.";
    32 publish_micros: u64, "When the message was published, on the same clock.";
    40 deadline_micros: u64, "When it had to be, on the same clock.";
    48 budget_micros: u32, "Time from capture to deadline.";
    52 used_micros: u32, "Time from capture to publication.";
    56 level: u8, "Quality: 0 full, 1 no refinement, 2 no fresh network, 3 no fresh map, 4 moved, 5 invalid: do not use.";
    57 scale: u8, "Source of the metric scale: 0 unknown, 1 wheels, 2 camera height, 3 held.";
    58 tracking: u8, "Source of the pose: 0 dead reckoning, 1 good, 2 standstill, 3 weak.";
    59 blame: u8, "What held the answer back: 0 nothing, 1 frame, 2 track, 3 map, 4 priors, 5 segmentation, 6 crf, 7 grid, 8 emit, 9 camera.";
    60 plane_inliers: u32, "Landmarks on the road plane; 0 where the plane was held.";
    64 position_m: [f64; 3], "Vehicle origin in the world, metres.";
    88 orientation: [f64; 4], "Vehicle orientation in the world, quaternion x y z w.";
    120 speed_mps: f32, "Speed along the vehicle's x axis, m/s.";
    124 yaw_rate_radps: f32, "Yaw rate, rad/s, positive left.";
    128 plane_normal: [f32; 3], "Unit normal of the road plane in camera space.";
    140 plane_offset_m: f32, "Height of the camera over the road plane, metres.";
    144 plane_sigma_m: f32, "Robust spread of the landmarks about the plane, metres.";
    148 rows: u32, "Rows of the grid; row 0 is nearest, rows go ahead.";
    152 columns: u32, "Columns of the grid; column 0 is the right edge, columns go left.";
    156 cell_m: f32, "Edge of a cell, metres.";
    160 sector_first_rad: f32, "Bearing of the right edge of sector 0, radians, positive left.";
    164 sector_rad: f32, "Width of a sector, radians.";
    168 sectors: u32, "Sectors of the boundary.";
    172 free_m: [f32; SECTORS], "Free distance in each sector from the vehicle's origin, metres; what is unknown is not free.";
    300 origin_x_m: f32, "Corner of the grid (near, right) in the vehicle: metres ahead of the rear axle.";
    304 origin_y_m: f32, "The same corner: metres left of the centre line.";
    308 reserved: u32, "0.";
    312 handed_over_micros: u64, "CLOCK_MONOTONIC when the publisher handed it over to be shared; with `used_micros` it gives the age on any clock.";
    320 occupancy: [i8; MAX_CELLS], "Row by row: -1 unknown, 0 free to 100 occupied; a car may drive on 0 to 35. Unknown is not free.";
    240_320 reason: [u8; MAX_CELLS], "Why each cell is so: 0 unseen, 1 plane, 2 box, 3 network, 4 previous key frame.";
    480_320 age: [u8; MAX_CELLS], "Time since each cell was last seen, 0.1 s; 255 is 25.5 s or more, or never.";
}

/// Size of a message in bytes.
pub const SHARED_BYTES: usize = size_of::<SharedMessage>();

/// Why a shared message cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SharedError {
    /// It is no free-space message, or another layout: build reader and module from the same version.
    WrongLayout,
    /// More cells than a message holds: a writer's bug, drop it.
    TooManyCells,
}

impl SharedMessage {
    /// A message with nothing in it, which no reader accepts.
    pub const EMPTY: Self = Self {
        magic: 0,
        version: 0,
        header_bytes: 0,
        total_bytes: 0,
        faults: 0,
        sequence: 0,
        capture_micros: 0,
        publish_micros: 0,
        deadline_micros: 0,
        budget_micros: 0,
        used_micros: 0,
        level: QualityLevel::Invalid as u8,
        scale: 0,
        tracking: 0,
        blame: 0,
        plane_inliers: 0,
        position_m: [0.0; 3],
        orientation: [0.0; 4],
        speed_mps: 0.0,
        yaw_rate_radps: 0.0,
        plane_normal: [0.0; 3],
        plane_offset_m: 0.0,
        plane_sigma_m: 0.0,
        rows: 0,
        columns: 0,
        cell_m: 0.0,
        sector_first_rad: 0.0,
        sector_rad: 0.0,
        sectors: 0,
        free_m: [0.0; SECTORS],
        origin_x_m: 0.0,
        origin_y_m: 0.0,
        reserved: 0,
        handed_over_micros: 0,
        occupancy: [-1; MAX_CELLS],
        reason: [0; MAX_CELLS],
        age: [u8::MAX; MAX_CELLS],
    };

    /// Becomes `message`, whatever it was before; `handed_over` is `CLOCK_MONOTONIC`.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "sizes of a message and of a grid"
    )]
    pub fn fill(&mut self, message: &FreeSpaceMessage<'_>, handed_over: Micros) {
        self.fill_cells(message);
        self.magic = MAGIC;
        self.version = SHARED_VERSION;
        self.header_bytes = offset_of!(Self, occupancy) as u16;
        self.total_bytes = SHARED_BYTES as u32;
        self.fill_header(message);
        self.rows = message.rows as u32;
        self.columns = message.columns as u32;
        self.cell_m = message.cell_m;
        self.origin_x_m = 0.0;
        self.origin_y_m = -0.5 * message.columns as f32 * message.cell_m;
        self.reserved = 0;
        self.handed_over_micros = handed_over.0;
    }

    #[expect(clippy::cast_possible_truncation, reason = "there are 32 sectors")]
    const fn fill_header(&mut self, message: &FreeSpaceMessage<'_>) {
        let header = &message.header;
        self.faults = header.faults.0;
        self.sequence = header.sequence;
        self.capture_micros = header.capture.0;
        self.publish_micros = header.publish.0;
        self.deadline_micros = header.deadline.0;
        self.budget_micros = header.budget_micros;
        self.used_micros = header.used_micros;
        self.level = header.level as u8;
        self.scale = header.scale as u8;
        self.tracking = header.tracking as u8;
        self.blame = Blame::to_wire(header.blame);
        self.plane_inliers = header.plane_inliers;
        self.position_m = header.position_m;
        self.orientation = header.orientation;
        self.speed_mps = header.speed_mps;
        self.yaw_rate_radps = header.yaw_rate_radps;
        self.plane_normal = header.plane_normal;
        self.plane_offset_m = header.plane_offset_m;
        self.plane_sigma_m = header.plane_sigma_m;
        self.sector_first_rad = header.sector_first_rad;
        self.sector_rad = header.sector_rad;
        self.sectors = SECTORS as u32;
        self.free_m = header.free_m;
    }

    /// The cells; those that an earlier and larger grid left, and all others of a slot never used, become unknown.
    fn fill_cells(&mut self, message: &FreeSpaceMessage<'_>) {
        let used = message.reason.len().min(MAX_CELLS);
        let stale = if self.check().is_ok() {
            self.cells()
        } else {
            MAX_CELLS
        };
        for (cell, bits) in self.occupancy[..used].iter_mut().zip(message.occupancy) {
            *cell = bits.cast_signed();
        }
        self.reason[..used].copy_from_slice(&message.reason[..used]);
        self.age[..used].copy_from_slice(&message.age[..used]);
        if used < stale {
            self.occupancy[used..stale].fill(-1);
            self.reason[used..stale].fill(0);
            self.age[used..stale].fill(u8::MAX);
        }
    }

    /// Whether this is a message of this layout.
    ///
    /// # Errors
    /// See [`SharedError`].
    pub const fn check(&self) -> Result<(), SharedError> {
        let is_ours = self.magic == MAGIC
            && self.version == SHARED_VERSION
            && self.header_bytes as usize == offset_of!(Self, occupancy)
            && self.total_bytes as usize == SHARED_BYTES
            && self.sectors as usize == SECTORS;
        if !is_ours {
            return Err(SharedError::WrongLayout);
        }
        if self.rows as u64 * self.columns as u64 > MAX_CELLS as u64 {
            return Err(SharedError::TooManyCells);
        }
        Ok(())
    }

    /// Cells of the grid.
    #[must_use]
    pub fn cells(&self) -> usize {
        (self.rows as usize)
            .saturating_mul(self.columns as usize)
            .min(MAX_CELLS)
    }

    /// Occupancy of a cell; -1 (unknown) outside the grid.
    #[must_use]
    pub fn occupancy_at(&self, row: usize, column: usize) -> i8 {
        if row >= self.rows as usize || column >= self.columns as usize {
            return -1;
        }
        let cell = row.saturating_mul(self.columns as usize) + column;
        self.occupancy.get(cell).copied().unwrap_or(-1)
    }

    /// Whether the grid may be used at all.
    #[must_use]
    pub const fn is_usable(&self) -> bool {
        self.level < QualityLevel::Invalid as u8
    }

    /// Free distance straight ahead from the vehicle's origin, metres: the least of the sectors within `half_rad` of it.
    /// Zero where the grid is not to be used, or says nothing of one of them.
    #[must_use]
    pub fn free_ahead_m(&self, half_rad: f32) -> f32 {
        if !self.is_usable() || !(self.sector_rad > 0.0) {
            return 0.0;
        }
        let mut right_rad = self.sector_first_rad;
        let mut least_m = f32::INFINITY;
        for free_m in self.free_m {
            let left_rad = right_rad + self.sector_rad;
            if right_rad < half_rad && left_rad > -half_rad {
                // Not a number, or less than nothing: what is not known is not free.
                if !(free_m >= 0.0) {
                    return 0.0;
                }
                least_m = if free_m < least_m { free_m } else { least_m };
            }
            right_rad = left_rad;
        }
        if least_m.is_finite() { least_m } else { 0.0 }
    }

    /// Microseconds since the capture, at `now` on `CLOCK_MONOTONIC`; whatever clock the capture was stamped on.
    #[must_use]
    pub const fn age_micros(&self, now: Micros) -> u64 {
        now.since(Micros(self.handed_over_micros))
            .saturating_add(self.used_micros as u64)
    }
}

#[cfg(test)]
#[path = "shared/tests.rs"]
mod tests;
