//! The map allocates in its constructor only.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use freespace::frame::{Camera, Lens};
use freespace::map::{Map, MapConfig, MapUpdate, Observation, View, ViewBatch};
use freespace::space::{Micros, Mount, Pose};
use freespace::track::{TrackId, Travel};
use nalgebra::Point3;

struct Counting;

thread_local! {
    /// Of this thread alone: the test harness has its own.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed on to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn camera() -> Camera {
    Camera {
        lens: Lens::pinhole(720.0, 720.0, 620.0, 187.0),
        width: 1242,
        height: 375,
        mount: Mount {
            height_m: 1.65,
            ahead_m: 1.7,
            left_m: 0.0,
            pitch_rad: 0.0,
            yaw_rad: 0.0,
            roll_rad: 0.0,
        },
    }
}

/// Straight ahead past posts on both sides of a road, one view each 1.2 m.
fn view(k: u32) -> View {
    let distance_m = 1.2 * f64::from(k);
    let vehicle = Pose::translation(distance_m, 0.0, 0.0);
    let world_from_camera = vehicle * camera().mount.vehicle_from_camera();
    let mut view = View {
        stamp: Micros(u64::from(k) * 100_000),
        world_from_camera,
        travel: Some(Travel {
            distance_m,
            heading_rad: 0.0,
        }),
        ..View::default()
    };
    for p in 0..6000_u32 {
        let place = f64::from(p);
        let point = Point3::new(
            place * 0.03,
            9.0 * (place * 0.618).fract() - 4.5,
            3.0 * (place * 0.414).fract(),
        );
        let in_camera = world_from_camera.inverse() * point;
        let Some(pixel) = camera().lens.project(&in_camera.coords) else {
            continue;
        };
        let is_seen = (3.0..40.0).contains(&in_camera.z)
            && (0.0..1242.0).contains(&pixel.x)
            && (0.0..375.0).contains(&pixel.y);
        if is_seen
            && view
                .observations
                .push(Observation {
                    track: TrackId(p),
                    pixel: pixel.cast(),
                })
                .is_err()
        {
            break;
        }
    }
    view
}

#[test]
fn steps_of_the_map_allocate_nothing() {
    let mut map = Map::new(&camera(), &MapConfig::default());
    let mut update = Box::<MapUpdate>::default();
    let mut batch = ViewBatch::new();
    for k in 0..40 {
        batch.push(view(k)).unwrap();
        if batch.len() == 4 {
            let before = ALLOCATIONS.get();
            map.insert(&batch);
            while map.refine() {}
            map.finish();
            map.update_into(&mut update);
            assert_eq!(ALLOCATIONS.get() - before, 0, "views to {k}");
            batch.clear();
        }
    }
    assert!(map.landmarks().len() > 300, "{}", map.landmarks().len());
}
