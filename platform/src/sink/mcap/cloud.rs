//! The map's landmarks as a point cloud.
//!
//! In: an answer's landmarks, world space, metres. Out: `foxglove.PointCloud` in the frame `world`: x, y, z, the standard
//! deviation along the ray of the latest view, and the views that see it. Cost: [`STRIDE`] bytes a landmark.

use foxglove::schemas::packed_element_field::NumericType;
use foxglove::schemas::{PackedElementField, PointCloud, Pose, Quaternion, Vector3};
use freespace::map::Landmark;
use freespace::space::Micros;

use super::note::timestamp;

/// Fields of a point with their offsets.
const FIELDS: [(&str, u32, NumericType); 5] = [
    ("x", 0, NumericType::Float32),
    ("y", 4, NumericType::Float32),
    ("z", 8, NumericType::Float32),
    ("depth_sigma_m", 12, NumericType::Float32),
    ("views", 16, NumericType::Uint8),
];
/// Bytes of a point.
const STRIDE: usize = 17;

/// The landmarks of the map at `stamp`.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a stride; the schema's points are single precision"
)]
pub(super) fn cloud(landmarks: &[Landmark], stamp: Micros) -> PointCloud {
    let mut data = Vec::with_capacity(landmarks.len() * STRIDE);
    for landmark in landmarks {
        let point = landmark.point_in_world.cast::<f32>();
        for value in [point.x, point.y, point.z, landmark.depth_sigma_m] {
            data.extend_from_slice(&value.to_le_bytes());
        }
        data.push(landmark.views);
    }
    PointCloud {
        timestamp: timestamp(stamp),
        frame_id: "world".to_owned(),
        pose: Some(Pose {
            position: Some(Vector3::default()),
            orientation: Some(Quaternion {
                w: 1.0,
                ..Quaternion::default()
            }),
        }),
        point_stride: STRIDE as u32,
        fields: FIELDS
            .map(|(name, offset, kind)| PackedElementField {
                name: name.to_owned(),
                offset,
                r#type: kind as i32,
            })
            .to_vec(),
        data: data.into(),
    }
}

#[cfg(test)]
mod tests {
    use freespace::track::TrackId;
    use nalgebra::Point3;

    use super::*;

    #[test]
    fn points_lie_where_their_fields_say() {
        let landmark = |x: f64, views| Landmark {
            track: TrackId(7),
            point_in_world: Point3::new(x, -2.5, 0.25),
            depth_sigma_m: 0.5,
            views,
        };
        let cloud = cloud(&[landmark(1.5, 3), landmark(1000.5, 9)], Micros(1_500_000));
        assert_eq!(cloud.data.len(), 2 * cloud.point_stride as usize);
        let second = &cloud.data[STRIDE..];
        let number = |offset: usize| f32::from_le_bytes([0, 1, 2, 3].map(|k| second[offset + k]));
        let values: Vec<f32> = FIELDS[..4].iter().map(|field| number(field.1 as usize)).collect();
        assert_eq!(values, [1000.5, -2.5, 0.25, 0.5]);
        assert_eq!(second[FIELDS[4].1 as usize], 9);
    }
}
