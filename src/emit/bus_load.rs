//! What frames cost a bus: their bits, the time they take, and the share of the bus that the module's publications are.
//!
//! In: lengths of frames, [`BitRates`]. Out: bits, nanoseconds, [`BusLoad`]. Invariant: never less than what the wire takes:
//! worst-case stuffing and the space between frames are included. Cost: constant.
//! Source: classic frames by Davis, Burns, Bril and Lukkien (2007), equation 1; CAN FD by the frame layout of ISO 11898-1:2015.

use super::can::{CanFrame, FRAMES};

/// Bit rates of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitRates {
    /// Of classic frames, and of the arbitration of CAN FD, bits a second.
    pub nominal: u32,
    /// Of the data of CAN FD, bits a second.
    pub data: u32,
}

impl BitRates {
    /// Longest time of a frame on the bus.
    #[must_use]
    pub fn frame_nanos(&self, frame: &CanFrame) -> u64 {
        self.nanos(frame.data.len(), frame.extended, frame.is_fd())
    }

    /// Longest time of a frame of `bytes` on the bus; CAN FD with the switch of its bit rate.
    #[must_use]
    pub const fn nanos(&self, bytes: usize, extended: bool, is_fd: bool) -> u64 {
        if is_fd {
            let bits = fd_frame_bits(bytes as u64, extended);
            span(bits.nominal, self.nominal) + span(bits.data, self.data)
        } else {
            span(frame_bits(bytes as u64, extended), self.nominal)
        }
    }
}

const fn span(bits: u64, rate: u32) -> u64 {
    if rate == 0 {
        return 0;
    }
    (bits * 1_000_000_000).div_ceil(rate as u64)
}

/// What a set of frames costs a bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BusLoad {
    /// Frames a second.
    pub frames_per_second: f64,
    /// Bits a second, worst-case bit stuffing and the space between frames included.
    pub bits_per_second: f64,
    /// Share of the bus's time.
    pub share: f64,
}

impl BusLoad {
    /// The load of `hertz` publications a second: the classic frames, and the grid in `grid_frames` full CAN FD frames.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "bits of a few thousand frames")]
    pub fn of_publications(hertz: f64, rates: BitRates, grid_frames: usize) -> Self {
        let grid = fd_frame_bits(64, false);
        let bits = FRAMES as u64 * frame_bits(8, false) + grid_frames as u64 * (grid.nominal + grid.data);
        let nanos =
            FRAMES as u64 * rates.nanos(8, false, false) + grid_frames as u64 * rates.nanos(64, false, true);
        Self {
            frames_per_second: hertz * (FRAMES + grid_frames) as f64,
            bits_per_second: hertz * bits as f64,
            share: hertz * nanos as f64 * 1e-9,
        }
    }
}

/// Longest time of a classic frame on the bus in bits.
#[must_use]
pub const fn frame_bits(bytes: u64, extended: bool) -> u64 {
    let stuffable = if extended { 54 } else { 34 } + 8 * bytes;
    stuffable + 13 + (stuffable - 1) / 4
}

/// Bits of a CAN FD frame by the rate that they are sent at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FdFrameBits {
    /// At the nominal rate: start to bit-rate switch, acknowledgement to the space between frames.
    pub nominal: u64,
    /// At the data rate: length code to the check sum's end.
    pub data: u64,
}

/// Longest CAN FD frame of `bytes` with a switch of the bit rate.
#[must_use]
pub const fn fd_frame_bits(bytes: u64, extended: bool) -> FdFrameBits {
    // SOF, identifier, RRS, IDE, FDF, res, BRS; extended: SRR and 18 more identifier bits.
    let head = if extended { 36 } else { 17 };
    // ESI, DLC, data: stuffed as they come, and the stuff bit may follow the last of the head.
    let body = 5 + 8 * bytes;
    // Stuff count of 4 bits and CRC, a fixed stuff bit before them and after each four of their bits; the delimiter.
    let sum = if bytes > 16 { 4 + 21 + 7 } else { 4 + 17 + 6 } + 1;
    // ACK, its delimiter, end of frame, space.
    let tail = 12;
    FdFrameBits {
        nominal: head + (head - 1) / 4 + tail,
        data: body + body.div_ceil(4) + sum,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATES: BitRates = BitRates {
        nominal: 500_000,
        data: 2_000_000,
    };

    #[test]
    fn load_of_the_published_frames() {
        assert_eq!(frame_bits(8, false), 135);
        assert_eq!(frame_bits(8, true), 160);
        let load = BusLoad::of_publications(2.0, RATES, 0);
        assert!((load.bits_per_second - 3240.0).abs() < 1e-9 && load.share < 0.01);
        assert!((load.share - 3240.0 / 500_000.0).abs() < 1e-9);
    }

    #[test]
    fn a_full_fd_frame_takes_less_than_half_a_millisecond() {
        let bits = fd_frame_bits(64, false);
        assert_eq!((bits.nominal, bits.data), (33, 680));
        assert_eq!(RATES.nanos(64, false, true), 66_000 + 340_000);
        assert!(fd_frame_bits(8, true).nominal > bits.nominal);
        // 208 frames: 200 by 120 cells.
        let load = BusLoad::of_publications(2.0, RATES, 208);
        assert!((0.16..0.19).contains(&load.share), "{load:?}");
        assert!((load.frames_per_second - 440.0).abs() < 1e-9);
    }
}
