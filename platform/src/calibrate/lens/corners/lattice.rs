//! From single corners to the lattice of a board.
//!
//! In: candidates. Out: the largest [`Lattice`] that grows out of any of them. Invariant: a place holds one corner, a corner
//! has one place, and corners side by side are of opposite arrangement. Cost: a search among all candidates for each step.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

use nalgebra::Vector2;

use super::super::Sighting;
use super::saddle::Candidate;

/// How far a corner may be from where its neighbours foretell it, in steps.
const OFF: f64 = 0.3;
/// How far the first neighbours may be off an edge's direction.
const OFF_EDGE_RAD: f64 = 0.25;
/// The four ways to a neighbour.
const WAYS: [(i32, i32); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];
/// A side of the lattice with fewer of its places filled than this is not part of the board.
const FILLED: f64 = 0.4;
/// Seeds tried without a larger lattice, once one of some size was found.
const PATIENCE: usize = 200;

/// Corners by their place.
#[derive(Clone, Debug, Default)]
pub(super) struct Lattice {
    corners: BTreeMap<(i32, i32), Vector2<f64>>,
}

/// The largest lattice; the search ends early at `wanted` corners.
pub(super) fn largest(candidates: &[Candidate], wanted: usize) -> Lattice {
    let mut best = BTreeMap::new();
    let mut used: BTreeSet<usize> = BTreeSet::new();
    let mut in_vain = 0;
    for seed in 0..candidates.len() {
        if best.len() >= wanted || (best.len() > 8 && in_vain > PATIENCE) {
            break;
        }
        if used.contains(&seed) {
            continue;
        }
        let grown = grow(candidates, seed);
        if grown.len() > 8 {
            used.extend(grown.values().copied());
        }
        in_vain += 1;
        if grown.len() > best.len() {
            best = grown;
            in_vain = 0;
        }
    }
    Lattice {
        corners: (best.into_iter())
            .map(|(place, index)| (place, candidates[index].at))
            .collect(),
    }
}

type Places = BTreeMap<(i32, i32), usize>;

/// Grows a lattice from one corner.
fn grow(candidates: &[Candidate], seed: usize) -> Places {
    let mut places = Places::from([((0, 0), seed)]);
    let mut taken = BTreeSet::from([seed]);
    if !first_neighbours(candidates, seed, &mut places, &mut taken) {
        return Places::new();
    }
    loop {
        let before = places.len();
        for (place, _) in places.clone() {
            for way in WAYS {
                let there = (place.0 + way.0, place.1 + way.1);
                if places.contains_key(&there) {
                    continue;
                }
                if let Some(index) = foretold(candidates, &places, place, way, &taken) {
                    places.insert(there, index);
                    taken.insert(index);
                }
            }
        }
        if places.len() == before {
            return places;
        }
    }
}

/// The seed's neighbours, by the direction of its edges; whether there is one on each edge.
fn first_neighbours(
    candidates: &[Candidate],
    seed: usize,
    places: &mut Places,
    taken: &mut BTreeSet<usize>,
) -> bool {
    let from = &candidates[seed];
    let mut found = [false; 2];
    for (axis, &edge) in from.crossing.edges.iter().enumerate() {
        for (way, turn) in [(WAYS[axis], 0.0), (WAYS[axis + 2], PI)] {
            let nearest = (candidates.iter().enumerate())
                .filter(|(index, _)| !taken.contains(index))
                .filter_map(|(index, to)| {
                    let step = to.at - from.at;
                    let off = (step.y.atan2(step.x) - edge - turn).sin_cos();
                    let is_there = off.1 > 0.0 && off.0.abs() < OFF_EDGE_RAD;
                    (is_there && from.crossing.is_opposite(&to.crossing)).then(|| (step.norm(), index))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, index)) = nearest {
                places.insert(way, index);
                taken.insert(index);
                found[axis] = true;
            }
        }
    }
    found == [true; 2]
}

/// The free candidate nearest to where the neighbours foretell one.
fn foretold(
    candidates: &[Candidate],
    places: &Places,
    place: (i32, i32),
    way: (i32, i32),
    taken: &BTreeSet<usize>,
) -> Option<usize> {
    let at = |offset: (i32, i32)| {
        let index = *places.get(&(place.0 + offset.0, place.1 + offset.1))?;
        Some(candidates[index].at)
    };
    let here = at((0, 0))?;
    let step = step_along(&at, way)?;
    let from = candidates.get(*places.get(&place)?)?;
    let wanted = here + step;
    let reach = OFF * step.norm();
    (candidates.iter().enumerate())
        .filter(|(index, to)| !taken.contains(index) && from.crossing.is_opposite(&to.crossing))
        .map(|(index, to)| ((to.at - wanted).norm(), index))
        .filter(|(off, _)| *off < reach)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, index)| index)
}

/// The step that way: the last one carried on, its change by half, or that of the lattice line beside.
fn step_along(at: &impl Fn((i32, i32)) -> Option<Vector2<f64>>, (i, j): (i32, i32)) -> Option<Vector2<f64>> {
    let here = at((0, 0))?;
    if let Some(behind) = at((-i, -j)) {
        let step = here - behind;
        let change = at((-2 * i, -2 * j)).map_or_else(Vector2::zeros, |farther| step - (behind - farther));
        return Some(step + 0.5 * change);
    }
    [(j, i), (-j, -i)]
        .into_iter()
        .find_map(|side| Some(at((side.0 + i, side.1 + j))? - at(side)?))
}

impl Lattice {
    pub(super) fn len(&self) -> usize {
        self.corners.len()
    }

    /// The same in the full picture, from one halved `times` times.
    pub(super) fn scaled(&self, times: usize) -> Self {
        let factor = f64::from(1_u32 << times.min(16));
        self.mapped(|_, corner| Some(corner.map(|value| (value + 0.5) * factor - 0.5)))
    }

    /// Moves each corner, or leaves it out.
    pub(super) fn mapped(&self, change: impl Fn((i32, i32), &Vector2<f64>) -> Option<Vector2<f64>>) -> Self {
        Self {
            corners: (self.corners.iter())
                .filter_map(|(&place, corner)| Some((place, change(place, corner)?)))
                .collect(),
        }
    }

    /// Distance to the nearest neighbour.
    pub(super) fn shortest_step(&self, place: (i32, i32)) -> Option<f64> {
        let here = self.corners.get(&place)?;
        WAYS.iter()
            .filter_map(|way| self.corners.get(&(place.0 + way.0, place.1 + way.1)))
            .map(|there| (there - here).norm())
            .min_by(f64::total_cmp)
    }

    /// Without outer lines that are mostly empty.
    pub(super) fn trimmed(mut self) -> Self {
        while let Some((low, high)) = self.bounds() {
            let lines = [(0, low.0), (0, high.0), (1, low.1), (1, high.1)];
            let length = |axis: usize| {
                let (from, to) = if axis == 0 {
                    (low.1, high.1)
                } else {
                    (low.0, high.0)
                };
                f64::from(to - from + 1)
            };
            let on = |place: &(i32, i32), axis: usize| if axis == 0 { place.0 } else { place.1 };
            let emptiest = lines
                .into_iter()
                .map(|(axis, line)| {
                    let filled = self
                        .corners
                        .keys()
                        .filter(|place| on(place, axis) == line)
                        .count();
                    #[expect(clippy::cast_precision_loss, reason = "corners of a board")]
                    let share = filled as f64 / length(axis);
                    (share, axis, line)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            match emptiest {
                Some((share, axis, line)) if share < FILLED => {
                    self.corners.retain(|place, _| on(place, axis) != line);
                }
                _ => break,
            }
        }
        self
    }

    fn bounds(&self) -> Option<((i32, i32), (i32, i32))> {
        let first = *self.corners.keys().next()?;
        Some(self.corners.keys().fold((first, first), |(low, high), place| {
            (
                (low.0.min(place.0), low.1.min(place.1)),
                (high.0.max(place.0), high.1.max(place.1)),
            )
        }))
    }

    /// Columns and rows.
    pub(super) fn extent(&self) -> (usize, usize) {
        let side = |low: i32, high: i32| usize::try_from(high - low + 1).unwrap_or(0);
        self.bounds()
            .map_or((0, 0), |(low, high)| (side(low.0, high.0), side(low.1, high.1)))
    }

    /// Corners with places from zero.
    pub(super) fn into_sightings(self) -> Vec<Sighting> {
        let low = self.bounds().map_or((0, 0), |(low, _)| low);
        (self.corners.into_iter())
            .map(|(place, pixel)| Sighting {
                place: (place.0 - low.0, place.1 - low.1),
                pixel,
            })
            .collect()
    }
}
