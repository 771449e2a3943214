//! The wheel message of `config/wheels_counters.dbc`: four counters of eight bits, an alive counter and a checksum.

use crate::fault::WheelFault;

/// Makes the frames in their order.
#[derive(Debug, Default)]
pub(crate) struct WheelFrame {
    counter: u8,
    /// State of the generator of garbage.
    random: u32,
}

impl WheelFrame {
    /// Identifier.
    pub(crate) const ID: u16 = 0x1A0;

    /// The next frame; none where the controller is silent.
    pub(crate) fn bytes(&mut self, counts: [u32; 4], fault: WheelFault) -> Option<[u8; 8]> {
        if fault != WheelFault::WrongCounter {
            self.counter = (self.counter + 1) % 16;
        }
        let mut bytes = [0; 8];
        bytes[1] = self.counter;
        for (byte, count) in bytes[2..6].iter_mut().zip(counts) {
            *byte = u8::try_from(count % 256).unwrap_or(0);
        }
        bytes[0] = crc8_j1850(&bytes[1..]);
        match fault {
            WheelFault::Silent => return None,
            WheelFault::Garbage => bytes = self.garbage(),
            WheelFault::WrongChecksum => bytes[0] ^= 0x5A,
            WheelFault::None | WheelFault::WrongCounter | WheelFault::StuckWheel => {}
        }
        Some(bytes)
    }

    /// A linear congruential generator (Numerical Recipes): the same garbage each time.
    fn garbage(&mut self) -> [u8; 8] {
        std::array::from_fn(|_| {
            self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            self.random.to_be_bytes()[0]
        })
    }
}

/// CRC-8 SAE J1850: polynomial 0x1D, initial value and final inversion 0xFF.
fn crc8_j1850(bytes: &[u8]) -> u8 {
    let step = |crc: u8, byte: &u8| {
        (0..8).fold(crc ^ byte, |crc, _| {
            let shifted = crc << 1;
            if crc & 0x80 == 0 { shifted } else { shifted ^ 0x1D }
        })
    };
    !bytes.iter().fold(0xFF, step)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// The check value of the catalogue of CRC algorithms for "123456789".
    #[test]
    fn the_checksum_is_that_of_sae_j1850() {
        assert_eq!(crc8_j1850(b"123456789"), 0x4B);
    }

    #[test]
    fn each_fault_changes_what_it_says() {
        let mut frames = WheelFrame::default();
        let good = frames.bytes([1, 2, 3, 256], WheelFault::None).unwrap();
        assert_eq!(good[1..6], [1, 1, 2, 3, 0]);
        let stuck = frames.bytes([1, 2, 3, 4], WheelFault::WrongCounter).unwrap();
        assert_eq!(stuck[1], good[1]);
        let wrong = frames.bytes([1, 2, 3, 4], WheelFault::WrongChecksum).unwrap();
        assert_ne!(wrong[0], crc8_j1850(&wrong[1..]));
        assert_eq!(frames.bytes([1, 2, 3, 4], WheelFault::Silent), None);
    }
}
