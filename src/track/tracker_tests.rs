//! The tracker on a rendered road between two walls.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "tests"
)]

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};

use super::rolling::Rolling;
use super::{FrameEstimate, TrackConfig, Tracker, Travel};
use crate::frame::{Camera, FrameStage, Lens, PixelFormat, RawFrame};
use crate::health::TrackingState;
use crate::map::{MapUpdate, View};
use crate::space::{Micros, Mount, Pose};

const WIDTH: usize = 320;
const HEIGHT: usize = 200;

fn camera() -> Camera {
    Camera {
        lens: Lens::pinhole(220.0, 220.0, 159.5, 90.0),
        width: WIDTH,
        height: HEIGHT,
        mount: Mount {
            height_m: 1.4,
            ahead_m: 1.5,
            left_m: 0.0,
            pitch_rad: 0.02,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        },
    }
}

/// Smooth noise of about 0.4 m.
fn texture(u: f64, v: f64) -> f64 {
    let lattice = |i: f64, j: f64| {
        let mut h = (i as i64 as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
            ^ (j as i64 as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
        h ^= h >> 29;
        h = h.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        (h >> 40) as f64 / (1u64 << 24) as f64
    };
    let (u, v) = (u / 0.4, v / 0.4);
    let (i, j) = (u.floor(), v.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (a, b) = (smooth(u - i), smooth(v - j));
    let row = |j: f64| lattice(i, j) * (1.0 - a) + lattice(i + 1.0, j) * a;
    row(j) * (1.0 - b) + row(j + 1.0) * b
}

struct Drive {
    camera: Camera,
    rolling: Rolling,
    stage: FrameStage,
    tracker: Tracker,
    truth: Pose,
    distance_m: f64,
    stamp: Micros,
    frame: u64,
}

impl Drive {
    fn new() -> Self {
        let camera = camera();
        let mut drive = Self {
            camera,
            rolling: Rolling::new(&camera.mount),
            stage: FrameStage::new(&camera),
            tracker: Tracker::new(
                &camera,
                &TrackConfig {
                    wanted_tracks: 200,
                    ..TrackConfig::default()
                },
            ),
            truth: camera.mount.vehicle_from_camera(),
            distance_m: 0.0,
            stamp: Micros(0),
            frame: 0,
        };
        drive.step(0.0, 0.0, true);
        drive
    }

    /// Road at z = 0, walls 5 m to both sides.
    fn render(&self) -> alloc::vec::Vec<u8> {
        let eye = self.truth.translation.vector;
        let mut bytes = alloc::vec![0; WIDTH * HEIGHT];
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let ray = self
                    .camera
                    .lens
                    .unproject(&Vector2::new(x as f64, y as f64))
                    .unwrap();
                let ray = self.truth.rotation * ray;
                let road = if ray.z < -1e-6 {
                    -eye.z / ray.z
                } else {
                    f64::INFINITY
                };
                let side = if ray.y > 0.0 { 5.0 } else { -5.0 };
                let wall = (side - eye.y) / ray.y;
                let t = road.min(wall).min(80.0);
                let hit = eye + ray * t;
                let luma = if road < wall {
                    texture(hit.x, hit.y)
                } else {
                    texture(hit.x + 1000.0, hit.z)
                };
                let seed = (x as u64 * 7919 + y as u64 * 104_729 + self.frame * 1_299_709)
                    .wrapping_mul(0x9E37_79B9_7F4A_7C15);
                bytes[y * WIDTH + x] = (60.0 + 130.0 * luma + (seed >> 62) as f64) as u8;
            }
        }
        bytes
    }

    fn step(&mut self, distance_m: f64, heading_rad: f64, wheels: bool) -> FrameEstimate {
        let motion = self.rolling.motion(distance_m, self.rolling.turn(heading_rad));
        self.truth *= motion;
        self.distance_m += distance_m;
        self.frame += 1;
        self.stamp = self.stamp.plus(100_000);
        let bytes = self.render();
        let raw = RawFrame {
            stamp: self.stamp,
            format: PixelFormat::Grey,
            width: WIDTH,
            height: HEIGHT,
            bytes: &bytes,
        };
        assert_eq!(self.stage.step(&raw), Ok(None));
        let travel = wheels.then_some(Travel {
            distance_m: self.distance_m,
            heading_rad: 0.0,
        });
        let plane = self.camera.mount.plane_in_camera();
        self.tracker.step(
            self.stage.previous_pyramid(),
            self.stage.pyramid(),
            self.stamp,
            travel,
            &plane,
        )
    }

    fn error_m(&self, estimate: &FrameEstimate) -> f64 {
        (estimate.world_from_camera.translation.vector - self.truth.translation.vector).norm()
    }
}

#[test]
fn a_drive_through_a_bend_is_followed() {
    let mut drive = Drive::new();
    let mut view = View::default();
    let mut views = 0;
    let mut last = drive.step(0.6, 0.0, true);
    for i in 0..16 {
        last = drive.step(0.6, if i < 8 { 0.01 } else { 0.02 }, true);
        if drive.tracker.wants_view() {
            drive.tracker.view_into(&mut view);
            views += 1;
            assert!(view.observations.len() > 50);
            assert!(view.observations.windows(2).all(|w| w[0].track < w[1].track));
        }
    }
    assert_eq!(last.state, TrackingState::Good);
    assert!(drive.error_m(&last) < 0.1, "{}", drive.error_m(&last));
    let angle = last.world_from_camera.rotation.angle_to(&drive.truth.rotation);
    assert!(angle < 0.008, "{angle}");
    assert!((4..=12).contains(&views), "{views}");
}

#[test]
fn standing_still_holds_the_pose_and_the_tracks() {
    let mut drive = Drive::new();
    drive.step(0.5, 0.0, true);
    let before = drive.step(0.5, 0.0, true);
    let _ = drive.step(0.0, 0.0, true);
    let mut held = drive.step(0.0, 0.0, true);
    for _ in 0..5 {
        held = drive.step(0.0, 0.0, true);
        assert_eq!(held.state, TrackingState::Standstill);
        assert!(!drive.tracker.wants_view());
    }
    assert!(held.tracks * 10 > before.tracks * 8);
    assert!(drive.error_m(&held) < 0.03);
}

#[test]
fn a_lost_picture_is_dead_reckoned_and_overcome() {
    let mut drive = Drive::new();
    drive.step(0.5, 0.0, true);
    drive.step(0.5, 0.0, true);
    let travel = Travel {
        distance_m: drive.distance_m + 0.3,
        heading_rad: 0.0,
    };
    let blind = drive.tracker.coast(drive.stamp.plus(50_000), Some(travel));
    assert_eq!(blind.state, TrackingState::DeadReckoning);
    assert!((drive.error_m(&blind) - 0.3).abs() < 0.05);
    let again = drive.step(0.6, 0.0, true);
    assert_eq!(again.state, TrackingState::Good);
    assert!(drive.error_m(&again) < 0.05, "{}", drive.error_m(&again));
}

/// What was matched by chance over a gap in the frames is no sighting of anything that was seen before.
#[test]
fn a_gap_in_the_frames_ends_the_tracks() {
    let mut drive = Drive::new();
    for _ in 0..4 {
        drive.step(0.6, 0.0, true);
    }
    let newest = drive.tracker.tracks().map(|(id, ..)| id).max().unwrap();
    let after = drive.step(40.0, 0.0, true);
    assert_eq!(after.state, TrackingState::DeadReckoning);
    assert!(drive.tracker.tracks().all(|(id, ..)| id > newest));
    assert!(!drive.tracker.wants_view(), "it would see nothing");
    let next = drive.step(0.6, 0.0, true);
    assert_eq!(next.state, TrackingState::Good);
    assert!(drive.tracker.wants_view());
    let mut view = View::default();
    drive.tracker.view_into(&mut view);
    assert!(view.observations.len() > 50);
    assert!(view.observations.iter().all(|seen| seen.track > newest));
}

/// Half a second is too long to carry on with the turn of the last frame, and what it had of pitch and roll.
#[test]
fn after_a_gap_the_wheels_tell_the_heading() {
    let mut drive = Drive::new();
    let mut last = drive.step(0.6, 0.02, true);
    for _ in 0..4 {
        last = drive.step(0.6, 0.02, true);
    }
    drive.stamp = drive.stamp.plus(900_000);
    // The wheels of these drives say that they go straight on.
    let after = drive.step(6.0, 0.0, true);
    assert_eq!(after.state, TrackingState::DeadReckoning);
    let turned = last
        .world_from_camera
        .rotation
        .angle_to(&after.world_from_camera.rotation);
    assert!(turned < 1e-9, "{turned}");
}

#[test]
fn a_car_that_stands_through_a_gap_keeps_its_tracks() {
    for has_wheels in [true, false] {
        let mut drive = Drive::new();
        drive.step(0.5, 0.0, has_wheels);
        let before = drive.step(0.5, 0.0, has_wheels);
        let halted = drive.step(0.0, 0.0, has_wheels);
        drive.stamp = drive.stamp.plus(4_000_000);
        let after = drive.step(0.0, 0.0, has_wheels);
        assert_eq!(after.state, TrackingState::Standstill);
        assert!(after.tracks * 10 > before.tracks * 8);
        let moved = halted.world_from_camera.inv_mul(&after.world_from_camera);
        assert!(moved.translation.vector.norm() < 1e-9, "{moved}");
    }
}

/// The map answers two frames late: the poses since are carried over, rescaled.
#[test]
fn a_late_correction_moves_the_present() {
    let mut drive = Drive::new();
    drive.step(0.6, 0.0, true);
    let asked = drive.step(0.6, 0.0, true);
    drive.step(0.6, 0.0, true);
    let present = drive.step(0.6, 0.0, true);
    let shift = Pose::from_parts(
        Vector3::new(0.3, -0.1, 0.05).into(),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.1)),
    );
    let mut update = MapUpdate {
        stamp: Some(asked.stamp),
        world_from_camera_tracked: asked.world_from_camera,
        world_from_camera: shift * asked.world_from_camera,
        rescale: 1.5,
        ..MapUpdate::default()
    };
    update
        .landmarks
        .push((super::TrackId(0), Point3::new(f64::NAN, 0.0, 0.0)))
        .unwrap();
    drive.tracker.apply(&update);
    let mut view = View::default();
    drive.tracker.view_into(&mut view);
    let before = asked.world_from_camera.inv_mul(&present.world_from_camera);
    let after = update.world_from_camera.inv_mul(&view.world_from_camera);
    assert!((after.translation.vector - before.translation.vector * 1.5).norm() < 1e-9);
    assert!(after.rotation.angle_to(&before.rotation) < 1e-9);
    // Applied again, nothing moves: the answer says where that view is.
    update.rescale = 1.0;
    drive.tracker.apply(&update);
    let pose = view.world_from_camera;
    drive.tracker.view_into(&mut view);
    assert!((pose.translation.vector - view.world_from_camera.translation.vector).norm() < 1e-9);
    // Garbage is refused.
    update.rescale = f64::NAN;
    drive.tracker.apply(&update);
    let next = drive.step(0.6, 0.0, true);
    assert!(next.world_from_camera.translation.vector.norm() < 100.0);
}

/// At a standstill the map repeats its answer at every key frame. An error of the rotation's length once doubled with each: after
/// half a minute the car was nowhere.
#[test]
fn a_long_standstill_leaves_the_pose_alone() {
    let mut drive = Drive::new();
    drive.step(0.6, 0.0, true);
    drive.step(0.6, 0.05, true);
    let mut view = View::default();
    drive.tracker.view_into(&mut view);
    let update = MapUpdate {
        stamp: Some(view.stamp),
        world_from_camera_tracked: view.world_from_camera,
        world_from_camera: view.world_from_camera,
        rescale: 1.0,
        ..MapUpdate::default()
    };
    drive.step(0.0, 0.0, true);
    let before = drive.step(0.0, 0.0, true);
    for _ in 0..200 {
        drive.tracker.apply(&update);
        drive.step(0.0, 0.0, true);
    }
    let after = drive.step(0.0, 0.0, true);
    let moved = before.world_from_camera.inv_mul(&after.world_from_camera);
    assert!(moved.translation.vector.norm() < 1e-6, "{moved}");
    assert!((after.world_from_camera.rotation.norm() - 1.0).abs() < 1e-12);
}
