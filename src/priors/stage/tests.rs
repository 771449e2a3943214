#![allow(
    clippy::unwrap_used,
    clippy::cast_sign_loss,
    clippy::cast_possible_truncation,
    reason = "tests"
)]

use alloc::vec::Vec;

use super::super::plane::tests::{Noise, mount};
use super::*;
use crate::frame::Lens;
use crate::track::TrackId;
use nalgebra::{Translation3, UnitQuaternion};

const WIDTH: usize = 240;
const HEIGHT: usize = 180;

fn camera() -> Camera {
    Camera {
        lens: Lens::pinhole(400.0, 400.0, 239.5, 150.0),
        width: 480,
        height: 360,
        mount: mount(),
    }
}

/// World space is the vehicle at the start; the car drives along x.
fn pose(driven_m: f64) -> Pose {
    Pose::from_parts(Translation3::new(driven_m, 0.0, 0.0), UnitQuaternion::identity())
        * mount().vehicle_from_camera()
}

/// A road 7 m wide between pavements, and a car at 30 m in the right half.
fn street() -> Vec<Landmark> {
    let mut noise = Noise(11);
    let mut landmarks = Vec::new();
    let mut put = |x: f64, y: f64, z: f64| {
        landmarks.push(Landmark {
            track: TrackId(landmarks.len() as u32),
            point_in_world: Point3::new(x, y, z),
            depth_sigma_m: 0.08,
            views: 3,
        });
    };
    for _ in 0..200 {
        let x = noise.between(4.0, 60.0);
        put(x, noise.between(-3.0, 3.0), noise.between(-0.01, 0.01));
        put(x, noise.between(3.6, 6.0), noise.between(0.11, 0.13));
        put(x, -noise.between(3.6, 6.0), noise.between(0.11, 0.13));
    }
    for _ in 0..80 {
        put(30.0, noise.between(-2.8, -1.0), noise.between(0.3, 1.4));
    }
    landmarks
}

fn pixel(world: Point3<f64>, world_from_camera: &Pose) -> usize {
    let p = camera()
        .lens
        .scaled(0.5, 0.5)
        .project(&(world_from_camera.inverse() * world).coords);
    let p = p.unwrap();
    p.y.round() as usize * WIDTH + p.x.round() as usize
}

#[test]
fn street_gives_plane_car_and_belief_in_the_image() {
    let mut stage = PriorsStage::new(&camera(), PriorsConfig::default(), WIDTH, HEIGHT);
    let landmarks = street();
    let (first, second) = (pose(0.0), pose(12.0));
    stage.step(&landmarks, &first, Micros(0));
    assert_eq!(stage.indicator(), stage.indicator_previous());
    assert_eq!(stage.belief(), stage.belief_previous());
    let priors = stage.step(&landmarks, &second, Micros(500_000)).clone();
    let plane = priors.plane.unwrap();
    assert!(
        plane.inliers > 50 && (plane.plane.normal - Vector3::z()).norm() < 0.01,
        "{plane:?}"
    );
    assert!(plane.plane.offset_m.abs() < 0.05);
    assert!(!priors.boxes.is_empty());

    // The union of the car's boxes covers its rear.
    let mut blocked = 0;
    for i in 0..100 {
        let (left, up) = (-2.7 + 0.16 * f64::from(i % 10), 0.1 + 0.1 * f64::from(i / 10));
        blocked +=
            u32::from(stage.surface()[pixel(Point3::new(30.0, left, up), &second)] == Surface::Box as u8);
    }
    assert!(blocked >= 90, "{blocked} of 100");
    let car = pixel(Point3::new(30.0, -1.9, 0.8), &second);
    let lane = pixel(Point3::new(24.0, 1.0, 0.0), &second);
    let pavement = pixel(Point3::new(24.0, 4.5, 0.12), &second);
    let sky = 10;
    for (name, indicator) in [
        ("now", stage.indicator()),
        ("previous", stage.indicator_previous()),
    ] {
        assert_eq!(
            [indicator[car], indicator[lane], indicator[sky]],
            [0, 1, 0],
            "{name}: car, lane, sky"
        );
    }
    for (name, belief) in [("now", stage.belief()), ("previous", stage.belief_previous())] {
        assert!(belief[lane] > 0.7, "{name} lane {}", belief[lane]);
        assert!(
            belief[pavement] < belief[lane] - 0.2,
            "{name} pavement {}",
            belief[pavement]
        );
        assert!(belief[car] < 0.1 && belief[sky] < 0.1, "{name}");
        assert!(belief.iter().all(|b| (0.0..=1.0).contains(b)), "{name}");
    }
    // The paper's indicator takes the pavement for road; the belief does not.
    assert_eq!(stage.indicator()[pavement], 1);
}

#[test]
fn without_landmarks_the_mounts_plane_is_held() {
    let mut stage = PriorsStage::new(&camera(), PriorsConfig::default(), WIDTH, HEIGHT);
    let priors = stage.step(&[], &pose(0.0), Micros(0));
    let plane = priors.plane.unwrap();
    assert_eq!(plane.inliers, 0);
    assert!(plane.plane.offset_m.abs() < 1e-9 && priors.boxes.is_empty());
    assert_eq!(
        stage.indicator()[pixel(Point3::new(15.0, 0.0, 0.0), &pose(0.0))],
        1
    );
}

#[test]
fn the_plane_of_a_standing_car_stays() {
    let mut stage = PriorsStage::new(&camera(), PriorsConfig::default(), WIDTH, HEIGHT);
    // Errors that all landmarks share: the road seems 6 cm higher than the mount has it.
    let mut landmarks = street();
    for landmark in &mut landmarks {
        landmark.point_in_world.z += 0.06;
    }
    let height_m = |stage: &PriorsStage| stage.plane_in_camera().offset_m;
    let mut key_frame = 0;
    let mut step = |stage: &mut PriorsStage, driven_m: f64| {
        stage.step(&landmarks, &pose(driven_m), Micros(500_000 * key_frame));
        key_frame += 1;
    };
    step(&mut stage, 0.0);
    let arrived_m = height_m(&stage);
    for _ in 0..60 {
        step(&mut stage, 0.0);
    }
    let stood_m = height_m(&stage);
    assert!((stood_m - arrived_m).abs() < 1e-6, "{arrived_m} {stood_m}");
    for metres in 1..=8 {
        step(&mut stage, 2.0 * f64::from(metres));
    }
    assert!(
        height_m(&stage) < stood_m - 0.005,
        "driving goes on learning: {stood_m} {}",
        height_m(&stage)
    );
}

#[test]
fn without_a_fresh_map_the_last_priors_are_seen_from_the_new_pose() {
    let mut stage = PriorsStage::new(&camera(), PriorsConfig::default(), WIDTH, HEIGHT);
    stage.step(&street(), &pose(0.0), Micros(0));
    let boxes = stage.priors().boxes.clone();
    for key_frame in 1..4u32 {
        let here = pose(4.0 * f64::from(key_frame));
        let held = stage.hold(&here, Micros(500_000 * u64::from(key_frame)));
        assert_eq!(
            (held.boxes.clone(), held.plane.unwrap().inliers),
            (boxes.clone(), 0)
        );
        let (car, lane) = (Point3::new(30.0, -1.9, 0.8), Point3::new(24.0, 1.0, 0.0));
        assert_eq!(stage.surface()[pixel(car, &here)], Surface::Box as u8);
        assert!(stage.belief()[pixel(lane, &here)] > 0.7);
        assert!((stage.plane_in_camera().offset_m - 1.65).abs() < 0.05);
    }
}

#[test]
fn same_steps_give_the_same_bytes() {
    let run = || {
        let mut stage = PriorsStage::new(&camera(), PriorsConfig::default(), WIDTH, HEIGHT);
        for key_frame in 0..3 {
            stage.step(
                &street(),
                &pose(5.0 * f64::from(key_frame)),
                Micros(500_000 * key_frame as u64),
            );
        }
        (
            stage.indicator().to_vec(),
            stage.belief().to_vec(),
            stage.priors().boxes.clone(),
        )
    };
    assert_eq!(run(), run());
}

#[test]
fn curvature_is_read_from_the_poses() {
    let mut stage = PriorsStage::new(&camera(), PriorsConfig::default(), WIDTH, HEIGHT);
    let mut last = 0.0;
    for key_frame in 0..8u32 {
        // A left turn of 40 m radius.
        let turned = 5.0 * f64::from(key_frame) / 40.0;
        let vehicle = Pose::from_parts(
            Translation3::new(40.0 * turned.sin(), 40.0 * (1.0 - turned.cos()), 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned),
        );
        stage.step(
            &[],
            &(vehicle * mount().vehicle_from_camera()),
            Micros(500_000 * u64::from(key_frame)),
        );
        last = stage.curvature_per_m();
    }
    assert!((last - 1.0 / 40.0).abs() < 0.004, "{last}");
}

#[test]
fn garbage_landmarks_do_no_harm() {
    let mut stage = PriorsStage::new(&camera(), PriorsConfig::default(), WIDTH, HEIGHT);
    let mut landmarks = street();
    for (index, landmark) in landmarks.iter_mut().enumerate() {
        match index % 9 {
            0 => landmark.point_in_world.x = f64::NAN,
            1 => landmark.depth_sigma_m = f32::NAN,
            2 => landmark.point_in_world.z = 1e300,
            3 => landmark.depth_sigma_m = -1.0,
            _ => {}
        }
    }
    let priors = stage.step(&landmarks, &pose(0.0), Micros(0));
    assert!(priors.plane.unwrap().inliers > 20);
    assert!(stage.belief().iter().all(|b| b.is_finite()));
}
