//! One signal of a DBC message: where its bits lie, and what they mean.
//!
//! In: the bytes of a frame. Out: the raw bits, or the physical value. Invariant: whoever reads has checked the length by
//! [`Field::bytes_needed`]. Cost: one step a bit.

use can_dbc::{ByteOrder, NumericValue, Signal, ValueType};

/// Where a signal lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Field {
    pub(super) start: usize,
    pub(super) size: usize,
    pub(super) big_endian: bool,
    pub(super) signed: bool,
    pub(super) factor: f64,
    offset: f64,
    /// Largest magnitude, in the signal's unit.
    pub(super) limit: f64,
}

impl Field {
    /// The place of a signal; nothing where its bits are none.
    pub(crate) fn of(signal: &Signal) -> Option<Self> {
        let size = usize::try_from(signal.size).ok()?;
        let start = usize::try_from(signal.start_bit).ok()?;
        if !(1..=64).contains(&size) || start >= 512 {
            return None;
        }
        let limit = number(&signal.min).abs().max(number(&signal.max).abs());
        Some(Self {
            start,
            size,
            big_endian: signal.byte_order == ByteOrder::BigEndian,
            signed: signal.value_type == ValueType::Signed,
            factor: signal.factor,
            offset: signal.offset,
            // A range of [0|0] states none.
            limit: if limit > 0.0 { limit } else { f64::INFINITY },
        })
    }

    /// Bytes from the frame's start to the signal's last one.
    pub(crate) fn bytes_needed(&self) -> usize {
        let last = if self.big_endian {
            // The start is the most significant bit; from bit 0 of a byte the signal goes on at bit 7 of the next.
            (self.start / 8) * 8 + (7 - self.start % 8) + self.size - 1
        } else {
            self.start + self.size - 1
        };
        last / 8 + 1
    }

    /// The signal's bits; the caller has checked the length.
    pub(crate) fn raw(&self, data: &[u8]) -> u64 {
        let bit = |at: usize| u64::from(data[at / 8] >> (at % 8) & 1);
        let mut value = 0;
        if self.big_endian {
            let first = (self.start / 8) * 8 + (7 - self.start % 8);
            for at in first..first + self.size {
                value = value << 1 | bit(at / 8 * 8 + (7 - at % 8));
            }
        } else {
            for at in (self.start..self.start + self.size).rev() {
                value = value << 1 | bit(at);
            }
        }
        value
    }

    #[expect(
        clippy::cast_precision_loss,
        reason = "speed signals have far fewer than 52 bits"
    )]
    pub(crate) fn physical(&self, data: &[u8]) -> f64 {
        let raw = self.raw(data);
        let value = if self.signed {
            let unused = 64 - self.size;
            ((raw << unused).cast_signed() >> unused) as f64
        } else {
            raw as f64
        };
        value * self.factor + self.offset
    }
}

#[expect(clippy::cast_precision_loss, reason = "a range is stated in a few digits")]
fn number(value: &NumericValue) -> f64 {
    match *value {
        NumericValue::Uint(value) => value as f64,
        NumericValue::Int(value) => value as f64,
        NumericValue::Double(value) => value,
    }
}
