//! Each stage in turn made ten times slower, hung, failing and panicking, and each device too, on the simulated clock: what is
//! published for each key frame is a snapshot. `UPDATE_SNAPSHOTS=1 cargo test --test faults` writes it anew.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod simulated;

use std::fmt::Write as _;
use std::sync::Arc;

use freespace::frame::Camera;
use freespace::health::{Faults, QualityLevel};
use freespace::port::{CameraAnswer, CameraPort, FrameBuffer, WheelPort};
use freespace::space::Micros;
use freespace::stage::Stage;
use freespace::track::WheelReading;
use freespace_platform::runtime::{
    FaultKind, FaultModel, FrameReport, Injection, KeyFrameReport, Observer, Victim, run_modelled,
};
use simulated::Triangle;

const SECONDS: f64 = 5.5;
const KEY_FRAMES: usize = 11;
const DEADLINE_MICROS: u64 = 500_000;

/// Frames and readings of one drive, to be driven again and again.
struct Drive {
    camera: Camera,
    frames: Arc<Vec<FrameBuffer>>,
    readings: Arc<Vec<WheelReading>>,
}

impl Drive {
    fn recorded() -> Self {
        let (camera, mut frames, mut wheels) = simulated::devices(SECONDS);
        let mut recorded = Vec::new();
        loop {
            let mut buffer = FrameBuffer::default();
            if frames.next_frame(&mut buffer) == CameraAnswer::End {
                break;
            }
            recorded.push(buffer);
        }
        let mut readings = Vec::new();
        wheels.readings_until(Micros(10_000_000), &mut |reading| readings.push(reading));
        Self {
            camera,
            frames: Arc::new(recorded),
            readings: Arc::new(readings),
        }
    }

    fn run(&self, injection: Option<Injection>) -> Log {
        let frames = Frames {
            frames: Arc::clone(&self.frames),
            next: 0,
        };
        let wheels = Wheels {
            readings: Arc::clone(&self.readings),
            next: 0,
        };
        let setup = simulated::setup(
            self.camera,
            Box::new(frames),
            Some(Box::new(wheels)),
            Triangle::new(0..0),
        );
        let model = FaultModel {
            injection,
            ..FaultModel::default()
        };
        let mut log = Log::default();
        run_modelled(setup, &model, &mut log);
        log
    }
}

struct Frames {
    frames: Arc<Vec<FrameBuffer>>,
    next: usize,
}

impl CameraPort for Frames {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let Some(frame) = self.frames.get(self.next) else {
            return CameraAnswer::End;
        };
        self.next += 1;
        buffer.clone_from(frame);
        CameraAnswer::Frame
    }
}

struct Wheels {
    readings: Arc<Vec<WheelReading>>,
    next: usize,
}

impl WheelPort for Wheels {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        while let Some(reading) = self
            .readings
            .get(self.next)
            .filter(|reading| reading.stamp() <= until)
        {
            take(*reading);
            self.next += 1;
        }
    }
}

/// One publication.
struct Row {
    stamp: Micros,
    level: QualityLevel,
    blame: &'static str,
    latency_micros: u64,
    /// From the capture of what the grid shows to its publication.
    age_micros: Option<u64>,
    faults: Faults,
    free_cells: usize,
    /// How far down the camera looks on the road that was found.
    pitch_rad: f64,
}

#[derive(Default)]
struct Log {
    rows: Vec<Row>,
    last_answer: Option<Micros>,
}

impl Observer for Log {
    fn frame(&mut self, _report: &FrameReport) {}

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        let output = report.output;
        if output.level < QualityLevel::Moved {
            self.last_answer = Some(output.stamp);
        }
        let published = output.stamp.plus(output.latency_micros);
        self.rows.push(Row {
            stamp: output.stamp,
            level: output.level,
            blame: output.blame.map_or("-", |blame| blame.name()),
            latency_micros: output.latency_micros,
            age_micros: self
                .last_answer
                .filter(|_| output.level != QualityLevel::Invalid)
                .map(|answer| published.since(answer)),
            faults: output.faults,
            pitch_rad: (-output.plane_in_camera.normal.z).asin(),
            free_cells: output
                .grid
                .occupancy
                .iter()
                .filter(|cell| (0..=35).contains(*cell))
                .count(),
        });
    }
}

impl Row {
    /// Whether nothing but what is seen lowers the level: the first key frame has no map yet, and in pictures this small there
    /// is not always a plane.
    fn is_undisturbed(&self) -> bool {
        let (lowest, seen) = if self.stamp == Micros(0) {
            let first = Faults::PLANE_HELD | Faults::SCALE_HELD | Faults::WHEELS_SILENT;
            (QualityLevel::NoFreshMap, first)
        } else {
            (QualityLevel::NoRefinement, Faults::PLANE_HELD)
        };
        self.level <= lowest && seen.contains(self.faults)
    }
}

impl Log {
    /// The key frames that a fault lowered, a line each.
    fn table(&self) -> String {
        let mut table = String::new();
        for row in self.rows.iter().filter(|row| !row.is_undisturbed()) {
            let age = row
                .age_micros
                .map_or_else(|| "-".to_owned(), |age| (age / 1000).to_string());
            // Whether a plane is found hangs on what is seen, not on the fault.
            let mut faults = row.faults;
            faults.remove(Faults::PLANE_HELD);
            let faults: Vec<&str> = faults.names().collect();
            writeln!(
                table,
                "  {:>5} ms  {:<16}  blame {:<12}  out after {:>3} ms  age {:>4} ms  {}",
                row.stamp.0 / 1000,
                row.level.name(),
                row.blame,
                row.latency_micros / 1000,
                age,
                faults.join(" ")
            )
            .unwrap();
        }
        let undisturbed = self.rows.iter().filter(|row| row.is_undisturbed()).count();
        writeln!(table, "  undisturbed: {undisturbed} of {}", self.rows.len()).unwrap();
        table
    }
}

fn scenarios() -> Vec<(String, Injection)> {
    let stages = Stage::ALL.map(|stage| (stage.name(), Victim::Stage(stage)));
    let devices = [
        ("network", Victim::Network),
        ("camera", Victim::Camera),
        ("wheels", Victim::Wheels),
    ];
    let kinds = [
        ("ten times slower", FaultKind::Slow),
        ("hung", FaultKind::Hang),
        ("failing", FaultKind::Fail),
        ("panicking", FaultKind::Panic),
    ];
    let victims = stages.into_iter().chain(devices);
    victims
        .flat_map(|victim| kinds.map(|kind| (victim, kind)))
        // Encoders are silent or they are not.
        .filter(|((_, victim), (_, kind))| *victim != Victim::Wheels || *kind == FaultKind::Hang)
        .map(|((name, victim), (how, kind))| {
            let injection = Injection {
                victim,
                kind,
                from: Micros(1_450_000),
                until: Micros(2_450_000),
            };
            (format!("{name} {how}, 1450 to 2450 ms"), injection)
        })
        .collect()
}

#[test]
fn whatever_is_hit_every_key_frame_is_answered_in_time_and_says_how_well() {
    let drive = Drive::recorded();
    let undisturbed = drive.run(None);
    assert!(
        undisturbed.rows.iter().all(Row::is_undisturbed),
        "{}",
        undisturbed.table()
    );
    let mut table = format!("undisturbed\n{}", undisturbed.table());
    for (name, injection) in scenarios() {
        let log = drive.run(Some(injection));
        write!(table, "\n{name}\n{}", log.table()).unwrap();
        check(&name, &injection, &log);
    }
    compare("tests/snapshots/faults.txt", &table);
}

/// What was matched by chance over a gap in the frames must not tilt the road: a degree moves what stands at 15 m by 3 m.
#[test]
fn after_a_gap_in_the_frames_the_road_lies_where_it_lay() {
    let drive = Drive::recorded();
    let mount_rad = drive.camera.mount.pitch_rad;
    for gap_micros in [500_000, 700_000, 1_000_000, 1_500_000] {
        for from_micros in (1_950_000..=3_000_000).step_by(150_000) {
            let injection = Injection {
                victim: Victim::Camera,
                kind: FaultKind::Hang,
                from: Micros(from_micros),
                until: Micros(from_micros + gap_micros),
            };
            let log = drive.run(Some(injection));
            let last = log.rows.last().unwrap();
            assert!(last.level <= QualityLevel::NoRefinement, "{}", log.table());
            for row in log
                .rows
                .iter()
                .filter(|row| row.level <= QualityLevel::NoRefinement)
            {
                let tilt_deg = (row.pitch_rad - mount_rad).to_degrees();
                assert!(
                    tilt_deg.abs() < 0.8,
                    "{from_micros} us, for {gap_micros}: {tilt_deg:.2} at {}",
                    row.stamp.0
                );
            }
        }
    }
}

/// What holds for every fault.
fn check(name: &str, injection: &Injection, log: &Log) {
    for row in &log.rows {
        assert!(row.latency_micros <= DEADLINE_MICROS, "{name}\n{}", log.table());
        if row.level == QualityLevel::Invalid {
            assert_eq!(row.free_cells, 0, "{name}: an invalid grid shows nothing free");
        }
        assert_eq!(
            row.level == QualityLevel::Full,
            row.blame == "-",
            "{name}: less than full has someone to blame\n{}",
            log.table()
        );
    }
    // The one thread that must not hang is the publisher's own: its supervisor ends the process.
    if injection.victim == Victim::Stage(Stage::Emit) && injection.kind == FaultKind::Hang {
        return;
    }
    let mut instants: Vec<u64> = log.rows.iter().map(|row| row.stamp.0 / DEADLINE_MICROS).collect();
    instants.dedup();
    assert!(
        instants.into_iter().eq(0..KEY_FRAMES as u64),
        "{name}: an answer for every key frame\n{}",
        log.table()
    );
    let recovers =
        injection.kind != FaultKind::Hang || matches!(injection.victim, Victim::Camera | Victim::Wheels);
    if recovers {
        let last = log.rows.last().unwrap();
        assert!(last.is_undisturbed(), "{name} recovers\n{}", log.table());
    }
}

fn compare(path: &str, text: &str) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::write(&path, text).unwrap();
        return;
    }
    let kept = std::fs::read_to_string(&path).unwrap_or_default();
    let difference = kept.lines().zip(text.lines()).find(|(kept, new)| kept != new);
    assert!(
        kept == text,
        "{} differs, first at {difference:?}; UPDATE_SNAPSHOTS=1 writes it anew",
        path.display()
    );
}
