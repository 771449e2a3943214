#![allow(clippy::unwrap_used, reason = "tests")]

use super::*;
use crate::runtime::allocation::RealTimeScope;

fn publication(level: QualityLevel, latency_micros: u64) -> Publication {
    let mut times = StageTimes::default();
    if level == QualityLevel::Full {
        times.add(Stage::Map, latency_micros / 10);
    }
    times.add(Stage::Emit, 100);
    Publication {
        frame: Some(0),
        stamp: Micros(0),
        level,
        faults: Faults::NONE.with(Faults::DEADLINE_MISSED, level == QualityLevel::Moved),
        scale: ScaleState::Wheels,
        times,
        cuts: Cuts::default(),
        latency_micros,
        is_miss: level == QualityLevel::Moved,
        blame: None,
    }
}

fn drive() -> DriveStatistics {
    let mut statistics = DriveStatistics::new();
    for _ in 0..9 {
        statistics.publication(&publication(QualityLevel::Full, 80_000));
        statistics.frame(TrackingState::Good);
    }
    statistics.publication(&publication(QualityLevel::Moved, 480_000));
    statistics.frame(TrackingState::Weak);
    statistics.frame_micros(9_000);
    statistics
}

#[test]
fn a_fallback_adds_no_times_of_stages_that_did_not_run() {
    let stages = drive().stages_ms();
    assert_eq!(stages.len(), 2);
    assert_eq!((stages[0].0, stages[0].1.p50), ("map", 8.0));
    assert_eq!(stages[1].0, "emit");
}

#[test]
fn counts_are_by_name() {
    let statistics = drive();
    assert_eq!(statistics.levels().0, [("full", 9), ("moved", 1)]);
    assert_eq!(statistics.faults().0, [("deadline_missed", 1)]);
    assert_eq!(statistics.tracking().0, [("good", 9), ("weak", 1)]);
    assert_eq!(statistics.scale().0, [("wheels", 10)]);
    assert_eq!(statistics.frame_ms().unwrap().max, 9.0);
    let json = serde_json::to_string(&statistics.levels()).unwrap();
    assert_eq!(json, r#"{"full":9,"moved":1}"#);
}

#[test]
fn a_miss_counts_for_whoever_is_blamed() {
    let mut statistics = drive();
    assert_eq!(statistics.misses_by_stage().0, [("unknown", 1)]);
    for blame in [Blame::Stage(Stage::Crf), Blame::Camera] {
        statistics.publication(&Publication {
            blame: Some(blame),
            ..publication(QualityLevel::Moved, 480_000)
        });
    }
    // Less than full, but no miss.
    statistics.publication(&Publication {
        blame: Some(Blame::Stage(Stage::Map)),
        ..publication(QualityLevel::NoRefinement, 80_000)
    });
    assert_eq!(
        statistics.misses_by_stage().0,
        [("crf", 1), ("camera", 1), ("unknown", 1)]
    );
}

#[test]
fn recording_takes_no_memory() {
    let mut statistics = DriveStatistics::new();
    let scope = RealTimeScope::enter();
    for micros in (0..70_000_000).step_by(70_000) {
        statistics.frame(TrackingState::Good);
        statistics.frame_micros(micros);
        statistics.publication(&publication(QualityLevel::Full, micros));
    }
    assert_eq!(scope.allocations(), 0);
}

#[test]
fn the_status_is_one_line() {
    let mut statistics = drive();
    statistics.set_drops(Drops {
        camera: Some(2),
        hand_over: None,
        unobserved: Some(1),
        unreported: Some(0),
        unanswered: Some(0),
        late: Some(3),
        rejected_views: None,
    });
    assert_eq!(
        statistics.status().to_string(),
        "10 key frames, 1 misses, capture to publish p50 80 p99 480 max 480 ms, full 9, moved 1, 10 frames, 2 dropped, 3 late"
    );
    assert_eq!(
        DriveStatistics::new().status().to_string(),
        "0 key frames, 0 misses, 0 frames, 0 dropped"
    );
}

#[test]
fn names_of_states_follow_their_numbers() {
    for (number, name) in [(0, "dead_reckoning"), (1, "good"), (2, "standstill"), (3, "weak")] {
        let state = TrackingState::from_wire(number).unwrap();
        let mut statistics = DriveStatistics::new();
        statistics.frame(state);
        assert_eq!(statistics.tracking().0, [(name, 1)]);
        assert_eq!(format!("{state:?}").to_lowercase(), name.replace('_', ""));
    }
    for (number, name) in summary::SCALE.into_iter().enumerate() {
        let state = ScaleState::from_wire(u8::try_from(number).unwrap()).unwrap();
        assert_eq!(format!("{state:?}").to_lowercase(), name.replace('_', ""));
    }
}
