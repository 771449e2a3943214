//! Search: where to look for a track in the new frame, and whether what is found leads back.
//!
//! In: a track and the predicted motion. Out: its place in the new frame, or none. Cost: two searches on the coarse levels at
//! most, one on the finer ones, and one back.
#![allow(
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are bounded by the image"
)]

use nalgebra::Vector2;
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::corners::BORDER_PX;
use super::keypoint::Keypoint;
use super::klt::{Guess, Match, follow, follow_either};
use super::predict::Predictor;
use crate::frame::Pyramid;
use crate::space::Pose;

/// A track must come back this near to where it started.
const FORWARD_BACKWARD_PX: f32 = 0.7;
/// Guesses nearer to each other than this are one.
const SAME_GUESS_PX: f32 = 4.0;
/// A distance is known when its error moves the track by less than this.
const KNOWN_PX: f64 = 6.0;

/// Up to two places to look at, and the level to begin at.
pub(crate) struct Guesses {
    places: heapless::Vec<Guess, 2>,
    coarsest: usize,
}

/// Where to look for a track: by its distance where that is known, else on the road and infinitely far.
pub(crate) fn guesses(
    predictor: &Predictor<'_>,
    track: &Keypoint,
    previous_from_world: &Pose,
    baseline_m: f64,
    focal_px: f64,
) -> Guesses {
    let mut places = heapless::Vec::new();
    let inverse_m = match track.landmark {
        Some(landmark) => Some(1.0 / (previous_from_world * landmark).coords.norm().max(0.5)),
        None => track
            .distance_known(baseline_m, focal_px, KNOWN_PX)
            .then_some(track.inverse_m),
    };
    if let Some(guess) = inverse_m.and_then(|i| predictor.at_distance(&track.pixel, &track.ray, i)) {
        let _ = places.push(guess);
        return Guesses { places, coarsest: 2 };
    }
    let far = predictor.at_distance(&track.pixel, &track.ray, 0.0);
    let road = predictor.on_plane(&track.pixel, &track.ray);
    let same = matches!((&far, &road), (Some(a), Some(b)) if (a.pixel - b.pixel).norm() < SAME_GUESS_PX);
    for guess in [road, far.filter(|_| !same)].into_iter().flatten() {
        // As many places as guesses.
        let _ = places.push(guess);
    }
    Guesses { places, coarsest: 3 }
}

/// Follows a pixel to each guess, keeps the better, and demands that it leads back.
pub(crate) fn there_and_back(
    previous: &Pyramid,
    current: &Pyramid,
    from: &Vector2<f32>,
    guesses: &Guesses,
) -> Option<Match> {
    let (found, guess) = match guesses.places.as_slice() {
        [road, far] => {
            let either = follow_either(previous, current, from, &[*road, *far], guesses.coarsest);
            // Near the border the coarse levels have no room: then the road's guess is good.
            either.or_else(|| follow(previous, current, from, road, 1).map(|found| (found, *road)))
        }
        [one] => follow(previous, current, from, one, guesses.coarsest).map(|found| (found, *one)),
        _ => None,
    }?;
    let base = current.base();
    let border = BORDER_PX as f32 - 2.0;
    let inside = found.pixel.x >= border
        && found.pixel.y >= border
        && found.pixel.x < base.width() as f32 - border
        && found.pixel.y < base.height() as f32 - border;
    if !inside {
        return None;
    }
    let back = Guess {
        pixel: *from,
        stretch: guess.stretch.try_inverse()?,
    };
    let returned = follow(current, previous, &found.pixel, &back, 1)?;
    ((returned.pixel - from).norm() < FORWARD_BACKWARD_PX).then_some(found)
}
