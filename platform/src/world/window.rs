//! Road coordinates of the ground around the camera, kept on whole metres and interpolated between.
//!
//! In: world positions. Out: `(s, d)` and how `s` changes there. Invariant: a node depends on its place alone, so a frame
//! does not depend on the frames before it. Memory: 1 MiB; a move of a metre computes about 256 nodes anew.
#![allow(
    clippy::cast_sign_loss,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "node indices wrap into the window"
)]

use super::World;
use super::noise::floor;

/// Side of the window of ground whose road coordinates are kept, in metres and nodes.
const WINDOW: usize = 256;
/// Road coordinates of the ground around the camera, on whole metres.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// Which node of the plane each slot holds.
    nodes: Box<[[i32; 2]]>,
    coordinates: Box<[[f32; 2]]>,
    first: [i32; 2],
}

impl Window {
    pub(super) fn new() -> Self {
        Self {
            nodes: vec![[i32::MIN; 2]; WINDOW * WINDOW].into_boxed_slice(),
            coordinates: vec![[0.0; 2]; WINDOW * WINDOW].into_boxed_slice(),
            first: [i32::MIN; 2],
        }
    }

    fn slot(x: i32, y: i32) -> usize {
        (y as usize & (WINDOW - 1)) * WINDOW + (x as usize & (WINDOW - 1))
    }

    pub(super) fn centre(&mut self, world: &World, x: f32, y: f32) {
        let half = WINDOW as i32 / 2;
        let first = [floor(x) - half, floor(y) - half];
        if first == self.first {
            return;
        }
        self.first = first;
        for j in self.first[1]..self.first[1] + WINDOW as i32 {
            for i in self.first[0]..self.first[0] + WINDOW as i32 {
                let slot = Self::slot(i, j);
                if self.nodes[slot] != [i, j] {
                    let (s, d) = world.road.locate(f64::from(i), f64::from(j));
                    self.coordinates[slot] = [s as f32, d as f32];
                    self.nodes[slot] = [i, j];
                }
            }
        }
    }

    /// `(s, d)` and the change of `s` along x and y; none outside the window.
    #[inline]
    pub(super) fn at(&self, x: f32, y: f32) -> Option<([f32; 2], [f32; 2])> {
        let (i, j) = (floor(x), floor(y));
        let (u, v) = (i - self.first[0], j - self.first[1]);
        let inside = 0..WINDOW as i32 - 1;
        if !inside.contains(&u) || !inside.contains(&v) {
            return None;
        }
        let (fx, fy) = (x - i as f32, y - j as f32);
        // A fixed length spares the checks of the four slots.
        let coordinates = self.coordinates.first_chunk::<{ WINDOW * WINDOW }>()?;
        let a = coordinates[Self::slot(i, j)];
        let b = coordinates[Self::slot(i + 1, j)];
        let c = coordinates[Self::slot(i, j + 1)];
        let e = coordinates[Self::slot(i + 1, j + 1)];
        let at = |k: usize| {
            let (top, bottom) = (a[k] + (b[k] - a[k]) * fx, c[k] + (e[k] - c[k]) * fx);
            top + (bottom - top) * fy
        };
        Some(([at(0), at(1)], [b[0] - a[0], c[0] - a[0]]))
    }
}
