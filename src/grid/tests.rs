#![allow(
    clippy::unwrap_used,
    clippy::cast_sign_loss,
    clippy::cast_possible_truncation,
    reason = "tests"
)]

use alloc::vec;
use alloc::vec::Vec;

use super::*;
use crate::frame::{Camera, Lens, RayTable};
use crate::priors::{Ground, Surface, vehicle_forward};
use crate::space::{Micros, Mount, Plane, Pose};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

const WIDTH: usize = 480;
const HEIGHT: usize = 360;

fn camera(yaw_rad: f64) -> Camera {
    Camera {
        lens: Lens::pinhole(400.0, 400.0, 239.5, 160.0),
        width: WIDTH,
        height: HEIGHT,
        mount: Mount {
            height_m: 1.5,
            ahead_m: 1.8,
            left_m: 0.1,
            pitch_rad: 0.03,
            yaw_rad,
            roll_rad: 0.0,
        },
    }
}

/// Labels and surfaces of a scene given by what lies at vehicle coordinates on the ground.
fn picture(camera: &Camera, at: impl Fn(f64, f64) -> (u8, Surface)) -> (Vec<u8>, Vec<f32>, Vec<u8>) {
    let rays = RayTable::new(&camera.lens, WIDTH, HEIGHT);
    let plane = camera.mount.plane_in_camera();
    let ground = Ground::new(&plane, &vehicle_forward(&camera.mount));
    let (mut labels, mut surfaces) = (Vec::new(), Vec::new());
    for ray in rays.rays() {
        let ray: Vector3<f64> = ray.cast();
        let (label, surface) = match plane.ray_distance(&ray) {
            Some(d) if d < 60.0 => {
                let (ahead, left) = ground.coordinates(&Point3::from(ray * d));
                at(ahead + camera.mount.ahead_m, left + camera.mount.left_m)
            }
            _ => (0, Surface::Nothing),
        };
        labels.push(label);
        surfaces.push(surface as u8);
    }
    let confidence = labels.iter().map(|&l| if l == 1 { 0.95 } else { 0.05 }).collect();
    (labels, confidence, surfaces)
}

fn straight_road(_: f64, y: f64) -> (u8, Surface) {
    (u8::from(y.abs() < 3.5), Surface::Plane)
}

fn driven(x_m: f64, yaw_rad: f64) -> Pose {
    Pose::from_parts(
        Translation3::new(x_m, 0.0, 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad),
    )
}

fn stage_with(camera: &Camera, at: impl Fn(f64, f64) -> (u8, Surface)) -> GridStage {
    let mut stage = GridStage::new(camera, GridConfig::default(), WIDTH, HEIGHT);
    look(&mut stage, camera, at, &Pose::identity(), 1_000_000);
    stage
}

fn look(
    stage: &mut GridStage,
    camera: &Camera,
    at: impl Fn(f64, f64) -> (u8, Surface),
    pose: &Pose,
    micros: u64,
) {
    let (labels, confidence, surface) = picture(camera, at);
    let plane = camera.mount.plane_in_camera();
    stage.step(
        &labels,
        &confidence,
        &vec![0.0; labels.len()],
        &surface,
        &plane,
        pose,
        Micros(micros),
    );
}

#[test]
fn straight_road_is_a_free_rectangle() {
    // A yawed camera must not turn the grid.
    for yaw_rad in [0.0, 0.08, -0.05] {
        let camera = camera(yaw_rad);
        let stage = stage_with(&camera, straight_road);
        let grid = stage.grid();
        for x_m in [10.0, 12.0, 16.0, 20.0] {
            let (row, _) = grid.cell_at(x_m, 0.0).unwrap();
            let free: Vec<f32> = (0..grid.columns)
                .filter(|&column| grid.is_free(row, column))
                .map(|column| grid.centre(row, column).1)
                .collect();
            let half_m = 0.5 * grid.cell_m;
            let (right, left) = (free[0] - half_m, free[free.len() - 1] + half_m);
            assert!(
                (right + 3.5).abs() <= 0.2 && (left - 3.5).abs() <= 0.2,
                "{x_m}: {right} {left}"
            );
            assert_eq!(free.len(), ((left - right) / grid.cell_m).round() as usize);
        }
    }
}

#[test]
fn unseen_is_never_free() {
    let camera = camera(0.0);
    let stage = stage_with(&camera, straight_road);
    let grid = stage.grid();
    for cell in 0..grid.rows * grid.columns {
        if grid.is_free(cell / grid.columns, cell % grid.columns) {
            assert_eq!(grid.reason[cell], Reason::Plane as u8);
        }
        if grid.reason[cell] == Reason::Unseen as u8 {
            assert_eq!(grid.occupancy[cell], -1);
        }
    }
    // Beside the field of view and under the bonnet nothing was seen.
    for (x_m, y_m) in [(2.0, 3.0), (0.5, 0.0), (5.0, 10.0)] {
        let (row, column) = grid.cell_at(x_m, y_m).unwrap();
        assert_eq!(grid.occupancy[row * grid.columns + column], -1, "{x_m} {y_m}");
    }
}

#[test]
fn pavement_is_occupied() {
    let camera = camera(0.0);
    let stage = stage_with(&camera, straight_road);
    let grid = stage.grid();
    let at = |x_m, y_m| {
        let (row, column) = grid.cell_at(x_m, y_m).unwrap();
        grid.occupancy[row * grid.columns + column]
    };
    assert!(at(12.0, 4.2) > 65);
    assert!(at(12.0, -4.2) > 65);
}

/// Every ray that would meet the ground behind 15 m within a lane ends at a box.
fn blocked_lane(x: f64, y: f64) -> (u8, Surface) {
    if x > 15.0 && y.abs() < 1.5 {
        (0, Surface::Box)
    } else {
        straight_road(x, y)
    }
}

#[test]
fn behind_a_box_is_unknown_even_where_it_was_free() {
    let camera = camera(0.0);
    let mut stage = stage_with(&camera, straight_road);
    look(&mut stage, &camera, straight_road, &Pose::identity(), 1_500_000);
    look(&mut stage, &camera, blocked_lane, &Pose::identity(), 2_000_000);
    let grid = stage.grid();
    let (row, column) = grid.cell_at(15.1, 0.1).unwrap();
    assert!(grid.occupancy[row * grid.columns + column] > 65);
    assert_eq!(grid.reason[row * grid.columns + column], Reason::Box as u8);
    let (row, column) = grid.cell_at(20.0, 0.1).unwrap();
    assert_eq!(grid.occupancy[row * grid.columns + column], -1);
    let ahead = stage.boundary().free_m[crate::budget::SECTORS / 2];
    assert!((14.0..=15.2).contains(&ahead), "{ahead}");
}

#[test]
fn ground_under_the_bonnet_keeps_what_was_seen_before() {
    let camera = camera(0.0);
    let mut stage = stage_with(&camera, straight_road);
    look(&mut stage, &camera, straight_road, &driven(7.0, 0.0), 1_500_000);
    // Three metres ahead of the rear axle: below the image, seen from 7 m back.
    let (row, column) = stage.grid().cell_at(3.1, 0.1).unwrap();
    assert!(stage.grid().is_free(row, column));
    assert_eq!(
        stage.grid().reason[row * stage.grid().columns + column],
        Reason::Previous as u8
    );
}

#[test]
fn grid_moves_with_the_car() {
    let camera = camera(0.0);
    let mut stage = stage_with(&camera, |x, y| {
        if (14.0..15.0).contains(&x) && y.abs() < 3.5 {
            (0, Surface::Plane)
        } else {
            straight_road(x, y)
        }
    });
    // Five metres on, turned left by 0.2 rad, nothing new seen.
    stage.carry(&driven(5.0, 0.2), Micros(1_200_000));
    let grid = stage.grid();
    let at = |x_m: f32, y_m: f32| {
        // World to vehicle.
        let (dx, dy) = (x_m - 5.0, y_m);
        let (sin, cos) = 0.2f32.sin_cos();
        let (row, column) = grid.cell_at(cos * dx + sin * dy, cos * dy - sin * dx).unwrap();
        grid.occupancy[row * grid.columns + column]
    };
    assert!(at(14.5, 0.0) > 65, "{}", at(14.5, 0.0));
    assert!((0..=35).contains(&at(12.5, 1.0)), "{}", at(12.5, 1.0));
    assert!((0..=35).contains(&at(12.5, -2.0)));
}

#[test]
fn age_makes_unknown() {
    let camera = camera(0.0);
    let mut stage = stage_with(&camera, straight_road);
    let (row, column) = stage.grid().cell_at(12.0, 0.0).unwrap();
    let index = row * stage.grid().columns + column;
    assert_eq!(stage.grid().age[index], 0);
    stage.carry(&Pose::identity(), Micros(1_500_000));
    assert_eq!(stage.grid().age[index], 5);
    assert_eq!(stage.grid().reason[index], Reason::Previous as u8);
    stage.carry(&Pose::identity(), Micros(7_000_000));
    assert!(stage.grid().occupancy.iter().all(|&o| o == -1));
    assert!(stage.boundary().free_m.iter().all(|&m| m == 0.0));
}

#[test]
fn an_obstacle_in_a_free_cell_wins_at_once() {
    let camera = camera(0.0);
    let mut stage = stage_with(&camera, straight_road);
    for i in 1..6 {
        look(
            &mut stage,
            &camera,
            straight_road,
            &Pose::identity(),
            1_000_000 + i * 500_000,
        );
    }
    let blocked = |x: f64, y: f64| {
        if (12.0..13.0).contains(&x) {
            (0, Surface::Plane)
        } else {
            straight_road(x, y)
        }
    };
    look(&mut stage, &camera, blocked, &Pose::identity(), 4_000_000);
    let (row, column) = stage.grid().cell_at(12.5, 0.0).unwrap();
    assert!(!stage.grid().is_free(row, column));
    assert!(stage.grid().occupancy[row * stage.grid().columns + column] > 50);
}

#[test]
fn garbage_is_not_free() {
    let camera = camera(0.0);
    let mut stage = GridStage::new(&camera, GridConfig::default(), WIDTH, HEIGHT);
    let nan = Plane {
        normal: Vector3::new(f64::NAN, -1.0, 0.0),
        offset_m: 1.5,
    };
    let pixels = WIDTH * HEIGHT;
    let (labels, confidence, surface) = (vec![1; pixels], vec![f32::NAN; pixels], vec![1; pixels]);
    let vehicle = vec![0.0; labels.len()];
    stage.step(
        &labels,
        &confidence,
        &vehicle,
        &surface,
        &nan,
        &Pose::identity(),
        Micros(1),
    );
    assert!(stage.grid().occupancy.iter().all(|&o| o == -1));
    stage.step(
        &labels[1..],
        &confidence,
        &vehicle,
        &surface,
        &camera.mount.plane_in_camera(),
        &driven(f64::NAN, 0.0),
        Micros(2),
    );
    assert!(stage.grid().occupancy.iter().all(|&o| o == -1));
}
