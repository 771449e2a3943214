#![allow(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::emit::{Header, Publication};
use crate::grid::Grid;
use crate::health::{Faults, ScaleState};
use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

fn encoded(header: Header, grid: &Grid) -> Vec<u8> {
    let mut bytes = vec![0; FreeSpaceMessage::encoded_len(grid.occupancy.len())];
    Publication { header, grid }.encode_into(&mut bytes).unwrap();
    bytes
}

fn grid(rows: usize, columns: usize, occupancy: i8) -> Grid {
    let mut grid = Grid::new(rows, columns, 0.25);
    grid.occupancy.fill(occupancy);
    grid.reason.fill(1);
    grid.age.fill(2);
    grid
}

#[test]
fn a_message_says_in_shared_memory_what_its_bytes_say() {
    let grid = grid(3, 4, 7);
    let header = Header {
        sequence: 9,
        capture: Micros(1_000_000),
        publish: Micros(1_090_000),
        used_micros: 90_000,
        level: QualityLevel::NoFreshMap,
        faults: Faults::PLANE_HELD,
        blame: Some(Blame::Camera),
        scale: ScaleState::Held,
        position_m: [1.0, 2.0, 3.0],
        free_m: core::array::from_fn(|sector| sector as f32),
        ..Header::default()
    };
    let bytes = encoded(header, &grid);
    let mut shared = Box::new(SharedMessage::EMPTY);
    assert_eq!(shared.check(), Err(SharedError::WrongLayout));
    shared.fill(&FreeSpaceMessage::decode_own(&bytes).unwrap(), Micros(5_000));
    assert_eq!(shared.check(), Ok(()));
    assert_eq!((shared.sequence, shared.faults), (9, Faults::PLANE_HELD.0));
    assert_eq!((shared.level, shared.blame, shared.scale), (3, 9, 3));
    assert_eq!(
        (shared.position_m, shared.free_m),
        (header.position_m, header.free_m)
    );
    assert_eq!((shared.origin_x_m, shared.origin_y_m), (0.0, -0.5));
    assert_eq!((shared.occupancy_at(2, 3), shared.occupancy_at(3, 0)), (7, -1));
    assert_eq!(shared.age_micros(Micros(6_000)), 91_000);
}

#[test]
fn what_a_larger_grid_left_becomes_unknown() {
    let mut shared = Box::new(SharedMessage::EMPTY);
    // As a slot comes from the kernel: all zero, which is free.
    shared.occupancy.fill(0);
    for (rows, columns) in [(20, 20), (3, 3), (5, 5)] {
        let grid = grid(rows, columns, 0);
        let bytes = encoded(Header::default(), &grid);
        shared.fill(&FreeSpaceMessage::decode(&bytes).unwrap(), Micros(0));
        let (used, beyond) = shared.occupancy.split_at(rows * columns);
        assert!(used.iter().all(|cell| *cell == 0));
        assert!(beyond.iter().all(|cell| *cell == -1));
    }
}

#[test]
fn the_way_ahead_is_the_least_of_the_sectors_ahead() {
    let mut shared = Box::new(SharedMessage::EMPTY);
    shared.level = QualityLevel::Full as u8;
    shared.sector_first_rad = -0.8;
    shared.sector_rad = 0.05;
    shared.free_m.fill(3.0);
    shared.free_m[15] = 20.0;
    shared.free_m[16] = 12.0;
    assert_eq!(shared.free_ahead_m(0.04), 12.0);
    assert_eq!(shared.free_ahead_m(0.2), 3.0);
    for unknown_m in [f32::NAN, -1.0] {
        shared.free_m[16] = unknown_m;
        assert_eq!(shared.free_ahead_m(0.04), 0.0);
    }
    shared.free_m[16] = 12.0;
    shared.level = QualityLevel::Invalid as u8;
    assert_eq!(shared.free_ahead_m(0.04), 0.0);
}

#[test]
fn the_header_is_that_of_the_wire_format() {
    let bytes = encoded(Header::default(), &grid(2, 2, 0));
    let end = FIELDS
        .iter()
        .find(|field| field.name == "origin_x_m")
        .unwrap()
        .offset;
    // Everything before the cells.
    assert_eq!(bytes.len() - 3 * 4 - 4, end);
}
