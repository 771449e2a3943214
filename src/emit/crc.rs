//! Check sums: CRC-32 for the message, CRC-8 for classic CAN frames, CRC-16 for those of CAN FD.
//!
//! In: bytes. Out: the sum. Cost: one table look-up a byte.
//! Source: CRC-32/ISO-HDLC (zlib, Ethernet); CRC-8/SAE-J1850 polynomial 0x1D with start and final value 0, as AUTOSAR's
//! E2E profile 11 computes it; CRC-16/IBM-3740 (polynomial 0x1021, start 0xFFFF), as its profile 5 does.

const TABLE_32: [u32; 256] = table_32();
const TABLE_8: [u8; 256] = table_8();
const TABLE_16: [u16; 256] = table_16();

#[expect(clippy::cast_possible_truncation, reason = "a table index is below 256")]
const fn table_32() -> [u32; 256] {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut value = index as u32;
        let mut bit = 0;
        while bit < 8 {
            value = if value & 1 == 1 {
                (value >> 1) ^ 0xEDB8_8320
            } else {
                value >> 1
            };
            bit += 1;
        }
        table[index] = value;
        index += 1;
    }
    table
}

#[expect(clippy::cast_possible_truncation, reason = "a table index is below 256")]
const fn table_8() -> [u8; 256] {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut value = index as u8;
        let mut bit = 0;
        while bit < 8 {
            value = if value & 0x80 != 0 {
                (value << 1) ^ 0x1D
            } else {
                value << 1
            };
            bit += 1;
        }
        table[index] = value;
        index += 1;
    }
    table
}

#[expect(clippy::cast_possible_truncation, reason = "a table index is below 256")]
const fn table_16() -> [u16; 256] {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut value = (index as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            value = if value & 0x8000 != 0 {
                (value << 1) ^ 0x1021
            } else {
                value << 1
            };
            bit += 1;
        }
        table[index] = value;
        index += 1;
    }
    table
}

/// CRC-16 of `bytes` continued from `start`, 0xFFFF for the first.
#[must_use]
pub fn crc16(start: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(start, |crc, &byte| {
        (crc << 8) ^ TABLE_16[usize::from((crc >> 8) as u8 ^ byte)]
    })
}

/// CRC-32 of `bytes`.
pub(super) fn crc32(bytes: &[u8]) -> u32 {
    !crc32_step(u32::MAX, bytes)
}

/// CRC-32 of `bytes` continued from `start`, all ones for the first; its complement is the sum.
pub(super) fn crc32_step(start: u32, bytes: &[u8]) -> u32 {
    bytes.iter().fold(start, |crc, &byte| {
        (crc >> 8) ^ TABLE_32[((crc ^ u32::from(byte)) & 0xFF) as usize]
    })
}

/// CRC-8 of `bytes` continued from `start`.
#[must_use]
pub fn crc8(start: u8, bytes: &[u8]) -> u8 {
    bytes
        .iter()
        .fold(start, |crc, &byte| TABLE_8[usize::from(crc ^ byte)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_values_of_the_catalogue() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
        // CRC-8/SAE-J1850-ZERO would be 0x37 for start 0; with start and final 0xFF it is 0x4B.
        assert_eq!(crc8(0xFF, b"123456789") ^ 0xFF, 0x4B);
        assert_eq!(crc8(0, b"123456789"), 0x37);
        assert_eq!(crc16(0xFFFF, b"123456789"), 0x29B1);
    }
}
