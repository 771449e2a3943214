//! From a drive to its replay.

use std::collections::BTreeMap;

use freespace::health::{Blame, Faults, QualityLevel};
use freespace::space::Micros;
use freespace::stage::Stage;
use freespace_platform::camera::replay::drive::{DriveFrames, RecordedDrive};
use freespace_platform::runtime::{
    FaultKind, FaultModel, FrameReport, Injection, KeyFrameReport, Observer, RecordedTimes, Setup, Victim,
    run_in_lockstep, run_modelled, run_recorded,
};
use freespace_platform::sink::mcap::{DriveRecorder, Losses, Split};
use freespace_platform::statistics::Publication;
use freespace_platform::wheels::RecordedWheels;

use crate::rig;
use crate::simulated::{self, Triangle};

/// Frame and level of a publication; faults and time from capture where an answer left: a fallback has the faults of what it
/// moved, and leaves by the publisher's timer.
type Answer = (Option<u64>, &'static str, Option<(Faults, u64)>);

/// What leaves in a drive.
#[derive(Default, PartialEq)]
struct Log {
    messages: Vec<Vec<u8>>,
    answers: Vec<Answer>,
    /// Cells of each answer, and whom it blames.
    grids: Vec<(Vec<i8>, Option<Blame>)>,
    /// Before which frame the lesson of which key frame was learnt.
    lessons: BTreeMap<u64, u64>,
}

impl Observer for Log {
    fn frame(&mut self, report: &FrameReport) {
        self.lessons
            .extend(report.learnt.map(|lesson| (report.index, lesson)));
    }

    fn publication(&mut self, publication: &Publication) {
        self.answers.push((
            publication.frame,
            publication.level.name(),
            (publication.level < QualityLevel::Moved)
                .then_some((publication.faults, publication.latency_micros)),
        ));
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        let output = report.output;
        self.grids.push((output.grid.occupancy.to_vec(), output.blame));
        self.messages.push(output.message[..output.message_len].to_vec());
    }
}

fn setup() -> Setup {
    let (camera, frames, wheels) = simulated::devices(4.0);
    simulated::setup(camera, frames, Some(wheels), Triangle::new(0..0))
}

fn replayed(drive: &RecordedDrive, frames: DriveFrames) -> Setup {
    let wheels = RecordedWheels::new(drive.wheels.clone());
    simulated::setup(
        *drive.camera(),
        Box::new(frames),
        Some(Box::new(wheels)),
        Triangle::new(0..0),
    )
}

/// Drives, recorded, and what the drive gave.
fn record(name: &str, run: impl FnOnce(Setup, &mut dyn Observer)) -> (RecordedDrive, Log) {
    let path = rig::path(name);
    let setup = setup();
    let mut recorder = DriveRecorder::open(rig::plan(&path, &setup, Split::default())).unwrap();
    let setup = rig::recorded(setup, &mut recorder);
    let mut log = Log::default();
    run(setup, &mut recorder.noted(&mut log));
    let counts = recorder.finish();
    assert_eq!(
        (counts.frames, counts.dropped_frames, counts.dropped_messages),
        (40, 0, 0)
    );
    let drive = RecordedDrive::open(&path).unwrap();
    assert!(drive.cut.is_empty(), "{:?}", drive.cut);
    assert_eq!(drive.losses, Some(Losses::default()));
    (drive, log)
}

#[test]
fn a_replay_gives_what_the_drive_gave_byte_for_byte() {
    let (drive, driven) = record("same", |setup, log| {
        run_in_lockstep(setup, log);
    });
    assert_eq!(drive.config_text, "# a drive\n");
    assert!(drive.wheels.len() > 100, "{} readings", drive.wheels.len());
    for _ in 0..2 {
        let mut again = Log::default();
        run_in_lockstep(replayed(&drive, DriveFrames::all(&drive)), &mut again);
        assert_eq!(again.answers.len(), 8);
        assert!(again.messages == driven.messages);
    }
}

#[test]
fn frames_come_back_to_the_last_bit() {
    let (drive, _) = record("frames", |setup, log| {
        run_in_lockstep(setup, log);
    });
    let (camera, mut frames, _) = simulated::devices(4.0);
    assert_eq!(*drive.camera(), camera);
    assert!(rig::frames(&mut *frames) == rig::frames(&mut DriveFrames::all(&drive)));
}

#[test]
fn recorded_times_degrade_the_replay_as_the_drive_was() {
    let mut late = 0;
    for (name, victim, kind) in [
        ("slow_map", Victim::Stage(Stage::Map), FaultKind::Slow),
        ("slow_cut", Victim::Stage(Stage::Crf), FaultKind::Slow),
        ("slow_track", Victim::Stage(Stage::Track), FaultKind::Slow),
        ("late_network", Victim::Network, FaultKind::Slow),
        ("failing_network", Victim::Network, FaultKind::Fail),
        ("hanging_network", Victim::Network, FaultKind::Hang),
    ] {
        let model = FaultModel {
            // So slow that the clock decides everything at ten times the pace.
            costs_micros: [
                (200, 0),
                (20_000, 0),
                (9_000, 6_000),
                (3_000, 0),
                (3_000, 0),
                (9_000, 6_000),
                (1_000, 0),
                (200, 0),
            ],
            network_micros: 40_000,
            injection: Some(Injection {
                victim,
                kind,
                from: Micros(900_000),
                until: Micros(2_600_000),
            }),
        };
        let (drive, driven) = record(name, |setup, log| {
            run_modelled(setup, &model, log);
        });
        let levels: Vec<_> = driven.answers.iter().map(|answer| answer.1).collect();
        assert!(levels.iter().any(|level| *level != "full"), "{name}: {levels:?}");
        let mut replays = [Log::default(), Log::default()];
        for log in &mut replays {
            let setup = replayed(&drive, DriveFrames::as_driven(&drive));
            run_recorded(setup, drive.times(), log);
        }
        assert_eq!(replays[0].answers, driven.answers, "{name}");
        // Fallbacks among them, and what builds on work that was given up or late.
        assert!(replays[0].grids == driven.grids, "{name}");
        late += drive.late_work_notes.len();
        assert!(replays[0] == replays[1], "{name}");
    }
    assert!(
        late > 3,
        "{late} key frames whose answer a fallback did not wait for"
    );
}

#[test]
fn a_lesson_is_learnt_before_the_frame_before_which_the_drive_learnt_it() {
    let (drive, driven) = record("lessons", |setup, log| {
        run_in_lockstep(setup, log);
    });
    let mut times = drive.times();
    assert_eq!(times.lessons, driven.lessons);
    assert!(times.lessons.len() >= 7, "{:?}", times.lessons);
    let replayed_at = |times: RecordedTimes| {
        let mut log = Log::default();
        run_recorded(replayed(&drive, DriveFrames::as_driven(&drive)), times, &mut log);
        log
    };
    let again = replayed_at(times.clone());
    assert_eq!(again.lessons, driven.lessons);
    // A thread that slept longer: each lesson comes two frames later, and the drive is another one.
    times.lessons = (times.lessons.iter())
        .map(|(frame, lesson)| (frame + 2, *lesson))
        .filter(|(frame, _)| *frame < 40)
        .collect();
    let later = replayed_at(times.clone());
    assert_eq!(later.lessons, times.lessons);
    assert!(later.messages != again.messages);
    assert_eq!(later.messages.len(), again.messages.len());
}
