//! Whether a wheel message is whole and new: its check sum and its alive counter.
//!
//! In: the bytes of a frame. Out: nothing, or the [`DecodeFault`] that refuses the reading. Invariant: a frame whose sum is wrong
//! says nothing, its counter neither. A counter that stands still is old news; one that leaps over more than [`MOST_LOST`]
//! messages is another sender's, or a restart: that reading is refused, and the count goes on from it. A few lost messages are no
//! fault: wheel counts and speeds bridge them. Cost: one pass over the frame.
//! Source: CRC-8 by AUTOSAR's E2E profile 1 (variant 1A: both bytes of the data id, then the data but the CRC, start and final
//! value 0) and SAE J1850 (polynomial 0x1D, start and final value 0xFF); Toyota's sum as opendbc documents it.

use freespace::emit::crc::crc8;
use serde::Deserialize;

use super::DecodeFault;

/// Messages that may be lost in a row; 60 ms at 50 Hz.
pub const MOST_LOST: u64 = 3;

/// How a check sum is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChecksumAlgorithm {
    /// The identifier's bytes, the length and all other bytes added up.
    Toyota,
    /// All other bytes, exclusive or.
    Xor,
    /// CRC-8/SAE-J1850 of all other bytes.
    #[serde(rename = "crc8_sae_j1850")]
    Crc8SaeJ1850,
    /// AUTOSAR E2E profile 1, variant 1A, as profile 11A has it too.
    AutosarE2eP01,
}

/// The check sum of a message.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChecksumMapping {
    /// Its signal: one whole byte.
    pub signal: String,
    /// How it is computed.
    pub algorithm: ChecksumAlgorithm,
    /// The data id of `autosar_e2e_p01`.
    #[serde(default)]
    pub data_id: u16,
}

/// A check sum, where it lies and what it covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Checksum {
    pub(super) algorithm: ChecksumAlgorithm,
    pub(super) data_id: u16,
    /// Identifier of the message.
    pub(super) id: u32,
    /// Byte of the sum.
    pub(super) byte: usize,
    /// Bytes of the message; a CAN FD frame may be padded behind them.
    pub(super) length: usize,
}

impl Checksum {
    /// Whether the sum is right; `data` has [`Self::length`] bytes at least.
    pub(super) fn is_right(&self, data: &[u8]) -> bool {
        let Some((before, [sum, after @ ..])) = data
            .get(..self.length)
            .and_then(|data| data.split_at_checked(self.byte))
        else {
            return false;
        };
        *sum == self.of(before, after)
    }

    fn of(&self, before: &[u8], after: &[u8]) -> u8 {
        let all = before.iter().chain(after);
        let added = |start: u8| all.clone().fold(start, |sum, byte| sum.wrapping_add(*byte));
        match self.algorithm {
            ChecksumAlgorithm::Toyota => {
                let [length, ..] = self.length.to_le_bytes();
                added((self.id.to_le_bytes().iter()).fold(length, |sum, byte| sum.wrapping_add(*byte)))
            }
            ChecksumAlgorithm::Xor => all.fold(0, |sum, byte| sum ^ byte),
            ChecksumAlgorithm::Crc8SaeJ1850 => crc8(crc8(0xFF, before), after) ^ 0xFF,
            ChecksumAlgorithm::AutosarE2eP01 => {
                crc8(crc8(crc8(0, &self.data_id.to_le_bytes()), before), after)
            }
        }
    }
}

/// The alive counter of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AliveCounter {
    /// Values before it wraps.
    pub(super) modulus: u64,
    last: Option<u64>,
}

impl AliveCounter {
    pub(super) const fn new(modulus: u64) -> Self {
        Self { modulus, last: None }
    }

    /// Takes the next value.
    pub(super) fn check(&mut self, value: u64) -> Result<(), DecodeFault> {
        let Some(last) = self.last.replace(value) else {
            return Ok(());
        };
        if value >= self.modulus {
            return Err(DecodeFault::CounterJumped);
        }
        let steps = if value >= last {
            value - last
        } else {
            self.modulus.saturating_sub(last) + value
        };
        // A short counter must tell a loss from a repetition by its half at least.
        let most = (MOST_LOST + 1).min(self.modulus / 2).max(1);
        match steps {
            0 => Err(DecodeFault::CounterStuck),
            steps if steps > most => Err(DecodeFault::CounterJumped),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sum(algorithm: ChecksumAlgorithm, id: u32, byte: usize, length: usize) -> Checksum {
        Checksum {
            algorithm,
            data_id: 0x123,
            id,
            byte,
            length,
        }
    }

    #[test]
    fn sums_of_documented_frames_are_right() {
        // A steering message of a Toyota: 0x2E4, five bytes, the last the sum.
        let toyota = sum(ChecksumAlgorithm::Toyota, 0x2E4, 4, 5);
        assert!(toyota.is_right(&[0x80, 0, 0, 0, 0x6B]));
        // CRC-8/SAE-J1850 of "123456789" is 0x4B.
        let crc = sum(ChecksumAlgorithm::Crc8SaeJ1850, 0, 9, 10);
        assert!(crc.is_right(b"123456789\x4B"));
        // The example of the AUTOSAR specification: data id 0x123, zero bytes.
        let profile = sum(ChecksumAlgorithm::AutosarE2eP01, 0, 0, 8);
        assert!(profile.is_right(&[0xCC, 0, 0, 0, 0, 0, 0, 0]));
        let xor = sum(ChecksumAlgorithm::Xor, 0, 1, 4);
        assert!(xor.is_right(&[0x0F, 0x3C, 0x33, 0x00]));
        // A padded CAN FD frame.
        assert!(xor.is_right(&[0x0F, 0x3C, 0x33, 0x00, 0x55]));
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        use ChecksumAlgorithm::{AutosarE2eP01, Crc8SaeJ1850, Toyota, Xor};
        for algorithm in [Toyota, Xor, Crc8SaeJ1850, AutosarE2eP01] {
            let sum = sum(algorithm, 0xAA, 7, 8);
            let mut data = [0x1A, 0x6F, 0x1A, 0x6F, 0x1A, 0x6F, 0x1A, 0];
            data[7] = sum.of(&data[..7], &[]);
            assert!(sum.is_right(&data));
            for bit in 0..64 {
                let mut damaged = data;
                damaged[bit / 8] ^= 1 << (bit % 8);
                assert!(!sum.is_right(&damaged), "{algorithm:?} bit {bit}");
            }
            assert!(!sum.is_right(&data[..7]));
        }
    }

    #[test]
    fn a_counter_stands_leaps_wraps_and_goes_on() {
        let mut counter = AliveCounter::new(15);
        let mut seen = |value| counter.check(value);
        assert_eq!(seen(12), Ok(()));
        assert_eq!(seen(13), Ok(()));
        assert_eq!(seen(13), Err(DecodeFault::CounterStuck));
        assert_eq!(seen(13), Err(DecodeFault::CounterStuck));
        assert_eq!(seen(0), Ok(()), "one lost, over the wrap");
        assert_eq!(seen(4), Ok(()), "three lost");
        assert_eq!(seen(9), Err(DecodeFault::CounterJumped));
        assert_eq!(seen(10), Ok(()), "goes on from where it leapt to");
        assert_eq!(seen(9), Err(DecodeFault::CounterJumped), "backwards");
        assert_eq!(seen(15), Err(DecodeFault::CounterJumped), "no value of it");
        let mut bit = AliveCounter::new(2);
        assert_eq!([bit.check(0), bit.check(1), bit.check(0)], [Ok(()); 3]);
        assert_eq!(bit.check(0), Err(DecodeFault::CounterStuck));
    }
}
