//! Islands: patches of road beside the car that it cannot reach.
//!
//! In: labels `[H, W] u8`, 1 = road, and the row at which the road is [`ISLAND_RANGE_M`](crate::budget::ISLAND_RANGE_M) away.
//! Out: the same labels, without the patches that touch the rows below (nearer) but not the largest patch. A patch farther
//! away stays: what cuts it off may be a car across the road. Cost: two visits a pixel; the stack holds every pixel.
//!
//! Free space is where the car can go. A pavement behind a kerb line, called road by its colour and lying on the plane, is
//! cut off from the car's own road in the picture, and that is the one thing that tells it apart.

use alloc::boxed::Box;
use alloc::vec;

/// Memory of the search.
#[derive(Clone, Debug)]
pub struct Islands {
    width: usize,
    /// Number of each pixel's patch, from 1; 0 where it is no road or not visited yet.
    patch: Box<[u32]>,
    stack: Box<[u32]>,
}

/// One connected patch of road.
#[derive(Clone, Copy, Debug, Default)]
struct Patch {
    number: u32,
    pixels: usize,
}

impl Islands {
    /// Memory for labels of this size.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let pixels = width * height;
        Self {
            width,
            patch: vec![0; pixels].into_boxed_slice(),
            stack: vec![0; pixels].into_boxed_slice(),
        }
    }

    /// Takes the islands out of `labels` that begin in row `near_row` or below it.
    ///
    /// # Panics
    /// Where `labels` is not of the size given at construction.
    pub fn remove(&mut self, labels: &mut [u8], near_row: usize) {
        assert!(labels.len() == self.patch.len());
        self.patch.fill(0);
        let near = (near_row * self.width).min(labels.len());
        let mut largest = Patch::default();
        let mut number = 0;
        for seed in near..labels.len() {
            if labels[seed] != 0 && self.patch[seed] == 0 {
                number += 1;
                let pixels = self.fill(labels, seed, number);
                if pixels > largest.pixels {
                    largest = Patch { number, pixels };
                }
            }
        }
        for (label, patch) in labels.iter_mut().zip(&self.patch) {
            if *patch != 0 && *patch != largest.number {
                *label = 0;
            }
        }
    }

    /// Numbers the patch of `seed`; returns its pixels.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "an image has fewer than 2^32 pixels"
    )]
    fn fill(&mut self, labels: &[u8], seed: usize, number: u32) -> usize {
        let (width, end) = (self.width, labels.len());
        let (mut depth, mut pixels) = (0, 0);
        let Self { patch, stack, .. } = self;
        let mut visit = |at: usize, stack: &mut [u32], depth: &mut usize| {
            // A pixel is numbered when it is pushed, so each is pushed once and the stack never overflows.
            if labels[at] != 0 && patch[at] == 0 {
                patch[at] = number;
                stack[*depth] = at as u32;
                *depth += 1;
            }
        };
        visit(seed, stack, &mut depth);
        while depth > 0 {
            depth -= 1;
            pixels += 1;
            let at = stack[depth] as usize;
            let column = at % width;
            if column > 0 {
                visit(at - 1, stack, &mut depth);
            }
            if column + 1 < width {
                visit(at + 1, stack, &mut depth);
            }
            if at >= width {
                visit(at - width, stack, &mut depth);
            }
            if at + width < end {
                visit(at + width, stack, &mut depth);
            }
        }
        pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(rows: [&str; 4]) -> alloc::vec::Vec<u8> {
        rows.iter()
            .flat_map(|row| row.bytes().map(|byte| u8::from(byte == b'#')))
            .collect()
    }

    #[test]
    fn a_near_island_goes_and_a_far_one_stays() {
        let mut found = labels(["##..##..", "........", "###.#.##", "###.###."]);
        Islands::new(8, 4).remove(&mut found, 2);
        assert_eq!(found, labels(["##..##..", "........", "###.....", "###....."]));
    }

    #[test]
    fn all_road_and_no_road_stay_as_they_are() {
        let mut islands = Islands::new(8, 4);
        for value in [0, 1] {
            let mut found = alloc::vec![value; 32];
            islands.remove(&mut found, 0);
            assert!(found.iter().all(|label| *label == value));
        }
    }
}
