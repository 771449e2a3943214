//! Tiles: how a camera image of any aspect ratio is shown to a network of one shape.
//!
//! In: image size, [`TileConfig`]. Out: one to three [`Tile`]s side by side, each as high as the image, neighbours
//! overlapping by [`TILE_OVERLAP`] of a tile's width. Invariant: together they cover every column.
#![allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^24")]

use crate::budget::{MAX_TILES, TILE_OVERLAP};

/// Settings of the tiling.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(deny_unknown_fields, default)
)]
pub struct TileConfig {
    /// Tiles to use, 1 to 3; none to choose from the aspect ratio.
    pub count: Option<usize>,
}

/// A span of image columns, in pixels from the left edge, as a fraction of the image's width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tile {
    /// Left edge, 0 to 1.
    pub left: f32,
    /// Width, 0 to 1.
    pub width: f32,
}

/// The tiles of an image, left to right.
pub type Tiles = heapless::Vec<Tile, MAX_TILES>;

/// How many tiles an image of this aspect ratio (width over height) is worth.
#[must_use]
pub const fn tiles_for(aspect: f32) -> usize {
    if aspect < 2.0 {
        1
    } else if aspect < 4.0 {
        2
    } else {
        3
    }
}

/// The tiles of an image of `width x height` pixels.
#[must_use]
pub fn tile(width: usize, height: usize, config: &TileConfig) -> Tiles {
    let chosen = tiles_for(width as f32 / height.max(1) as f32);
    let count = config.count.unwrap_or(chosen).clamp(1, MAX_TILES);
    let width = 1.0 / (count as f32 - (count as f32 - 1.0) * TILE_OVERLAP);
    (0..count)
        .map(|k| Tile {
            left: k as f32 * width * (1.0 - TILE_OVERLAP),
            width,
        })
        .collect()
}

impl Tile {
    /// Weight of this tile at `x` (0 to 1 across the image): 1 inside, falling linearly to 0 over the overlap with a neighbour.
    #[must_use]
    pub fn weight(&self, x: f32) -> f32 {
        let overlap = self.width * TILE_OVERLAP;
        let right = self.left + self.width;
        let rise = if self.left <= 0.0 {
            1.0
        } else {
            (x - self.left) / overlap
        };
        let fall = if right >= 1.0 - 1e-5 {
            1.0
        } else {
            (right - x) / overlap
        };
        rise.min(fall).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_in_every_column() {
        for count in 1..=MAX_TILES {
            let tiles = tile(1242, 375, &TileConfig { count: Some(count) });
            assert_eq!(tiles.len(), count);
            for step in 0..=1000 {
                let x = step as f32 / 1000.0;
                let sum: f32 = tiles.iter().map(|t| t.weight(x)).sum();
                assert!((sum - 1.0).abs() < 1e-3, "{count} tiles at {x}: {sum}");
            }
        }
    }

    #[test]
    fn wide_images_take_more_tiles() {
        assert_eq!(tile(480, 360, &TileConfig::default()).len(), 1);
        assert_eq!(tile(1242, 375, &TileConfig::default()).len(), 2);
        assert_eq!(tile(1920, 400, &TileConfig::default()).len(), 3);
    }
}
