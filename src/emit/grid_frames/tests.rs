#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_wrap,
    clippy::cast_possible_truncation,
    reason = "tests"
)]

use alloc::vec;
use alloc::vec::Vec;

use super::*;
use crate::emit::{Header, Publication};
use crate::grid::Grid;
use crate::health::QualityLevel;
use crate::space::Micros;
use proptest::prelude::*;

/// The frames of a grid whose cells depend on `seed`, and its occupancy.
fn encoded(encoder: &mut GridEncoder, rows: usize, columns: usize, seed: u32) -> (Vec<CanFrame>, Vec<i8>) {
    let mut grid = Grid::new(rows, columns, 0.2);
    for (i, cell) in grid.occupancy.iter_mut().enumerate() {
        *cell = ((i as u32).wrapping_mul(seed | 1) % 102) as i8 - 1;
    }
    let header = Header {
        sequence: u64::from(seed),
        capture: Micros(u64::from(seed) << 20),
        level: QualityLevel::Full,
        ..Header::default()
    };
    let mut bytes = vec![0; FreeSpaceMessage::encoded_len(rows * columns)];
    Publication { header, grid: &grid }
        .encode_into(&mut bytes)
        .unwrap();
    let mut frames = Vec::new();
    encoder.encode(&FreeSpaceMessage::decode(&bytes).unwrap(), &mut |frame| {
        frames.push(frame.clone());
    });
    (frames, grid.occupancy.to_vec())
}

/// Reads frames; the last step, and every refusal.
fn read(reader: &mut GridReader, frames: &[CanFrame]) -> (Option<GridStep>, Vec<GridRefusal>) {
    let mut last = None;
    let mut refusals = Vec::new();
    for frame in frames {
        match reader.take(frame) {
            Ok(step) => last = Some(step),
            Err(refusal) => refusals.push(refusal),
        }
    }
    (last, refusals)
}

proptest! {
    #[test]
    fn a_grid_comes_back_and_nothing_becomes_free(seed: u32, rows in 1usize..30, columns in 1usize..30) {
        let mut encoder = GridEncoder::default();
        let mut reader = GridReader::new(30 * 30);
        for seed in [seed, seed.wrapping_add(1)] {
            let (frames, occupancy) = encoded(&mut encoder, rows, columns, seed);
            prop_assert_eq!(frames.len(), frames_of(rows * columns));
            prop_assert_eq!(read(&mut reader, &frames), (Some(GridStep::Complete), vec![]));
            let grid = reader.grid().unwrap();
            prop_assert_eq!((grid.sequence, grid.rows, grid.columns, grid.cell_mm), (seed, rows, columns, 200));
            prop_assert_eq!(grid.capture, Micros(u64::from(seed) << 20));
            for (sent, got) in occupancy.iter().zip(grid.occupancy) {
                prop_assert_eq!(*sent < 0, *got < 0);
                prop_assert_eq!(*sent == 0, *got == 0);
                prop_assert!((i16::from(*sent) - i16::from(*got)).abs() <= 7, "{} {}", sent, got);
            }
        }
    }

    #[test]
    fn damaged_missing_and_mixed_frames_give_no_grid(
        seed: u32, which in 0usize..8, byte in 0usize..64, bit in 0u32..8,
    ) {
        let mut encoder = GridEncoder::default();
        // 28 by 28: a head and seven frames.
        let (frames, _) = encoded(&mut encoder, 28, 28, seed);
        let (others, _) = encoded(&mut encoder, 28, 28, seed.wrapping_add(256));
        let mut damaged = frames.clone();
        damaged[which].data[byte] ^= 1 << bit;
        let mut missing = frames.clone();
        missing.remove(which);
        let mut doubled = frames.clone();
        doubled.insert(which, frames[which].clone());
        let mut mixed = frames.clone();
        mixed[which] = others[which].clone();
        for (case, mut frames) in [damaged, missing, mixed].into_iter().enumerate() {
            frames.push(others[0].clone());
            let mut reader = GridReader::new(28 * 28);
            let (_, refusals) = read(&mut reader, &frames);
            prop_assert!(reader.grid().is_none(), "case {}", case);
            prop_assert!(!refusals.is_empty() || which == 0, "case {}", case);
            // The next grid is not harmed.
            prop_assert_eq!(read(&mut reader, &others[1..]).0, Some(GridStep::Complete));
        }
        let mut reader = GridReader::new(28 * 28);
        let (_, refusals) = read(&mut reader, &doubled);
        // A head that comes twice begins anew, and what follows the last frame is no part of the grid.
        prop_assert_eq!(reader.grid().is_some(), which == 0 || which == 7);
        prop_assert!(!refusals.is_empty() || which == 7);
    }

    #[test]
    fn garbage_is_refused(bytes in prop::collection::vec(any::<u8>(), 0..64), is_head: bool) {
        let mut frame = CanFrame { id: if is_head { GRID_HEAD_ID } else { GRID_CELLS_ID }, ..CanFrame::default() };
        frame.data.extend_from_slice(&bytes).unwrap();
        prop_assert_eq!(GridReader::new(100).take(&frame), Err(GridRefusal::Damaged));
    }
}

#[test]
fn a_grid_larger_than_the_reader_is_refused() {
    let (frames, _) = encoded(&mut GridEncoder::default(), 20, 20, 1);
    let mut reader = GridReader::new(399);
    assert_eq!(reader.take(&frames[0]), Err(GridRefusal::WrongSize));
    assert!(frames.iter().all(CanFrame::is_fd));
}

/// The examples of the AUTOSAR protocol specification for profile 5: data id 0x1234, eight zero bytes, counter 0.
#[test]
fn profile_5_reference() {
    let sum = crc16(crc16(0xFFFF, &[0; 6]), &0x1234u16.to_le_bytes());
    assert_eq!(sum.to_le_bytes(), [0x1C, 0xCA]);
}
