#![allow(clippy::unwrap_used, reason = "tests")]
use super::super::street::{Street, WheelFault, map};
use super::*;
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;

use super::super::Observation;
use crate::budget::BATCH_VIEWS;
use crate::space::Micros;
use crate::track::{TrackId, Travel};

/// Length of the found path over the true one, and the final error in position over the distance.
fn scale_and_drift(street: &Street, found: &[Pose]) -> (f64, f64) {
    let truth = |key: usize| street.world_from_camera(4 * key + 3).translation.vector;
    let (mut along, mut true_along) = (0.0, 0.0);
    for key in 1..found.len() {
        along += (found[key].translation.vector - found[key - 1].translation.vector).norm();
        true_along += (truth(key) - truth(key - 1)).norm();
    }
    let last = found.len() - 1;
    (
        along / true_along,
        (found[last].translation.vector - truth(last)).norm() / true_along,
    )
}

#[test]
fn street_is_metric_and_does_not_drift() {
    let mut street = Street::new(5, 88);
    let mut map = map();
    let found = street.drive(&mut map, 88);
    let (scale, drift) = scale_and_drift(&street, &found);
    assert!((scale - 1.0).abs() < 0.005, "scale {scale}");
    assert!(drift < 0.005, "drift {drift}");
    assert_eq!(map.scale_state(), ScaleState::Wheels);
    assert_eq!(map.rejected_wheel_steps(), 0);
    assert!(map.landmarks().len() > 300, "{}", map.landmarks().len());
}

#[test]
fn slip_is_noticed_and_the_scale_held() {
    for ratio in [1.3, 0.0] {
        let mut street = Street::new(6, 72);
        street.fault = Some(WheelFault {
            from: 32,
            until: 40,
            ratio,
        });
        let mut map = map();
        let found = street.drive(&mut map, 72);
        let (scale, _) = scale_and_drift(&street, &found);
        assert!((scale - 1.0).abs() < 0.01, "ratio {ratio}: scale {scale}");
        assert!(
            (8..=9).contains(&map.rejected_wheel_steps()),
            "ratio {ratio}: {}",
            map.rejected_wheel_steps()
        );
        assert_eq!(map.scale_state(), ScaleState::Wheels);
    }
}

#[test]
fn stuck_encoder_leaves_the_scale_held() {
    let mut street = Street::new(7, 72);
    street.fault = Some(WheelFault {
        from: 32,
        until: 72,
        ratio: 0.0,
    });
    let mut map = map();
    let found = street.drive(&mut map, 72);
    assert_eq!(map.scale_state(), ScaleState::Held);
    let (scale, _) = scale_and_drift(&street, &found);
    assert!((scale - 1.0).abs() < 0.03, "scale {scale}");
}

#[test]
fn without_wheels_the_scale_is_the_caller_s() {
    let mut street = Street::new(8, 24);
    street.has_wheels = false;
    let mut map = map();
    street.drive(&mut map, 24);
    assert_eq!(map.scale_state(), ScaleState::Held);
    let (before, count) = (map.newest_pose(), map.landmarks().len());
    let far = (map.landmarks()[0].point_in_world.coords - before.translation.vector).norm();
    map.rescale(1.1);
    assert_eq!(map.scale_state(), ScaleState::CameraHeight);
    assert!((map.newest_pose().translation.vector - before.translation.vector).norm() < 1e-12);
    let now = (map.landmarks()[0].point_in_world.coords - before.translation.vector).norm();
    assert!((now / far - 1.1).abs() < 1e-9 && map.landmarks().len() == count);
    let mut update = alloc::boxed::Box::<MapUpdate>::default();
    map.update_into(&mut update);
    assert!((update.rescale - 1.1).abs() < 1e-12 && !update.landmarks.is_empty());
    map.update_into(&mut update);
    assert!((update.rescale - 1.0).abs() < 1e-12);
}

#[test]
fn same_input_gives_the_same_map() {
    let drive = || {
        let mut map = map();
        let found = Street::new(9, 24).drive(&mut map, 24);
        (found, map.landmarks().to_vec())
    };
    assert_eq!(drive(), drive());
}

#[test]
fn empty_batch_changes_nothing() {
    let mut map = map();
    Street::new(9, 24).drive(&mut map, 24);
    let before = map.newest_pose();
    map.insert(&ViewBatch::new());
    assert_eq!(map.newest_pose(), before);
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![8 => -2000.0..2000.0f64, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY), 1 => Just(1e300)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn garbage_never_panics(
        views in prop::collection::vec((
            prop::collection::vec((0u32..200, any_number(), any_number()), 0..150),
            prop::array::uniform6(any_number()),
            prop::option::of((any_number(), any_number())),
        ), 1..20),
        ratio in any_number(),
    ) {
        let mut map = map();
        let mut batch = ViewBatch::new();
        for (k, (observations, pose, travel)) in views.iter().enumerate() {
            let mut view = View { stamp: Micros(k as u64), ..View::default() };
            view.world_from_camera = Pose::new(Vector3::new(pose[0], pose[1], pose[2]), Vector3::new(pose[3], pose[4], pose[5]));
            view.travel = travel.map(|(distance_m, heading_rad)| Travel { distance_m, heading_rad });
            for &(track, x, y) in observations {
                view.observations.push(Observation { track: TrackId(track), pixel: Vector2::new(x as f32, y as f32) }).unwrap();
            }
            batch.push(view).unwrap();
            if batch.len() == BATCH_VIEWS || k % 3 == 0 {
                map.insert(&batch);
                batch.clear();
                while map.refine() {}
                map.finish();
                prop_assert!(is_finite(&map.newest_pose()));
            }
        }
        map.rescale(ratio);
        prop_assert!(is_finite(&map.newest_pose()));
    }
}
