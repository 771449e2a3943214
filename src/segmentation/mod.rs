//! Stage 5, segmentation: what goes into the network and what comes out; colour lines.

use alloc::boxed::Box;
use alloc::vec;

/// What the energy needs of a network's softmax, `[height, width] f32` at the CRF resolution.
#[derive(Clone, Debug)]
pub struct RoadProbability {
    width: usize,
    height: usize,
    /// `S_R(p)`: probability of road, all road classes summed.
    pub road: Box<[f32]>,
    /// `max S_notR(p)`: the largest probability among the other classes.
    pub not_road: Box<[f32]>,
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
