//! Boxes around the landmarks above the road.
//!
//! In: landmarks in camera space, the road's [`Ground`]. Out: at most [`MAX_BOXES`] boxes in camera space, standing on the
//! road. Invariant: a box holds at least `min_points` landmarks and is no longer than `max_extent_m` while there is room to
//! split; the same landmarks give the same boxes. Cost: [`CLUSTER_PASSES`] times landmarks times clusters. Full: landmarks
//! beyond the scratch are left out, clusters beyond [`MAX_BOXES`] are not split.
//! Source: "We have used K-means clustering with large enough value of K"; boxes along the PCA axes in the road plane.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "cluster numbers are below MAX_BOXES, metres fit f32"
)]

use alloc::boxed::Box;
use alloc::vec;

use nalgebra::{Matrix3, Vector3};
#[allow(
    unused_imports,
    reason = "float methods come from std where that feature is on"
)]
use num_traits::Float as _;

use super::ObstacleBox;
use super::ground::Ground;
use super::plane::SupportPoint;
use crate::budget::{CLUSTER_PASSES, MAX_BOXES};

/// How boxes are made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Deserialize),
    serde(default, deny_unknown_fields)
)]
pub struct BoxConfig {
    /// Lower landmarks may be road.
    pub lowest_m: f32,
    /// Higher landmarks stand over the road, not on it.
    pub highest_m: f32,
    /// A cluster wholly above this lets the car pass below it.
    pub clearance_m: f32,
    /// Farther landmarks are left out.
    pub range_m: f32,
    /// Landmarks less certain than this share of their range are left out.
    pub depth_sigma_share: f32,
    /// Longer boxes are split, so that a wall does not reach over the road.
    pub max_extent_m: f32,
    /// A cluster with a wider gap is split there.
    pub gap_m: f32,
    /// Fewer landmarks than this make no box.
    pub min_points: u32,
    /// Landmarks a cluster starts from; sets k.
    pub points_per_cluster: u32,
    /// Weight of height against ground distance between landmarks.
    pub height_weight: f32,
    /// Share of the landmarks trimmed at either end of each axis.
    pub trim: f32,
}

impl Default for BoxConfig {
    fn default() -> Self {
        Self {
            lowest_m: 0.25,
            highest_m: 3.5,
            clearance_m: 2.2,
            range_m: 40.0,
            depth_sigma_share: 0.08,
            max_extent_m: 4.0,
            gap_m: 1.5,
            min_points: 3,
            points_per_cluster: 16,
            height_weight: 0.15,
            trim: 0.05,
        }
    }
}

/// A landmark on the ground frame: ahead, left, height.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    ahead_m: f32,
    left_m: f32,
    height_m: f32,
    cluster: u8,
}

#[derive(Clone, Copy, Debug, Default)]
struct Centre {
    ahead_m: f32,
    left_m: f32,
    height_m: f32,
}

/// Extent of a cluster along its axes.
struct Shape {
    axis: (f32, f32),
    low_m: [f32; 2],
    high_m: [f32; 2],
    bottom_m: f32,
    top_m: f32,
    /// Where to split: along the axis, or across it.
    split: Option<(usize, f32)>,
}

/// Clusters landmarks and boxes the clusters.
#[derive(Clone, Debug)]
pub struct BoxBuilder {
    config: BoxConfig,
    places: Box<[Place]>,
    nearest: Box<[f32]>,
    along: Box<[f32]>,
    left_out: u64,
}

impl BoxBuilder {
    /// Memory for `landmarks` landmarks above the road.
    #[must_use]
    pub fn new(config: BoxConfig, landmarks: usize) -> Self {
        Self {
            config,
            places: vec![Place::default(); landmarks].into_boxed_slice(),
            nearest: vec![0.0; landmarks].into_boxed_slice(),
            along: vec![0.0; landmarks].into_boxed_slice(),
            left_out: 0,
        }
    }

    /// Landmarks above the road that found no room, ever.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Boxes of the landmarks that stand on the road plane.
    pub fn build(
        &mut self,
        points: &[SupportPoint],
        ground: &Ground,
        boxes: &mut heapless::Vec<ObstacleBox, MAX_BOXES>,
    ) {
        boxes.clear();
        let count = self.gather(points, ground);
        if count < self.config.min_points as usize {
            return;
        }
        let mut clusters = self.cluster(count);
        // Clusters split off land at the end of the list and are looked at again: at most MAX_BOXES rounds of splits.
        let mut index = 0;
        let mut splits = 0;
        while index < clusters {
            let Some(shape) = self.shape(count, index as u8) else {
                index += 1;
                continue;
            };
            if let Some((axis, at_m)) = shape.split
                && clusters < MAX_BOXES
                && splits < MAX_BOXES
            {
                self.split(count, index as u8, clusters as u8, &shape, axis, at_m);
                clusters += 1;
                splits += 1;
                continue;
            }
            if shape.bottom_m < self.config.clearance_m {
                // Cannot be full: there are at most MAX_BOXES clusters.
                let _ = boxes.push(boxed(&shape, ground));
            }
            index += 1;
        }
    }

    fn gather(&mut self, points: &[SupportPoint], ground: &Ground) -> usize {
        let config = &self.config;
        let mut count = 0;
        for support in points {
            let (ahead, left) = ground.coordinates(&support.point);
            let height_m = ground.up.dot(&(support.point - ground.foot)) as f32;
            let (ahead_m, left_m) = (ahead as f32, left as f32);
            let range_m = ahead_m.hypot(left_m);
            let stands = height_m >= config.lowest_m && height_m <= config.highest_m;
            let certain = support.depth_sigma_m <= config.depth_sigma_share * range_m;
            if !(stands && certain && ahead_m > 0.5 && range_m <= config.range_m) {
                continue;
            }
            if count == self.places.len() {
                self.left_out += 1;
                continue;
            }
            self.places[count] = Place {
                ahead_m,
                left_m,
                height_m: height_m * config.height_weight,
                cluster: 0,
            };
            count += 1;
        }
        count
    }

    /// k-means; returns k. Half of the boxes are kept for splits.
    fn cluster(&mut self, count: usize) -> usize {
        let per_cluster = self.config.points_per_cluster.max(1) as usize;
        let k = count.div_ceil(per_cluster).clamp(1, MAX_BOXES / 2);
        let mut centres = [Centre::default(); MAX_BOXES / 2];
        self.seed(count, &mut centres[..k]);
        for _ in 0..CLUSTER_PASSES {
            let mut sums = [(Centre::default(), 0.0f32); MAX_BOXES / 2];
            for place in &mut self.places[..count] {
                let mut best = f32::INFINITY;
                for (index, centre) in centres[..k].iter().enumerate() {
                    let distance = squared(place, centre);
                    if distance < best {
                        best = distance;
                        place.cluster = index as u8;
                    }
                }
                let (sum, members) = &mut sums[place.cluster as usize];
                sum.ahead_m += place.ahead_m;
                sum.left_m += place.left_m;
                sum.height_m += place.height_m;
                *members += 1.0;
            }
            for (centre, (sum, members)) in centres[..k].iter_mut().zip(&sums) {
                if *members > 0.0 {
                    centre.ahead_m = sum.ahead_m / members;
                    centre.left_m = sum.left_m / members;
                    centre.height_m = sum.height_m / members;
                }
            }
        }
        k
    }

    /// k-means++ (Arthur and Vassilvitskii 2007) with a fixed seed.
    fn seed(&mut self, count: usize, centres: &mut [Centre]) {
        let mut state = 0x2545_f491_u32;
        self.nearest[..count].fill(f32::INFINITY);
        let mut chosen = 0;
        for centre in centres {
            let place = self.places[chosen];
            *centre = Centre {
                ahead_m: place.ahead_m,
                left_m: place.left_m,
                height_m: place.height_m,
            };
            let mut total = 0.0f32;
            for (nearest, place) in self.nearest[..count].iter_mut().zip(&self.places[..count]) {
                *nearest = nearest.min(squared(place, centre));
                total += *nearest;
            }
            // xorshift32 (Marsaglia 2003).
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            let mut left = total * (state >> 8) as f32 / (1u32 << 24) as f32;
            chosen = count - 1;
            for (index, nearest) in self.nearest[..count].iter().enumerate() {
                left -= nearest;
                if left <= 0.0 {
                    chosen = index;
                    break;
                }
            }
        }
    }

    /// Principal axes and trimmed extent of a cluster; none where it has too few landmarks.
    fn shape(&mut self, count: usize, cluster: u8) -> Option<Shape> {
        let config = self.config;
        let places = &self.places[..count];
        let members = || places.iter().filter(move |p| p.cluster == cluster);
        let number = members().count();
        if number < config.min_points as usize {
            return None;
        }
        let n = number as f32;
        let (mut ahead, mut left) = (0.0, 0.0);
        for p in members() {
            ahead += p.ahead_m / n;
            left += p.left_m / n;
        }
        let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
        for p in members() {
            let (a, b) = (p.ahead_m - ahead, p.left_m - left);
            aa += a * a;
            ab += a * b;
            bb += b * b;
        }
        // The larger eigenvector of a symmetric 2x2 matrix.
        let angle = 0.5 * (2.0 * ab).atan2(aa - bb);
        let (sin, cos) = angle.sin_cos();
        let trimmed = ((n * config.trim) as usize).min((number - 1) / 2);
        let mut shape = Shape {
            axis: (cos, sin),
            low_m: [0.0; 2],
            high_m: [0.0; 2],
            bottom_m: 0.0,
            top_m: 0.0,
            split: None,
        };
        let mut widest_gap_m = config.gap_m;
        for axis in 0..2 {
            for (along, p) in self.along.iter_mut().zip(members()) {
                *along = if axis == 0 {
                    p.ahead_m * cos + p.left_m * sin
                } else {
                    p.left_m * cos - p.ahead_m * sin
                };
            }
            let along = &mut self.along[..number];
            along.sort_unstable_by(f32::total_cmp);
            (shape.low_m[axis], shape.high_m[axis]) = (along[trimmed], along[number - 1 - trimmed]);
            for pair in along.windows(2) {
                if pair[1] - pair[0] > widest_gap_m {
                    widest_gap_m = pair[1] - pair[0];
                    shape.split = Some((axis, 0.5 * (pair[0] + pair[1])));
                }
            }
            // A cluster's landmarks lie inside what they sample: the range of n uniform samples falls short of it by 1/(n-1) at
            // either end. Without this, the clusters of one object leave gaps between them.
            let short_m = (shape.high_m[axis] - shape.low_m[axis]) / (n - 1.0).max(1.0);
            let too_long = shape.high_m[axis] - shape.low_m[axis] > config.max_extent_m;
            if too_long && shape.split.is_none() {
                shape.split = Some((axis, 0.5 * (shape.low_m[axis] + shape.high_m[axis])));
            }
            shape.low_m[axis] -= short_m;
            shape.high_m[axis] += short_m;
        }
        for (along, p) in self.along.iter_mut().zip(members()) {
            *along = p.height_m / config.height_weight.max(1e-3);
        }
        let heights = &mut self.along[..number];
        heights.sort_unstable_by(f32::total_cmp);
        (shape.bottom_m, shape.top_m) = (heights[trimmed], heights[number - 1 - trimmed]);
        Some(shape)
    }

    /// Moves the part of a cluster beyond `at_m` along an axis into a new cluster.
    fn split(&mut self, count: usize, cluster: u8, new: u8, shape: &Shape, axis: usize, at_m: f32) {
        let (cos, sin) = shape.axis;
        for p in self.places[..count].iter_mut().filter(|p| p.cluster == cluster) {
            let along = if axis == 0 {
                p.ahead_m * cos + p.left_m * sin
            } else {
                p.left_m * cos - p.ahead_m * sin
            };
            if along > at_m {
                p.cluster = new;
            }
        }
    }
}

fn squared(place: &Place, centre: &Centre) -> f32 {
    let (a, b) = (place.ahead_m - centre.ahead_m, place.left_m - centre.left_m);
    let c = place.height_m - centre.height_m;
    a * a + b * b + c * c
}

/// A thin pole is at least this wide to either side.
const MIN_HALF_M: f64 = 0.1;

/// The box of a shape, extended down to the road.
fn boxed(shape: &Shape, ground: &Ground) -> ObstacleBox {
    let (cos, sin) = (f64::from(shape.axis.0), f64::from(shape.axis.1));
    let along = ground.ahead * cos + ground.left * sin;
    let across = ground.left * cos - ground.ahead * sin;
    let middle = |axis: usize| 0.5 * f64::from(shape.low_m[axis] + shape.high_m[axis]);
    let half = |axis: usize| (0.5 * f64::from(shape.high_m[axis] - shape.low_m[axis])).max(MIN_HALF_M);
    let half_height = 0.5 * f64::from(shape.top_m);
    ObstacleBox {
        centre: ground.foot + along * middle(0) + across * middle(1) + ground.up * half_height,
        axes: Matrix3::from_columns(&[along, across, ground.up]),
        half_m: Vector3::new(half(0), half(1), half_height),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::priors::plane::tests::{Noise, mount};
    use crate::priors::vehicle_forward;
    use alloc::vec::Vec;
    use nalgebra::Point3;

    fn ground() -> Ground {
        Ground::new(&mount().plane_in_camera(), &vehicle_forward(&mount()))
    }

    fn points(count: usize, mut at: impl FnMut(usize) -> (f64, f64, f64)) -> Vec<SupportPoint> {
        let ground = ground();
        (0..count)
            .map(|i| {
                let (ahead, left, height) = at(i);
                SupportPoint {
                    point: ground.point(ahead, left) + ground.up * height,
                    depth_sigma_m: 0.1,
                }
            })
            .collect()
    }

    fn build(points: &[SupportPoint]) -> heapless::Vec<ObstacleBox, MAX_BOXES> {
        let mut boxes = heapless::Vec::new();
        BoxBuilder::new(BoxConfig::default(), 1000).build(points, &ground(), &mut boxes);
        boxes
    }

    /// Whether some box stands on a place of the road.
    fn covered(boxes: &[ObstacleBox], ahead: f64, left: f64, height: f64) -> bool {
        let p = ground().point(ahead, left) + ground().up * height;
        boxes.iter().any(|b| {
            let local = b.axes.transpose() * (p - b.centre);
            (0..3).all(|i| local[i].abs() <= b.half_m[i] + 1e-6)
        })
    }

    #[test]
    fn car_is_enclosed_down_to_the_road() {
        let mut noise = Noise(1);
        // The rear and the left side of a car at 12 m, as a camera sees it.
        let car = points(60, |i| {
            if i % 2 == 0 {
                (12.0, noise.between(-3.8, -2.0), noise.between(0.3, 1.4))
            } else {
                (noise.between(12.0, 16.2), -2.0, noise.between(0.3, 1.4))
            }
        });
        let boxes = build(&car);
        let inside = car.iter().filter(|s| {
            let (ahead, left) = ground().coordinates(&s.point);
            covered(&boxes, ahead, left, 0.05)
        });
        assert!(inside.count() >= 50);
        assert!(!covered(&boxes, 12.0, 0.0, 0.3) && !covered(&boxes, 9.0, -3.0, 0.3));
    }

    #[test]
    fn lane_beside_a_long_wall_stays_free() {
        let mut noise = Noise(2);
        // A wall that bends with the road, and a fence on the other side.
        let mut wall = points(200, |_| {
            let ahead = noise.between(4.0, 38.0);
            (ahead, -4.0 - 0.006 * ahead * ahead, noise.between(0.3, 3.0))
        });
        wall.extend(points(60, |i| (4.0 + 0.5 * i as f64, 5.0, 0.8)));
        let boxes = build(&wall);
        for step in 0..66 {
            let ahead = 4.0 + 0.5 * f64::from(step);
            for left in [-2.5, -1.0, 0.0, 2.0, 4.0] {
                assert!(!covered(&boxes, ahead, left, 0.2), "{ahead} {left}");
            }
        }
        assert!(boxes.iter().all(|b| b.half_m.x <= 2.6 && b.half_m.y <= 2.6));
        assert!(boxes.len() > 8);
    }

    #[test]
    fn what_hangs_over_the_road_does_not_block_it() {
        let mut noise = Noise(3);
        let branch = points(30, |_| {
            (
                noise.between(10.0, 13.0),
                noise.between(-2.0, 2.0),
                noise.between(2.5, 3.4),
            )
        });
        assert!(build(&branch).is_empty());
    }

    #[test]
    fn too_few_uncertain_or_broken_landmarks_make_no_box() {
        assert!(build(&points(2, |_| (10.0, 0.0, 1.0))).is_empty());
        let mut far = points(30, |_| (10.0, 0.0, 1.0));
        for p in &mut far {
            p.depth_sigma_m = 3.0;
        }
        assert!(build(&far).is_empty());
        for p in &mut far {
            p.point = Point3::new(f64::NAN, f64::INFINITY, 1.0);
            p.depth_sigma_m = f32::NAN;
        }
        assert!(build(&far).is_empty());
    }

    #[test]
    fn same_landmarks_give_the_same_boxes() {
        let mut noise = Noise(4);
        let crowd = points(700, |_| {
            (
                noise.between(3.0, 39.0),
                noise.between(-10.0, 10.0),
                noise.between(0.3, 2.0),
            )
        });
        let (first, again) = (build(&crowd), build(&crowd));
        assert_eq!(first, again);
        assert!(first.len() <= MAX_BOXES);
    }
}
