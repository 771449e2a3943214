//! The last key frame's probabilities seen from here: the ladder's level "no fresh network".
//!
//! In: [`RoadProbability`] of the previous key frame, the rays and lens of the same resolution, the road plane in current
//! camera space and `previous_from_current`. Out: [`RoadProbability`] of the current frame.
//!
//! A pixel whose ray meets the plane takes the previous probability of that road point (the plane's homography, lens
//! distortion included); any other is taken to be far away, so that only the rotation moves it. What was not in view is
//! undecided. Cost: one projection a pixel.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "pixel arithmetic: coordinates are checked against the image before they are cast"
)]

use nalgebra::{Vector2, Vector3};

use super::RoadProbability;
use crate::frame::{Lens, RayTable};
use crate::space::{Plane, Pose};

/// Plane hits farther than this are as good as at infinity, and the plane is not flat that far.
const FAR_M: f64 = 200.0;

/// Moves `previous` into the current camera; `keep` (0 to 1) is how much of its certainty is left.
///
/// # Panics
/// Where the sizes of `previous`, `rays` and `current` differ.
pub fn reproject(
    previous: &RoadProbability,
    rays: &RayTable,
    lens: &Lens,
    plane_in_current: &Plane,
    previous_from_current: &Pose,
    keep: f32,
    current: &mut RoadProbability,
) {
    let (width, height) = (rays.width(), rays.height());
    assert!(previous.width() == width && previous.height() == height);
    assert!(current.width() == width && current.height() == height);
    let keep = keep.clamp(0.0, 1.0);
    for (p, ray) in rays.rays().iter().enumerate() {
        let ray: Vector3<f64> = ray.cast();
        let in_previous = match plane_in_current.ray_distance(&ray) {
            Some(distance) if distance > 0.0 && distance < FAR_M => {
                previous_from_current.rotation * (ray * distance) + previous_from_current.translation.vector
            }
            _ => previous_from_current.rotation * ray,
        };
        let sample = lens
            .project(&in_previous)
            .and_then(|pixel| weights(&pixel, width, height));
        let (road, not_road) = sample.map_or((0.5, 0.5), |(at, [a, b, c, d])| {
            let mix = |plane: &[f32]| {
                a * plane[at] + b * plane[at + 1] + c * plane[at + width] + d * plane[at + width + 1]
            };
            (mix(&previous.road), mix(&previous.not_road))
        });
        current.road[p] = 0.5 + keep * (road - 0.5);
        current.not_road[p] = 0.5 + keep * (not_road - 0.5);
    }
}

/// Top-left pixel and bilinear weights of a place; none outside the image.
fn weights(pixel: &Vector2<f64>, width: usize, height: usize) -> Option<(usize, [f32; 4])> {
    // Half a pixel beyond the outer centres still belongs to the image.
    let inside = |at: f64, size: usize| at >= -0.5 && at <= size as f64 - 0.5 && size >= 2;
    if !inside(pixel.x, width) || !inside(pixel.y, height) {
        return None;
    }
    let split = |at: f64, size: usize| {
        let at = at.clamp(0.0, (size - 1) as f64);
        let first = (at as usize).min(size - 2);
        (first, (at - first as f64) as f32)
    };
    let ((x, u), (y, v)) = (split(pixel.x, width), split(pixel.y, height));
    let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
    Some((y * width + x, weights))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Mount;
    use nalgebra::{Point3, Translation3, UnitQuaternion};

    #[test]
    fn a_mark_on_the_road_moves_with_the_car() {
        let (width, height) = (160, 120);
        let lens = Lens::pinhole(130.0, 130.0, 79.5, 59.5);
        let rays = RayTable::new(&lens, width, height);
        let mount = Mount {
            height_m: 1.5,
            ahead_m: 0.0,
            left_m: 0.0,
            pitch_rad: 0.05,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        };
        let plane = mount.plane_in_camera();
        // Road is where the ground is at most 2 m left or right of the first camera.
        let is_road = |ray: &Vector3<f64>, camera: &Pose| {
            plane.ray_distance(ray).is_some_and(|distance| {
                let point = camera * Point3::from(ray * distance);
                distance < 60.0 && point.x.abs() < 2.0
            })
        };
        let mut previous = RoadProbability::new(width, height);
        for (p, ray) in rays.rays().iter().enumerate() {
            previous.road[p] = f32::from(u8::from(is_road(&ray.cast(), &Pose::identity())));
            previous.not_road[p] = 1.0 - previous.road[p];
        }
        // 3 m ahead along the road and turned a little about the road's normal: the plane keeps its place in the camera.
        let up = nalgebra::Unit::new_normalize(plane.normal);
        let turn = UnitQuaternion::from_axis_angle(&up, 0.03);
        let ahead = Vector3::z() - plane.normal * plane.normal.z;
        let previous_from_current = Pose::from_parts(Translation3::from(ahead.normalize() * 3.0), turn);
        let mut current = RoadProbability::new(width, height);
        reproject(
            &previous,
            &rays,
            &lens,
            &plane,
            &previous_from_current,
            1.0,
            &mut current,
        );
        let (mut right, mut wrong) = (0, 0);
        for (p, ray) in rays.rays().iter().enumerate() {
            let expected = is_road(&ray.cast(), &previous_from_current);
            if (current.road[p] - 0.5).abs() > 0.3 && p / width > 66 {
                if (current.road[p] > 0.5) == expected {
                    right += 1
                } else {
                    wrong += 1
                }
            }
        }
        assert!(right > 50 * wrong && right > 3000, "{right} {wrong}");
    }

    #[test]
    fn standing_still_changes_nothing() {
        let lens = Lens::pinhole(60.0, 60.0, 31.5, 23.5);
        let rays = RayTable::new(&lens, 64, 48);
        let mut previous = RoadProbability::new(64, 48);
        for (p, road) in previous.road.iter_mut().enumerate() {
            *road = (p * 37 % 101) as f32 / 101.0;
        }
        let plane = Plane {
            normal: -Vector3::y(),
            offset_m: 1.5,
        };
        let mut current = RoadProbability::new(64, 48);
        reproject(
            &previous,
            &rays,
            &lens,
            &plane,
            &Pose::identity(),
            1.0,
            &mut current,
        );
        for p in 0..64 * 48 {
            assert!((current.road[p] - previous.road[p]).abs() < 1e-3);
        }
    }
}
