//! What a user of the simulated road relies on.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "tests"
)]

use std::sync::OnceLock;

use freespace::frame::{BrownConrady, Camera, Lens, RgbImage};
use freespace::track::WheelReading;
use nalgebra::{Point3, Vector2};

use super::*;

fn textures() -> &'static Arc<Textures> {
    static TEXTURES: OnceLock<Arc<Textures>> = OnceLock::new();
    TEXTURES.get_or_init(|| Arc::new(Textures::new()))
}

fn world(seed: u64, kind: Kind) -> World {
    let config = WorldConfig {
        seed,
        kind: Some(kind),
        length_m: 200.0,
        ..WorldConfig::default()
    };
    World::new(&config, textures())
}

fn camera() -> Camera {
    Camera {
        lens: Lens::BrownConrady(BrownConrady {
            fx: 250.0,
            fy: 250.0,
            cx: 159.5,
            cy: 119.5,
            k: [-0.05, 0.0, 0.0],
            p: [0.0; 2],
        }),
        width: 320,
        height: 240,
        mount: Mount {
            height_m: 1.5,
            ahead_m: 1.2,
            left_m: 0.1,
            pitch_rad: 0.03,
            yaw_rad: 0.02,
            roll_rad: 0.01,
        },
    }
}

fn clean() -> Sensor {
    Sensor {
        read_noise: 0.0,
        shot_noise: 0.0,
        shutter_s: 0.0,
        exposure_drift: 0.0,
        vignette: 0.0,
        soft: false,
        ..Sensor::default()
    }
}

#[test]
fn same_seed_gives_same_bytes() {
    let draw = |seed, from: f64| {
        let world = world(seed, Kind::Urban);
        let mut sim = SimCamera::new(&camera(), &Sensor::default());
        let mut out = RgbImage::new(320, 240);
        sim.render(&world, from, &mut out);
        sim.render(&world, 2.5, &mut out);
        (out, sim.labels().to_vec())
    };
    let first = draw(3, 0.0);
    assert!(first == draw(3, 0.0));
    // A frame depends on its time, not on the frames before it.
    assert!(first == draw(3, 1.9));
    assert!(first != draw(4, 0.0));
}

#[test]
fn first_vehicle_pose_is_the_origin() {
    for seed in 1..6 {
        let pose = world(seed, Kind::Residential).ego(0.0).world_from_vehicle;
        assert!(pose.translation.vector.norm() < 1e-9 && pose.rotation.angle() < 1e-9);
    }
}

/// Colours agree where a road point of one frame is seen again in a later one, through depth and pose alone.
#[test]
fn depth_and_pose_reproject_between_frames() {
    let world = world(5, Kind::Residential);
    let camera = camera();
    let mut sim = SimCamera::new(&camera, &clean());
    let mut first = RgbImage::new(320, 240);
    sim.render(&world, 3.0, &mut first);
    let (depth, labels, pose) = (
        sim.depth_m().to_vec(),
        sim.labels().to_vec(),
        *sim.world_from_camera(),
    );
    let mut second = RgbImage::new(320, 240);
    sim.render(&world, 3.1, &mut second);
    let second_from_first = sim.world_from_camera().inverse() * pose;
    let (mut count, mut same_label, mut moved, mut error, mut mismatch) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for i in 0..320 * 240 {
        // Near enough that both frames resolve the same texture.
        if labels[i] != Label::Road as u8 || depth[i] > 14.0 {
            continue;
        }
        let pixel = Vector2::new((i % 320) as f64, (i / 320) as f64);
        let ray = camera.lens.unproject(&pixel).unwrap();
        let point = second_from_first * Point3::from(ray * (f64::from(depth[i]) / ray.z));
        let Some(seen) = camera.lens.project(&point.coords) else {
            continue;
        };
        if !(0.0..319.0).contains(&seen.x) || !(0.0..239.0).contains(&seen.y) {
            continue;
        }
        let j = seen.y.round() as usize * 320 + seen.x.round() as usize;
        if f64::from((sim.depth_m()[j] - point.z as f32).abs()) > 0.6 {
            continue;
        }
        let green = |image: &RgbImage, i: usize| f64::from(image.pixels()[3 * i + 1]);
        count += 1.0;
        same_label += f64::from(u8::from(sim.labels()[j] == labels[i]));
        moved += (seen - pixel).norm();
        error += (green(&first, i) - green(&second, j)).abs();
        mismatch += (green(&first, i) - green(&second, i)).abs();
    }
    assert!(
        count > 3000.0 && moved / count > 3.0,
        "{count} points moved {}",
        moved / count
    );
    assert!(same_label / count > 0.99);
    assert!(
        error / count < 0.75 * mismatch / count,
        "{} against {} unmoved",
        error / count,
        mismatch / count
    );
}

#[test]
fn road_labels_lie_on_the_plane() {
    for (seed, kind) in [
        (1, Kind::Residential),
        (2, Kind::Urban),
        (3, Kind::Rural),
        (4, Kind::Highway),
    ] {
        let world = world(seed, kind);
        let mut sim = SimCamera::new(&camera(), &clean());
        sim.render(&world, 4.0, &mut RgbImage::new(320, 240));
        let mut road = 0;
        for i in 0..320 * 240 {
            let pixel = Vector2::new((i % 320) as f64, (i / 320) as f64);
            let ray = camera().lens.unproject(&pixel).unwrap();
            let depth = f64::from(sim.depth_m()[i]);
            if sim.labels()[i] != Label::Road as u8 {
                continue;
            }
            road += 1;
            let point = sim.world_from_camera() * Point3::from(ray * (depth / ray.z));
            if depth < 40.0 {
                assert!(point.z.abs() < 0.01, "{point}");
                let (s, d) = world.road.locate(point.x, point.y);
                assert!(world.road.edge(s as f32, d as f32) < 0.1);
            }
        }
        assert!(road > 8000, "{kind:?} shows {road} pixels of road");
    }
}

#[test]
fn grid_agrees_with_the_labels() {
    let spec = GridSpec::default();
    for seed in 1..7 {
        let world = world(seed, Kind::Urban);
        let mut sim = SimCamera::new(&camera(), &clean());
        let seconds = 6.0;
        sim.render(&world, seconds, &mut RgbImage::new(320, 240));
        let grid = world.free_space_truth(&camera(), seconds, &spec);
        let vehicle = world.ego(seconds).world_from_vehicle;
        let camera_from_vehicle = sim.world_from_camera().inverse() * vehicle;
        let (mut free, mut agree) = (0, 0);
        for row in 0..spec.rows() {
            for column in 0..spec.columns() {
                let (ahead, left) = spec.centre(row, column);
                let point = camera_from_vehicle * Point3::new(ahead, left, 0.0);
                let cell = grid[row * spec.columns() + column];
                assert!([-1, 0, 100].contains(&cell));
                if cell != 0 {
                    continue;
                }
                let pixel = camera().lens.project(&point.coords).unwrap();
                let i = pixel.y.round() as usize * 320 + pixel.x.round() as usize;
                free += 1;
                agree += usize::from(sim.labels()[i] == Label::Road as u8);
            }
        }
        assert!(free > 1000, "{free} free cells");
        assert!(agree * 100 > free * 98, "{agree} of {free}");
    }
}

#[test]
fn counts_integrate_to_the_distance() {
    let world = world(2, Kind::Residential);
    let encoders = Encoders::default();
    let mut wheels = SimWheels::new(&encoders);
    let (mut last, mut total, mut wraps) = (None, [0_i64; 4], 0);
    let end = 15.0;
    for reading in wheels.readings(&world, end) {
        let WheelReading::Counts { counts, .. } = reading else {
            continue;
        };
        if let Some(before) = last.replace(counts) {
            for k in 0..4 {
                let step = (i64::from(counts[k]) - i64::from(before[k])).rem_euclid(256);
                assert!(step < 128, "never rolls back");
                wraps += u32::from(counts[k] < before[k]);
                total[k] += step;
            }
        }
    }
    assert!(wraps > 10);
    let rolled = world.ego(end).wheel_m;
    for k in 0..4 {
        let metres = total[k] as f64 * encoders.metres_per_count;
        let allowed = rolled[k] * encoders.radius_error + encoders.metres_per_count;
        assert!(
            (metres - rolled[k]).abs() <= allowed,
            "{metres} for {}",
            rolled[k]
        );
    }
    assert!(wheels.readings(&world, end).next().is_none());
}

#[test]
fn rear_wheels_differ_by_the_turn() {
    let world = world(8, Kind::Residential);
    let ego = world.ego(12.0);
    let heading = ego.world_from_vehicle.rotation.euler_angles().2;
    let [_, _, left, right] = ego.wheel_m;
    assert!(((right - left) / 1.54 - heading).abs() < 1e-3);
}

#[test]
fn slip_turns_the_wheels_further() {
    let world = world(2, Kind::Residential);
    let slips = vec![Slip {
        from_s: 4.0,
        to_s: 6.0,
        share: 0.2,
    }];
    let slipping = SimWheels::new(&Encoders {
        slips,
        modulus: 1 << 20,
        ..Encoders::default()
    });
    let rolling = SimWheels::new(&Encoders {
        modulus: 1 << 20,
        ..Encoders::default()
    });
    let difference = |number| {
        let count = |wheels: &SimWheels| match wheels.reading(&world, number) {
            WheelReading::Counts { counts, .. } => i64::from(counts[2]),
            WheelReading::Speeds { .. } => 0,
        };
        (count(&slipping) - count(&rolling)) as f64 * 0.020_312_5
    };
    let run = world.ego(6.0).distance_m - world.ego(4.0).distance_m;
    assert!(difference(100).abs() < 0.03);
    assert!((difference(400) - 0.2 * run).abs() < 0.1);
}

#[test]
fn drive_stops_and_goes_on() {
    let drive = Drive::default();
    let standing = (0..4000)
        .filter(|i| drive.at(f64::from(*i) * 0.01).1 == 0.0)
        .count();
    assert!(standing > 150, "{standing} hundredths of a second at rest");
    let mut last = 0.0;
    for i in 0..4000 {
        let (metres, speed) = drive.at(f64::from(i) * 0.01);
        assert!(metres >= last && (0.0..=drive.cruise_mps).contains(&speed));
        last = metres;
    }
    assert!(last > 200.0);
}
