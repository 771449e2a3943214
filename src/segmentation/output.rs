//! What comes out of the network: the softmax of each tile, resampled to the CRF resolution.
//!
//! In: `[classes, out_height, out_width] f32` a tile. Out: [`RoadProbability`]: the road classes summed, the largest of
//! the others, tiles blended linearly where they overlap. Invariant: both outputs lie in 0..1; NaN counts as undecided.
//! Cost: one pass over the softmax a tile, then two taps an axis and output pixel.
#![allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^24")]

use alloc::boxed::Box;
use alloc::vec;

use super::resample::{Taps, taps};
use super::{NetworkShape, RoadProbability, Tiles};

/// Where a tile falls on the output: its columns, their taps and their weights.
#[derive(Clone, Debug)]
struct TileColumns {
    first: usize,
    taps: Box<[Taps]>,
    weight: Box<[f32]>,
}

/// Resamples network outputs.
#[derive(Clone, Debug)]
pub struct OutputResampler {
    shape: NetworkShape,
    columns: heapless::Vec<TileColumns, { crate::budget::MAX_TILES }>,
    rows: Box<[Taps]>,
    /// Road, not road and vehicle of one tile at the network's resolution, `[out_height, out_width, 3] f32`.
    reduced: Box<[[f32; 3]]>,
    /// One row of it, rows already mixed.
    line: Box<[[f32; 3]]>,
}

impl OutputResampler {
    /// To an output of `width x height` pixels, for `tiles` of the image.
    #[must_use]
    pub fn new(shape: &NetworkShape, tiles: &Tiles, width: usize, height: usize) -> Self {
        let columns = tiles
            .iter()
            .map(|tile| {
                let centre = |x: usize| (x as f32 + 0.5) / width as f32;
                let first = (0..width).find(|&x| tile.weight(centre(x)) > 0.0).unwrap_or(0);
                let end = (0..width)
                    .rfind(|&x| tile.weight(centre(x)) > 0.0)
                    .map_or(first, |x| x + 1);
                // Output columns in the tile's own pixels.
                let step = shape.out_width as f32 / (tile.width * width as f32);
                let start = (first as f32 / width as f32 - tile.left) / tile.width * shape.out_width as f32;
                TileColumns {
                    first,
                    taps: taps(start, step * (end - first) as f32, shape.out_width, end - first),
                    weight: (first..end).map(|x| tile.weight(centre(x))).collect(),
                }
            })
            .collect();
        Self {
            shape: shape.clone(),
            columns,
            rows: taps(0.0, shape.out_height as f32, shape.out_height, height),
            reduced: vec![[0.0; 3]; shape.out_width * shape.out_height].into_boxed_slice(),
            line: vec![[0.0; 3]; shape.out_width].into_boxed_slice(),
        }
    }

    /// Adds the softmax of tile `index`; tiles are added in order, the first clears what was there.
    ///
    /// # Panics
    /// Where a size is not that given at construction, or there is no such tile.
    pub fn add_tile(&mut self, softmax: &[f32], index: usize, probability: &mut RoadProbability) {
        let width = probability.width();
        assert!(probability.height() == self.rows.len());
        if index == 0 {
            probability.road.fill(0.0);
            probability.not_road.fill(0.0);
            probability.vehicle.fill(0.0);
        }
        self.reduce(softmax);
        let out_width = self.shape.out_width;
        let columns = &self.columns[index];
        for (y, row_taps) in self.rows.iter().enumerate() {
            self.line.fill([0.0; 3]);
            for (source_y, weight) in row_taps.iter() {
                let row = &self.reduced[source_y * out_width..][..out_width];
                for (sum, value) in self.line.iter_mut().zip(row) {
                    sum[0] += weight * value[0];
                    sum[1] += weight * value[1];
                    sum[2] += weight * value[2];
                }
            }
            let start = y * width + columns.first;
            let road = &mut probability.road[start..][..columns.taps.len()];
            let not_road = &mut probability.not_road[start..][..columns.taps.len()];
            let vehicle = &mut probability.vehicle[start..][..columns.taps.len()];
            for (x, column_taps) in columns.taps.iter().enumerate() {
                let mut sum = [0.0; 3];
                for (source_x, weight) in column_taps.iter() {
                    sum[0] += weight * self.line[source_x][0];
                    sum[1] += weight * self.line[source_x][1];
                    sum[2] += weight * self.line[source_x][2];
                }
                road[x] += columns.weight[x] * sum[0];
                not_road[x] += columns.weight[x] * sum[1];
                vehicle[x] += columns.weight[x] * sum[2];
            }
        }
    }

    /// Road classes summed, and the largest of the others, at the network's resolution.
    fn reduce(&mut self, softmax: &[f32]) {
        let count = self.reduced.len();
        assert!(softmax.len() == self.shape.classes * count);
        self.reduced.fill([0.0; 3]);
        for (class, plane) in softmax.chunks_exact(count.max(1)).enumerate() {
            if self.shape.is_road(class) {
                for (sum, &value) in self.reduced.iter_mut().zip(plane) {
                    sum[0] += value;
                }
            } else {
                for (sum, &value) in self.reduced.iter_mut().zip(plane) {
                    sum[1] = sum[1].max(value);
                }
            }
            if self.shape.vehicle.contains(&class) {
                for (sum, &value) in self.reduced.iter_mut().zip(plane) {
                    sum[2] += value;
                }
            }
        }
        for sum in &mut self.reduced {
            *sum = if sum.iter().all(|value| value.is_finite()) {
                sum.map(|value| value.clamp(0.0, 1.0))
            } else {
                [0.5, 0.5, 0.0]
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segmentation::tests::shape;
    use crate::segmentation::{TileConfig, tile};

    /// A softmax whose road probability is `road(x)` of the whole image's `x` in 0..1.
    fn softmax(shape: &NetworkShape, left: f32, width: f32, road: impl Fn(f32) -> f32) -> Box<[f32]> {
        let count = shape.out_width * shape.out_height;
        let mut softmax = vec![0.0; shape.classes * count].into_boxed_slice();
        for p in 0..count {
            let x = left + width * ((p % shape.out_width) as f32 + 0.5) / shape.out_width as f32;
            softmax[p] = 0.6 * (1.0 - road(x));
            softmax[count + p] = 0.4 * (1.0 - road(x));
            softmax[2 * count + p] = road(x);
        }
        softmax
    }

    #[test]
    fn tiles_join_without_a_seam() {
        let shape = shape();
        for count in 1..=3 {
            let tiles = tile(300, 100, &TileConfig { count: Some(count) });
            let mut resampler = OutputResampler::new(&shape, &tiles, 150, 50);
            let mut probability = RoadProbability::new(150, 50);
            for (index, t) in tiles.iter().enumerate() {
                let softmax = softmax(&shape, t.left, t.width, |x| 0.1 + 0.8 * x);
                resampler.add_tile(&softmax, index, &mut probability);
            }
            for p in 0..150 * 50 {
                let x = ((p % 150) as f32 + 0.5) / 150.0;
                // The outer half of a network pixel has no neighbour to interpolate with.
                if !(0.04..0.96).contains(&x) {
                    continue;
                }
                let expected = 0.1 + 0.8 * x;
                assert!(
                    (probability.road[p] - expected).abs() < 0.02,
                    "{x} {}",
                    probability.road[p]
                );
                assert!((probability.not_road[p] - 0.6 * (1.0 - expected)).abs() < 0.02);
            }
        }
    }

    #[test]
    fn a_network_gone_wrong_is_undecided() {
        let shape = shape();
        let tiles = tile(40, 30, &TileConfig::default());
        let mut resampler = OutputResampler::new(&shape, &tiles, 40, 30);
        let mut probability = RoadProbability::new(40, 30);
        let bad = vec![f32::NAN; shape.classes * shape.out_width * shape.out_height];
        resampler.add_tile(&bad, 0, &mut probability);
        assert!(probability.road.iter().all(|&p| (p - 0.5).abs() < 1e-3));
    }
}
