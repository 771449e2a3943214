//! One line of a log of can-utils' `candump`.
//!
//! In: a line of `candump -l` or `-L`, `(SECONDS.MICROS) IFACE ID#HEX`, with CAN FD (`ID##FLAGSHEX`), remote requests (`ID#R`) and
//! extended identifiers (8 digits), or of the screen form with absolute time, `(SECONDS.MICROS)  IFACE  ID   [LENGTH]  HH HH`.
//! Out: a [`LoggedFrame`]. Invariant: no line panics, and the stamp is exact. Source: the formats that can-utils documents.

use freespace::space::Micros;

/// Largest data of a CAN FD frame, bytes.
const MAX_DATA: usize = 64;

/// What is wrong with a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineFault {
    /// Not `(SECONDS.MICROS)`.
    #[error("no time stamp in brackets")]
    Stamp,
    /// No interface name.
    #[error("no interface")]
    Interface,
    /// Not 3 or 8 hexadecimal digits, or out of range.
    #[error("no identifier of 3 or 8 hexadecimal digits")]
    Identifier,
    /// Neither pairs of hexadecimal digits nor a remote request.
    #[error("the data are no pairs of hexadecimal digits")]
    Data,
    /// More bytes than a frame holds, or another number than stated.
    #[error("the data have a wrong length")]
    Length,
    /// Something follows the frame.
    #[error("text after the frame")]
    Trailing,
}

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameKind {
    /// Classic CAN with data.
    Data,
    /// CAN FD.
    Fd,
    /// A remote request: no data.
    Remote,
    /// An error report of the controller: its data are no signals.
    Error,
}

/// One line of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoggedFrame<'a> {
    /// Receive stamp as logged.
    pub stamp: Micros,
    /// Interface.
    pub interface: &'a str,
    /// Identifier without flags.
    pub id: u32,
    /// 29 bits instead of 11.
    pub is_extended: bool,
    /// What it is.
    pub kind: FrameKind,
    length: usize,
    bytes: [u8; MAX_DATA],
}

impl<'a> LoggedFrame<'a> {
    /// The data.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    /// Reads a line.
    ///
    /// # Errors
    /// What is wrong with the line.
    pub fn parse(line: &'a str) -> Result<Self, LineFault> {
        let line = line.trim();
        let (stamp, rest) = (line.strip_prefix('('))
            .and_then(|line| line.split_once(')'))
            .ok_or(LineFault::Stamp)?;
        let stamp = parse_stamp(stamp.trim()).ok_or(LineFault::Stamp)?;
        let mut words = rest.split_ascii_whitespace();
        let interface = words.next().ok_or(LineFault::Interface)?;
        let frame = words.next().ok_or(LineFault::Identifier)?;
        let (id, data) = frame
            .split_once('#')
            .map_or((frame, None), |(id, data)| (id, Some(data)));
        let (id, is_extended, is_error) = parse_id(id).ok_or(LineFault::Identifier)?;
        let mut parsed = Self {
            stamp,
            interface,
            id,
            is_extended,
            kind: FrameKind::Data,
            length: 0,
            bytes: [0; MAX_DATA],
        };
        match data {
            Some(data) => {
                parsed.compact_data(data)?;
                // Newer versions add the direction of the frame.
                if words.any(|word| word != "R" && word != "T") {
                    return Err(LineFault::Trailing);
                }
            }
            None => parsed.screen_data(words)?,
        }
        if is_error {
            parsed.kind = FrameKind::Error;
        }
        Ok(parsed)
    }

    /// `HEX`, `R`, `RLENGTH` or `#FLAGSHEX`; bytes may be parted by dots, a raw length code may follow as `_N`.
    fn compact_data(&mut self, data: &str) -> Result<(), LineFault> {
        if let Some(length) = data.strip_prefix(['R', 'r']) {
            self.kind = FrameKind::Remote;
            let is_length = length.is_empty() || (length.len() == 1 && is_hex(length));
            return if is_length { Ok(()) } else { Err(LineFault::Data) };
        }
        let Some(flags_and_data) = data.strip_prefix('#') else {
            let data = data.split_once('_').map_or(data, |(data, _)| data);
            return self.push_hex(data, 8);
        };
        self.kind = FrameKind::Fd;
        let flags = flags_and_data.get(..1).ok_or(LineFault::Data)?;
        if !is_hex(flags) {
            return Err(LineFault::Data);
        }
        self.push_hex(&flags_and_data[1..], MAX_DATA)
    }

    /// `[LENGTH] HH HH ..` or `[LENGTH] remote request`; what follows the stated bytes (the ASCII view) is not data.
    fn screen_data<'w>(&mut self, mut words: impl Iterator<Item = &'w str>) -> Result<(), LineFault> {
        let length = (words.next())
            .and_then(|word| word.strip_prefix('[')?.strip_suffix(']'))
            .ok_or(LineFault::Data)?;
        let stated: usize = length.parse().map_err(|_| LineFault::Length)?;
        if stated > MAX_DATA {
            return Err(LineFault::Length);
        }
        // Two digits inside the brackets mark CAN FD.
        if length.len() == 2 {
            self.kind = FrameKind::Fd;
        } else if stated > 8 {
            return Err(LineFault::Length);
        }
        for _ in 0..stated {
            let byte = words.next().ok_or(LineFault::Length)?;
            if byte == "remote" {
                self.kind = FrameKind::Remote;
                self.length = 0;
                return Ok(());
            }
            if byte.len() != 2 {
                return Err(LineFault::Data);
            }
            self.push_hex(byte, MAX_DATA)?;
        }
        if words.next().is_some_and(|word| is_hex(word) && word.len() == 2) {
            return Err(LineFault::Length);
        }
        Ok(())
    }

    fn push_hex(&mut self, text: &str, most: usize) -> Result<(), LineFault> {
        let mut digits = text.bytes().filter(|byte| *byte != b'.');
        while let Some(high) = digits.next() {
            let low = digits.next().ok_or(LineFault::Data)?;
            let (high, low) = (
                hex_digit(high).ok_or(LineFault::Data)?,
                hex_digit(low).ok_or(LineFault::Data)?,
            );
            if self.length >= most {
                return Err(LineFault::Length);
            }
            self.bytes[self.length] = high << 4 | low;
            self.length += 1;
        }
        Ok(())
    }
}

const fn hex_digit(byte: u8) -> Option<u8> {
    match byte {
        b'0'..=b'9' => Some(byte - b'0'),
        b'a'..=b'f' => Some(byte - b'a' + 10),
        b'A'..=b'F' => Some(byte - b'A' + 10),
        _ => None,
    }
}

fn is_hex(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Identifier, whether it is extended, whether it marks an error report.
fn parse_id(text: &str) -> Option<(u32, bool, bool)> {
    const ERROR_FLAG: u32 = 0x2000_0000;
    if !is_hex(text) {
        return None;
    }
    let id = u32::from_str_radix(text, 16).ok()?;
    match text.len() {
        3 if id <= 0x7ff => Some((id, false, false)),
        8 if id & ERROR_FLAG != 0 => Some((id & 0x1fff_ffff, true, true)),
        8 if id <= 0x1fff_ffff => Some((id, true, false)),
        _ => None,
    }
}

/// `SECONDS.FRACTION`, in whole microseconds: no rounding through floating point. Digits beyond the sixth are cut.
fn parse_stamp(text: &str) -> Option<Micros> {
    let (seconds, fraction) = text.split_once('.')?;
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if !is_number(seconds) || !is_number(fraction) || fraction.len() > 9 {
        return None;
    }
    let seconds: u64 = seconds.parse().ok()?;
    let digits = (fraction.bytes().chain(std::iter::repeat(b'0'))).take(6);
    let micros = digits.fold(0, |micros, digit| micros * 10 + u64::from(digit - b'0'));
    Some(Micros(seconds.checked_mul(1_000_000)?.checked_add(micros)?))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn kind_id_data(line: &str) -> (FrameKind, u32, bool, Vec<u8>) {
        let frame = LoggedFrame::parse(line).unwrap();
        (frame.kind, frame.id, frame.is_extended, frame.data().to_vec())
    }

    #[test]
    fn every_spelling_of_candump_is_read() {
        use FrameKind::{Data, Error, Fd, Remote};
        let cases = [
            (
                "(1436509052.249713) vcan0 044#2A366C2B",
                Data,
                0x044,
                false,
                vec![0x2a, 0x36, 0x6c, 0x2b],
            ),
            ("(1.000000) can0 7FF#", Data, 0x7ff, false, vec![]),
            (
                "(1.000000) can0 00000123#0a.0B",
                Data,
                0x123,
                true,
                vec![0x0a, 0x0b],
            ),
            ("(1.000000) can0 1FFFFFFF#00 R", Data, 0x1fff_ffff, true, vec![0]),
            (
                "(1.000000) can0 123#0011223344556677_B",
                Data,
                0x123,
                false,
                vec![0, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77],
            ),
            ("(1.000000) can0 123#R", Remote, 0x123, false, vec![]),
            ("(1.000000) can0 123#R4", Remote, 0x123, false, vec![]),
            ("(1.000000) can0 123##1AABB", Fd, 0x123, false, vec![0xaa, 0xbb]),
            (
                "(1.000000) can0 20000004#0001000000000000",
                Error,
                4,
                true,
                vec![0, 1, 0, 0, 0, 0, 0, 0],
            ),
            (
                " (1.000000)  can0  123   [2]  AA 0B",
                Data,
                0x123,
                false,
                vec![0xaa, 0x0b],
            ),
            (
                " (1.000000)  can0  123   [2]  AA 42   '.B'",
                Data,
                0x123,
                false,
                vec![0xaa, 0x42],
            ),
            (
                " (1.000000)  can0  123  [02]  AA 0B",
                Fd,
                0x123,
                false,
                vec![0xaa, 0x0b],
            ),
            (" (1.000000)  can0  123   [0]", Data, 0x123, false, vec![]),
            (
                " (1.000000)  can0  123   [4]  remote request",
                Remote,
                0x123,
                false,
                vec![],
            ),
        ];
        for (line, kind, id, is_extended, data) in cases {
            assert_eq!(kind_id_data(line), (kind, id, is_extended, data), "{line}");
        }
    }

    #[test]
    fn stamps_are_exact_to_the_microsecond() {
        let stamp =
            |text: &str| LoggedFrame::parse(&format!("({text}) can0 1FF#")).map(|frame| frame.stamp.0);
        assert_eq!(stamp("1700000000.000313"), Ok(1_700_000_000_000_313));
        assert_eq!(stamp("46408.58493"), Ok(46_408_584_930));
        assert_eq!(stamp("0.1234569"), Ok(123_456));
        for wrong in [
            "1",
            "1.",
            ".5",
            "-1.0",
            "1.0e3",
            "1.1234567890",
            "99999999999999999999.0",
            "18446744073709.999999",
            "",
        ] {
            assert_eq!(stamp(wrong), Err(LineFault::Stamp), "{wrong}");
        }
    }

    #[test]
    fn garbage_is_told_apart() {
        use LineFault::{Data, Identifier, Interface, Length, Stamp, Trailing};
        let cases = [
            ("", Stamp),
            ("can0 123#00", Stamp),
            ("(1.0)", Interface),
            ("(1.0) can0", Identifier),
            ("(1.0) can0 12#00", Identifier),
            ("(1.0) can0 800#00", Identifier),
            ("(1.0) can0 XYZ#00", Identifier),
            ("(1.0) can0 3FFFFFFFF#00", Identifier),
            ("(1.0) can0 123#0", Data),
            ("(1.0) can0 123#0G", Data),
            ("(1.0) can0 123#\u{e4}\u{f6}", Data),
            ("(1.0) can0 123##\u{e4}00", Data),
            ("(1.0) can0 123##", Data),
            ("(1.0) can0 123#R44", Data),
            ("(1.0) can0 123#001122334455667788", Length),
            ("(1.0) can0 123#00 and more", Trailing),
            ("(1.0) can0 123 00", Data),
            ("(1.0) can0 123 [9] 00", Length),
            ("(1.0) can0 123 [2] 00", Length),
            ("(1.0) can0 123 [1] 00 11", Length),
            ("(1.0) can0 123 [1] 000", Data),
        ];
        for (line, fault) in cases {
            assert_eq!(LoggedFrame::parse(line), Err(fault), "{line}");
        }
    }
}
