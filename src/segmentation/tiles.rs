//! Tiles: how a camera image of any aspect ratio is shown to a network of one shape.
//!
//! In: image size, [`TileConfig`]. Out: one to three [`Tile`]s side by side, each as high as the image, neighbours
//! overlapping by [`TILE_OVERLAP`] of a tile's width; then, where wanted and where there is room in [`MAX_TILES`], the far
//! tile, which shows the road's far end again and larger. Invariant: those side by side cover every column.
#![allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^24")]

use crate::budget::{MAX_TILES, TILE_OVERLAP};
use crate::frame::Camera;

/// Settings of the tiling.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TileConfig {
    /// Tiles to use, 1 to 3; none to choose from the aspect ratio.
    pub count: Option<usize>,
    /// The far tile; none without.
    pub far: Option<Tile>,
}

/// A part of the image, as fractions of the image's width and height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tile {
    /// Left edge, 0 to 1.
    pub left: f32,
    /// Upper edge, 0 to 1.
    pub top: f32,
    /// Width, 0 to 1.
    pub width: f32,
    /// Height, 0 to 1.
    pub height: f32,
    /// Whether it replaces what the tiles before it said, but for a margin where both are blended.
    pub is_far: bool,
}

/// The tiles of an image, left to right, the far tile last.
pub type Tiles = heapless::Vec<Tile, MAX_TILES>;

/// Part of the image's height that the far tile takes, and how much of it lies over the horizon.
const FAR_HEIGHT: f32 = 0.45;
/// See [`FAR_HEIGHT`].
const FAR_ABOVE: f32 = 0.08;
/// Width of the far tile over its height, in pixels of the image: seen by the network a third too narrow, as wide crops are in training.
const FAR_ASPECT: f32 = 2.0;
/// Part of the far tile on each side over which it is blended with what it replaces.
const FAR_MARGIN: f32 = 0.1;

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
            top: 0.0,
            width,
            height: 1.0,
            is_far: false,
        })
        .chain(config.far)
        .take(MAX_TILES)
        .collect()
}

impl Tile {
    /// The far tile of a camera: around the horizon straight ahead of the car.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fractions of an image")]
    pub fn far(camera: &Camera) -> Self {
        let (width_px, height_px) = (camera.width.max(1) as f32, camera.height.max(1) as f32);
        let camera_from_vehicle = camera.mount.vehicle_from_camera().rotation.inverse();
        let ahead = camera
            .lens
            .project(&(camera_from_vehicle * nalgebra::Vector3::x()));
        let (x, y) = ahead.map_or((0.5, 0.5), |pixel| {
            (
                (pixel.x as f32 + 0.5) / width_px,
                (pixel.y as f32 + 0.5) / height_px,
            )
        });
        let width = (FAR_HEIGHT * FAR_ASPECT * height_px / width_px).min(1.0);
        Self {
            left: (x - 0.5 * width).clamp(0.0, 1.0 - width),
            top: (y - FAR_ABOVE).clamp(0.0, 1.0 - FAR_HEIGHT),
            width,
            height: FAR_HEIGHT,
            is_far: true,
        }
    }

    /// Weight of this tile in the column at `x` (0 to 1 across the image): 1 inside, falling linearly to 0 over the overlap
    /// with a neighbour, or over the far tile's margin.
    #[must_use]
    pub fn weight(&self, x: f32) -> f32 {
        let share = if self.is_far { FAR_MARGIN } else { TILE_OVERLAP };
        ramp(x, self.left, self.width, share)
    }

    /// Weight of this tile in the row at `y` (0 to 1 down the image).
    #[must_use]
    pub fn row_weight(&self, y: f32) -> f32 {
        ramp(y, self.top, self.height, FAR_MARGIN)
    }
}

/// 1 inside a span, falling linearly to 0 over `share` of it at each end that does not lie at the image's edge.
fn ramp(at: f32, start: f32, length: f32, share: f32) -> f32 {
    let end = start + length;
    let rise = if start <= 0.0 {
        1.0
    } else {
        (at - start) / (length * share)
    };
    let fall = if end >= 1.0 - 1e-5 {
        1.0
    } else {
        (end - at) / (length * share)
    };
    rise.min(fall).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn side_by_side(count: usize) -> TileConfig {
        TileConfig {
            count: Some(count),
            far: None,
        }
    }

    #[test]
    fn the_far_tile_lies_around_the_horizon() {
        let camera = Camera {
            lens: crate::frame::Lens::pinhole(500.0, 500.0, 319.5, 239.5),
            width: 640,
            height: 480,
            mount: crate::space::Mount {
                height_m: 1.4,
                ahead_m: 1.6,
                left_m: 0.0,
                pitch_rad: 0.03,
                yaw_rad: 0.0,
                roll_rad: 0.0,
            },
        };
        let far = Tile::far(&camera);
        let horizon = (239.5 + 0.5 - 500.0 * 0.03) / 480.0;
        assert!((far.top + FAR_ABOVE - horizon).abs() < 0.01, "{far:?}");
        assert!((far.left + 0.5 * far.width - 0.5).abs() < 0.01, "{far:?}");
        assert!(far.weight(0.5) >= 1.0 && far.weight(far.left) <= 0.0);
        let tiles = tile(
            640,
            480,
            &TileConfig {
                count: Some(1),
                far: Some(far),
            },
        );
        assert_eq!(tiles.len(), 2);
        assert!(tiles[0].row_weight(0.0) >= 1.0);
    }

    #[test]
    fn weights_sum_to_one_in_every_column() {
        for count in 1..=MAX_TILES {
            let tiles = tile(1242, 375, &side_by_side(count));
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
