#![allow(clippy::unwrap_used, reason = "tests")]

use alloc::vec::Vec;

use super::*;
use crate::space::Mount;
use proptest::prelude::*;

pub(crate) fn mount() -> Mount {
    Mount {
        height_m: 1.65,
        ahead_m: 1.5,
        left_m: 0.0,
        pitch_rad: 0.02,
        yaw_rad: 0.0,
        roll_rad: 0.0,
    }
}

/// Deterministic noise in -1..1, enough for a test.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        ((self.0 >> 33) as f64 / f64::from(1u32 << 31)) * 2.0 - 1.0
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (self.next() * 0.5 + 0.5) * (high - low)
    }
}

/// Landmarks at `height_m` over a plane, in a band ahead.
fn scatter(
    plane: &Plane,
    count: usize,
    left_m: (f64, f64),
    height_m: (f64, f64),
    noise: &mut Noise,
) -> Vec<SupportPoint> {
    let ground = Ground::new(plane, &Vector3::z());
    (0..count)
        .map(|_| {
            let ahead = noise.between(4.0, 28.0);
            let on = ground.point(ahead, noise.between(left_m.0, left_m.1));
            let up = noise.between(height_m.0, height_m.1);
            // Depth noise of a short baseline: 2 % of the range.
            let stretch = 1.0 + 0.02 * noise.next();
            SupportPoint {
                point: Point3::from((on + ground.up * up).coords * stretch),
                depth_sigma_m: 0.02 * ahead as f32,
            }
        })
        .collect()
}

fn search(mount: &Mount) -> PlaneSearch {
    let filter = PlaneFilter::new(mount, &PlaneConfig::default());
    PlaneSearch {
        expected: filter.expected(),
        variance: filter.variance(),
        forward: Vector3::z(),
        curvature_per_m: 0.0,
        news: 1.0,
    }
}

fn pitched(pitch_rad: f64) -> Plane {
    Mount {
        pitch_rad: 0.02 + pitch_rad,
        ..mount()
    }
    .plane_in_camera()
}

#[test]
fn slopes_return_to_their_plane() {
    let plane = Mount {
        roll_rad: 0.02,
        yaw_rad: 0.1,
        ..mount()
    }
    .plane_in_camera();
    let back = plane_of(&slopes_of(&plane).unwrap());
    assert!((back.normal - plane.normal).norm() < 1e-12 && (back.offset_m - plane.offset_m).abs() < 1e-12);
}

#[test]
fn road_is_found_below_its_pavements_and_walls() {
    for (seed, pitch) in [(1, 0.0), (2, 0.012), (3, -0.02), (4, 0.03)] {
        let truth = pitched(pitch);
        let mut noise = Noise(seed);
        // A weakly textured road: a tenth of the landmarks.
        let mut points = scatter(&truth, 40, (-2.5, 2.5), (-0.01, 0.01), &mut noise);
        points.extend(scatter(&truth, 120, (3.5, 6.0), (0.11, 0.14), &mut noise));
        points.extend(scatter(&truth, 120, (-6.0, -3.5), (0.11, 0.14), &mut noise));
        points.extend(scatter(&truth, 100, (6.0, 6.2), (0.2, 4.0), &mut noise));
        points.extend(scatter(&truth, 30, (-8.0, 8.0), (-2.0, 3.0), &mut noise));
        let fit = find_plane(
            &points,
            &search(&mount()),
            &PlaneConfig::default(),
            &mut PlaneScratch::new(1000),
        )
        .unwrap();
        let plane = plane_of(&fit.slopes);
        assert!((plane.offset_m - 1.65).abs() < 0.04, "seed {seed}: {plane:?}");
        let at_20 = plane.ray_distance(&Vector3::new(0.0, 1.65 / 20.0 - 0.02 - pitch, 1.0));
        assert!((at_20.unwrap() - 20.0).abs() < 1.5, "seed {seed}: {at_20:?}");
    }
}

#[test]
fn few_landmarks_hold_the_plane() {
    let mut noise = Noise(5);
    let points = scatter(&pitched(0.0), 5, (-1.0, 1.0), (0.0, 0.0), &mut noise);
    let found = find_plane(
        &points,
        &search(&mount()),
        &PlaneConfig::default(),
        &mut PlaneScratch::new(100),
    );
    assert!(found.is_none());
    let mut filter = PlaneFilter::new(&mount(), &PlaneConfig::default());
    filter.predict(1000.0);
    assert!((filter.plane().offset_m - 1.65).abs() < 1e-9);
}

#[test]
fn pavement_alone_does_not_lift_the_plane_by_its_height() {
    let mut noise = Noise(6);
    let mut points = scatter(&pitched(0.0), 200, (3.5, 6.0), (0.11, 0.14), &mut noise);
    points.extend(scatter(&pitched(0.0), 12, (-1.5, 1.5), (-0.01, 0.01), &mut noise));
    let fit = find_plane(
        &points,
        &search(&mount()),
        &PlaneConfig::default(),
        &mut PlaneScratch::new(1000),
    )
    .unwrap();
    assert!(plane_of(&fit.slopes).offset_m > 1.60, "{fit:?}");
}

proptest! {
    #[test]
    fn garbage_never_panics(raw in prop::collection::vec(prop::array::uniform4(prop::num::f64::ANY), 0..60)) {
        let points: Vec<_> = raw
            .iter()
            .map(|r| SupportPoint { point: Point3::new(r[0], r[1], r[2]), depth_sigma_m: r[3] as f32 })
            .collect();
        let config = PlaneConfig::default();
        let mut scratch = PlaneScratch::new(40);
        if let Some(fit) = find_plane(&points, &search(&mount()), &config, &mut scratch) {
            prop_assert!(fit.slopes.iter().all(|v| v.is_finite()));
        }
        let _ = find_scale(&points, &search(&mount()), &config, &mut ScaleSearch::new(40), &mut scratch);
    }

    #[test]
    fn scale_is_read_from_the_camera_height(ratio in 0.4..2.5f64, seed in 0u64..1000) {
        let mut noise = Noise(seed);
        let truth = pitched(0.0);
        let mut points = scatter(&truth, 60, (-2.0, 2.0), (-0.01, 0.01), &mut noise);
        points.extend(scatter(&truth, 60, (3.5, 6.0), (0.11, 0.14), &mut noise));
        points.extend(scatter(&truth, 60, (6.0, 7.0), (0.2, 4.0), &mut noise));
        for p in &mut points {
            p.point /= ratio;
            p.depth_sigma_m /= ratio as f32;
        }
        let config = PlaneConfig::default();
        let found = find_scale(
            &points,
            &search(&mount()),
            &config,
            &mut ScaleSearch::new(300),
            &mut PlaneScratch::new(300),
        );
        let found = found.unwrap();
        prop_assert!((found.ratio / ratio - 1.0).abs() < 0.05, "{found:?} for {ratio}");
    }
}
