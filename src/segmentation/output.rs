//! What comes out of the network: the softmax of each tile, resampled to the CRF resolution.
//!
//! In: `[classes, out_height, out_width] f32` a tile. Out: [`RoadProbability`]: the road classes summed, the largest of
//! the others, tiles blended linearly where they overlap, the far tile over the others. Invariant: both outputs lie in 0..1; NaN counts as undecided.
//! Cost: one pass over the softmax a tile, then two taps an axis and output pixel.
#![allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^24")]

use alloc::boxed::Box;
use alloc::vec;

use super::resample::{Taps, taps};
use super::{NetworkShape, RoadProbability, Tiles};

/// Where a tile falls on the output along one axis: pixels, their taps and their weights.
#[derive(Clone, Debug)]
struct Span {
    first: usize,
    taps: Box<[Taps]>,
    weight: Box<[f32]>,
}

impl Span {
    /// Of a tile from `start` over `length` of an axis of `out` pixels, which the network sees as `source` pixels.
    fn new(start: f32, length: f32, source: usize, out: usize, weight: impl Fn(f32) -> f32) -> Self {
        let centre = |i: usize| (i as f32 + 0.5) / out as f32;
        let first = (0..out).find(|&i| weight(centre(i)) > 0.0).unwrap_or(0);
        let end = (0..out)
            .rfind(|&i| weight(centre(i)) > 0.0)
            .map_or(first, |i| i + 1);
        // Output pixels in the tile's own pixels.
        let step = source as f32 / (length * out as f32);
        let begin = (first as f32 / out as f32 - start) / length * source as f32;
        Self {
            first,
            taps: taps(begin, step * (end - first) as f32, source, end - first),
            weight: (first..end).map(|i| weight(centre(i))).collect(),
        }
    }
}

/// A tile on the output.
#[derive(Clone, Debug)]
struct Place {
    columns: Span,
    rows: Span,
    is_far: bool,
}

/// Resamples network outputs.
#[derive(Clone, Debug)]
pub struct OutputResampler {
    shape: NetworkShape,
    height: usize,
    places: heapless::Vec<Place, { crate::budget::MAX_TILES }>,
    /// Road, not road and vehicle of one tile at the network's resolution, `[out_height, out_width, 3] f32`.
    reduced: Box<[[f32; 3]]>,
    /// One row of it, rows already mixed.
    line: Box<[[f32; 3]]>,
}

impl OutputResampler {
    /// To an output of `width x height` pixels, for `tiles` of the image.
    #[must_use]
    pub fn new(shape: &NetworkShape, tiles: &Tiles, width: usize, height: usize) -> Self {
        let places = tiles
            .iter()
            .map(|tile| Place {
                columns: Span::new(tile.left, tile.width, shape.out_width, width, |x| tile.weight(x)),
                rows: Span::new(tile.top, tile.height, shape.out_height, height, |y| {
                    tile.row_weight(y)
                }),
                is_far: tile.is_far,
            })
            .collect();
        Self {
            shape: shape.clone(),
            height,
            places,
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
        assert!(probability.height() == self.height);
        if index == 0 {
            probability.road.fill(0.0);
            probability.not_road.fill(0.0);
            probability.vehicle.fill(0.0);
        }
        self.reduce(softmax);
        let out_width = self.shape.out_width;
        let Place {
            columns,
            rows,
            is_far,
        } = &self.places[index];
        for (y, (row_taps, row_weight)) in rows.taps.iter().zip(&rows.weight).enumerate() {
            self.line.fill([0.0; 3]);
            for (source_y, weight) in row_taps.iter() {
                let row = &self.reduced[source_y * out_width..][..out_width];
                for (sum, value) in self.line.iter_mut().zip(row) {
                    sum[0] += weight * value[0];
                    sum[1] += weight * value[1];
                    sum[2] += weight * value[2];
                }
            }
            let start = (rows.first + y) * width + columns.first;
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
                let weight = columns.weight[x] * row_weight;
                // Tiles side by side add up to one; the far one takes its share from what is there.
                let kept = if *is_far { 1.0 - weight } else { 1.0 };
                road[x] = kept * road[x] + weight * sum[0];
                not_road[x] = kept * not_road[x] + weight * sum[1];
                vehicle[x] = kept * vehicle[x] + weight * sum[2];
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
            let tiles = tile(
                300,
                100,
                &TileConfig {
                    count: Some(count),
                    far: None,
                },
            );
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
