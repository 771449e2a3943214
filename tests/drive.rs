//! A short simulated drive through the whole pipeline, on one thread: reproducible, without an allocation after the start.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod simulated;

use freespace::health::Faults;
use freespace_platform::runtime::allocation::CountingAllocator;
use freespace_platform::runtime::{FrameReport, KeyFrameReport, Observer, RunSummary, run_in_lockstep};
use simulated::Triangle;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Everything that a run gave, as bytes.
#[derive(Default, PartialEq)]
struct Log {
    poses: Vec<String>,
    messages: Vec<Vec<u8>>,
    masks: Vec<Vec<u8>>,
    levels: Vec<&'static str>,
    planes_held: Vec<bool>,
    free_cells: Vec<usize>,
}

impl Observer for Log {
    fn frame(&mut self, report: &FrameReport) {
        self.poses
            .push(format!("{:?}", report.outcome.estimate.world_from_camera));
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        let output = report.output;
        self.messages.push(output.message[..output.message_len].to_vec());
        self.masks.push(output.labels.to_vec());
        self.levels.push(output.level.name());
        self.planes_held.push(output.faults.contains(Faults::PLANE_HELD));
        self.free_cells.push(
            output
                .grid
                .occupancy
                .iter()
                .filter(|cell| (0..=35).contains(*cell))
                .count(),
        );
    }
}

const SECONDS: f64 = 4.0;

fn drive(failing: std::ops::Range<u32>, has_wheels: bool) -> (Log, RunSummary) {
    let (camera, frames, wheels) = simulated::devices(SECONDS);
    let setup = simulated::setup(
        camera,
        frames,
        has_wheels.then_some(wheels),
        Triangle::new(failing),
    );
    let mut log = Log::default();
    let summary = run_in_lockstep(setup, &mut log);
    (log, summary)
}

#[test]
fn a_drive_allocates_nothing_after_the_start_and_answers_every_key_frame() {
    let (log, summary) = drive(0..0, true);
    assert!(freespace_platform::runtime::allocation::is_installed());
    assert_eq!(summary.allocations_after_start, 0);
    assert_eq!(
        (summary.frames, summary.key_frames, summary.dropped_frames),
        (40, 8, 0)
    );
    // There is no map yet, and then, in pictures this small, not always a plane: a level is full where all of it is fresh.
    assert_eq!(log.levels[0], "no_fresh_map");
    let (levels, held) = (&log.levels[1..], &log.planes_held[1..]);
    for (level, is_held) in levels.iter().zip(held) {
        let expected = if *is_held { "no_refinement" } else { "full" };
        assert_eq!(*level, expected, "{levels:?}");
    }
    assert!(levels.contains(&"full"), "{levels:?}");
    assert!(
        log.free_cells.iter().all(|cells| *cells > 500),
        "{:?}",
        log.free_cells
    );
}

#[test]
fn the_same_drive_gives_the_same_bytes() {
    let (first, _) = drive(0..0, true);
    let (second, _) = drive(0..0, true);
    assert!(first == second);
}

#[test]
fn a_failing_network_lowers_the_level_and_no_more() {
    let (log, summary) = drive(2..4, true);
    assert_eq!(summary.key_frames, 8);
    let stale = log
        .levels
        .iter()
        .enumerate()
        .filter(|(_, level)| **level == "no_fresh_network");
    assert_eq!(stale.map(|(index, _)| index).collect::<Vec<_>>(), [2, 3]);
    assert!(
        log.free_cells[3] > 100,
        "the last probabilities, moved, still show road: {:?}",
        log.free_cells
    );
}

#[test]
fn without_wheels_every_key_frame_is_answered_too() {
    let (log, summary) = drive(0..0, false);
    assert_eq!((summary.key_frames, log.messages.len()), (8, 8));
    assert_eq!(summary.allocations_after_start, 0);
}

/// A key frame each frame, so that a thousand of them do not take all day.
#[test]
fn a_thousand_key_frames_allocate_nothing() {
    let (camera, frames, wheels) = simulated::devices(100.0);
    let mut setup = simulated::setup(camera, frames, Some(wheels), Triangle::new(0..0));
    setup.config.cadence = freespace::pipeline::Cadence::Micros(100_000);
    let mut log = Log::default();
    let summary = run_in_lockstep(setup, &mut log);
    assert_eq!(summary.key_frames, 1_000);
    assert_eq!(summary.allocations_after_start, 0);
}
