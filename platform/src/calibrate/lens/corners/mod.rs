//! Chessboard corners in a picture.
//!
//! In: a gray picture. Out: inner corners with their places on a lattice, refined below a pixel. Invariant: a corner's
//! neighbours on the lattice are of the other colour arrangement, as on a chessboard; a picture without a board gives none.
//! Cost: a few passes over the picture at each of `LEVELS` sizes, and a search among at most
//! `saddle::MOST` saddles; what is beyond them, weakest first, is left out.
//! Method: saddles of the brightness (the determinant of the Hessian), tested on a ring for two crossing edges, grown into a
//! lattice from neighbour to neighbour; then each corner is moved to where all gradients around it point past it
//! (Förstner and Gülch 1987).

mod lattice;
mod plane;
mod ring;
mod saddle;
mod subpixel;

use freespace::frame::GrayImage;

use super::Sighting;
use lattice::Lattice;
use plane::Plane;

/// Sizes at which corners are looked for: a blurred or very large board shows better in a smaller picture.
const LEVELS: usize = 3;
/// Blur under which saddles are looked for, pixels of each size.
const SADDLE_BLUR_PX: f32 = 1.5;
/// Blur under which they are refined: takes off noise, leaves edges.
const REFINE_BLUR_PX: f32 = 0.8;
/// A smaller size must find this many times more corners to be believed over the full one.
const GAIN: f64 = 1.1;

/// What was found in a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Corners by their place; places begin at zero.
    pub sightings: Vec<Sighting>,
    /// Columns and rows that they span.
    pub extent: (usize, usize),
}

/// Looks for the largest chessboard lattice of a picture; `wanted` corners are as many as there can be.
#[must_use]
pub fn find(image: &GrayImage, wanted: usize) -> Found {
    let full = Plane::from_gray(image);
    let mut best = (0, Lattice::default());
    let mut level = full.clone();
    for scale in 0..LEVELS {
        let candidates = saddle::candidates(&level.blurred(SADDLE_BLUR_PX));
        let lattice = lattice::largest(&candidates, wanted);
        #[expect(clippy::cast_precision_loss, reason = "thousands")]
        let is_better = lattice.len() as f64 > GAIN * best.1.len() as f64;
        if is_better {
            best = (scale, lattice);
        }
        if best.1.len() >= wanted || level.width() < 160 || level.height() < 120 {
            break;
        }
        level = level.halved();
    }
    let (scale, lattice) = best;
    let blurred = full.blurred(REFINE_BLUR_PX);
    let refined = subpixel::refined(&blurred, &lattice.scaled(scale)).trimmed();
    Found {
        extent: refined.extent(),
        sightings: refined.into_sightings(),
    }
}
