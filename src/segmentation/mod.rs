//! Stage 5, segmentation: what goes into the network and what comes out; colour lines.
//!
//! The network itself runs behind the segmenter port; here is all that does not depend on the engine.

mod colour_lines;
mod input;
mod output;
mod reproject;
mod resample;
mod tiles;

pub use colour_lines::{ColourConfig, ColourLines};
pub use input::InputFiller;
pub use output::OutputResampler;
pub use reproject::reproject;
pub use tiles::{Tile, TileConfig, Tiles, tile, tiles_for};

use alloc::boxed::Box;
use alloc::vec;

use crate::budget::MAX_CLASSES;

/// Order of the three channels in a network's input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(rename_all = "lowercase")
)]
pub enum ChannelOrder {
    /// Red first.
    #[default]
    Rgb,
    /// Blue first.
    Bgr,
}

/// What the core must know of a network, from its manifest.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkShape {
    /// Width of the input in pixels.
    pub width: usize,
    /// Height of the input in pixels.
    pub height: usize,
    /// Classes of the softmax, at most [`MAX_CLASSES`].
    pub classes: usize,
    /// Which of them are road; they add up.
    pub road: heapless::Vec<usize, MAX_CLASSES>,
    /// Which of them are vehicles; they add up. Their lower edge in the picture is over the ground, not on it.
    pub vehicle: heapless::Vec<usize, MAX_CLASSES>,
    /// Subtracted from each channel (0..255), in the network's channel order.
    pub mean: [f32; 3],
    /// Multiplied then, in the network's channel order.
    pub scale: [f32; 3],
    /// Channel order of the input.
    pub order: ChannelOrder,
    /// Width of the softmax in pixels.
    pub out_width: usize,
    /// Height of the softmax in pixels.
    pub out_height: usize,
}

impl NetworkShape {
    /// Whether a class is road.
    #[must_use]
    pub fn is_road(&self, class: usize) -> bool {
        self.road.contains(&class)
    }

    /// Values of an input, `3 * H * W`.
    #[must_use]
    pub const fn input_len(&self) -> usize {
        3 * self.height * self.width
    }

    /// Values of an output, `C * h * w`.
    #[must_use]
    pub const fn output_len(&self) -> usize {
        self.classes * self.out_height * self.out_width
    }
}

/// What the energy needs of a network's softmax, `[height, width] f32` at the CRF resolution.
#[derive(Clone, Debug)]
pub struct RoadProbability {
    width: usize,
    height: usize,
    /// `S_R(p)`: probability of road, all road classes summed.
    pub road: Box<[f32]>,
    /// `max S_notR(p)`: the largest probability among the other classes.
    pub not_road: Box<[f32]>,
    /// Probability of a vehicle, all such classes summed; zero where the network knows none.
    pub vehicle: Box<[f32]>,
}

impl RoadProbability {
    /// Undecided everywhere.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let half = || vec![0.5; width * height].into_boxed_slice();
        Self {
            width,
            height,
            road: half(),
            not_road: half(),
            vehicle: vec![0.0; width * height].into_boxed_slice(),
        }
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A small network of three classes, the last one road.
    pub(crate) fn shape() -> NetworkShape {
        NetworkShape {
            width: 32,
            height: 24,
            classes: 3,
            road: heapless::Vec::from_iter([2]),
            vehicle: heapless::Vec::from_iter([1]),
            mean: [0.0; 3],
            scale: [1.0; 3],
            order: ChannelOrder::Rgb,
            out_width: 16,
            out_height: 12,
        }
    }
}
