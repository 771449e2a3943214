//! The process: its start, its ends, its clock, its disk, and a long drive.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use freespace::health::{Faults, QualityLevel};
use rustix::process::Signal;

use crate::bench::{Bench, BenchError, Rig, STANDING, command, ordinary};
use crate::case::{Case, Seen};
use crate::direct;
use crate::drive::{Ending, Script, drive, finish};
use crate::fault::CameraFault;
use crate::feed::Feed;
use crate::listener::{Heard, Listener};
use crate::module::{Log, Module};
use crate::promise::Blind;

/// A start that drives.
pub(crate) const BOOT: &[Case] = &[
    Case {
        name: "boot",
        injected: "nothing: the module starts on a running camera and bus",
        required: "a good grid within 10 s of the start, no miss in 10 s",
        is_quick: true,
        run: boot,
    },
    Case {
        name: "direct",
        injected: "nothing: a drive of 12 s is recorded",
        required: "frames as sent, grids as of a direct replay (IoU 0.98), scale within 1 %",
        is_quick: true,
        run: direct::case,
    },
];

/// Cases of the process.
pub(crate) const CASES: &[Case] = &[
    Case {
        name: "no-camera",
        injected: "the camera is there 3 s after the start only",
        required: "camera_silent is told from the start, then good grids",
        is_quick: false,
        run: no_camera,
    },
    Case {
        name: "clock-step",
        injected: "the wall clock jumps an hour ahead and back",
        required: "no fault is named",
        is_quick: true,
        run: clock_step,
    },
    Case {
        name: "sigterm",
        injected: "SIGTERM",
        required: "a last invalid message, exit code 0, within 1 s",
        is_quick: true,
        run: sigterm,
    },
    Case {
        name: "sigkill",
        injected: "SIGKILL, and a new start",
        required: "good grids again within 10 s of the new start",
        is_quick: true,
        run: sigkill,
    },
    Case {
        name: "killed-readers",
        injected: "a hundred readers of shared memory, each killed within 0.2 s of its start",
        required: "no fault is named, memory flat",
        is_quick: true,
        run: killed_readers,
    },
    Case {
        name: "disk-full",
        injected: "a recording on a disk of 2 MB",
        required: "the drive goes on, the full disk is told",
        is_quick: true,
        run: disk_full,
    },
    Case {
        name: "soak-short",
        injected: "nothing, for a minute",
        required: "no miss, memory flat, at most 2 % of the answers not good, and marked",
        is_quick: true,
        run: |rig| soak(rig, 60),
    },
    Case {
        name: "soak",
        injected: "nothing, for ten minutes",
        required: "no miss, memory flat, at most 2 % of the answers not good, and marked",
        is_quick: false,
        run: |rig| soak(rig, 600),
    },
];

fn boot(rig: &Rig) -> Result<Seen, BenchError> {
    let bench = Bench::start(rig, &[], None)?;
    let mut seen = Seen::default();
    let seconds = since(bench.started_micros, bench.first.at_micros);
    seen.note(format!("first good grid after {seconds:.2} s"));
    seen.require(seconds < 10.0, "the first good grid took longer than 10 s");
    std::thread::sleep(Duration::from_secs(10));
    all_good_since(&bench, bench.first.at_micros, &mut seen);
    finish(bench, Blind::default(), Ending::Well, seen)
}

#[expect(clippy::cast_precision_loss, reason = "seconds")]
fn since(from: u64, to: u64) -> f64 {
    to.saturating_sub(from) as f64 * 1e-6
}

fn all_good_since(bench: &Bench, from: u64, seen: &mut Seen) {
    good_since(bench, from, 0.0, seen);
}

/// No answer is a miss, and at most a share of them is not good.
fn good_since(bench: &Bench, from: u64, at_most: f64, seen: &mut Seen) {
    let heard = bench.listener.heard();
    let is_on_its_way = |heard: &&Heard| !bench.road.is_lap_new(bench.feed.seconds_at(heard.at_micros));
    let answers: Vec<_> = heard
        .iter()
        .filter(|heard| heard.at_micros >= from)
        .filter(is_on_its_way)
        .collect();
    let is_miss = |heard: &&&Heard| {
        heard.level >= QualityLevel::Moved || heard.faults.contains(Faults::DEADLINE_MISSED)
    };
    let misses = answers.iter().filter(is_miss).count();
    seen.require_in_peace(misses == 0, format!("{misses} misses"));
    let ordinary = ordinary(&answers);
    let bad: Vec<_> = answers.iter().filter(|heard| !heard.is_good(ordinary)).collect();
    let Some(first) = bad.first() else { return };
    let what = format!(
        "{} answers are not good: {} with {}",
        bad.len(),
        first.level.name(),
        crate::drive::names(first.faults)
    );
    #[expect(clippy::cast_precision_loss, reason = "counts of answers")]
    let is_rare = bad.len() as f64 <= at_most * answers.len() as f64;
    if is_rare {
        seen.note(what);
    } else {
        seen.require_in_peace(false, what);
    }
}

fn no_camera(rig: &Rig) -> Result<Seen, BenchError> {
    let road = rig.road(&[])?;
    let listener = Listener::start(&rig.interface)?;
    let feed = Feed::start(road.show()?, &rig.device, &rig.interface)?;
    feed.switches.set_camera(CameraFault::Unplugged);
    std::thread::sleep(Duration::from_millis(500));
    let started_micros = crate::clock::now_micros();
    let module = Module::start(&rig.installation, None, &rig.file("module.log"))?;
    let mut seen = Seen::default();
    let silent = listener.wait_for(Duration::from_secs(5), |heard| {
        heard.faults.contains(Faults::CAMERA_SILENT)
    });
    seen.require(silent.is_some(), "no message tells that the camera is silent");
    std::thread::sleep(Duration::from_secs(2));
    let back = crate::clock::now_micros();
    feed.switches.set_camera(CameraFault::None);
    let first = listener
        .wait_for(Duration::from_secs(5), |heard| heard.is_good(STANDING))
        .ok_or_else(|| BenchError::NoAnswer(module.last_words()))?;
    seen.recovery_s = Some(since(back, first.at_micros));
    // Its grid is still on its way, and those after it tell more.
    std::thread::sleep(Duration::from_secs(3));
    let bench = Bench {
        rig: rig.clone(),
        road,
        listener,
        feed,
        module,
        first,
        started_micros,
    };
    finish(bench, Blind::default(), Ending::Well, seen)
}

fn clock_step(rig: &Rig) -> Result<Seen, BenchError> {
    if !rig.owns_kernel {
        return Err(BenchError::Lacking(
            "the clock of a machine in use is not stepped".to_owned(),
        ));
    }
    let step = |seconds: &'static str| move |_: &mut Bench| command("date", &["-s", seconds]);
    let script = Script {
        begin: Box::new(step("+1 hour")),
        end: Box::new(step("-1 hour")),
        ..Script::default()
    };
    drive(rig, &script)
}

fn sigterm(rig: &Rig) -> Result<Seen, BenchError> {
    let bench = Bench::start(rig, &[], None)?;
    std::thread::sleep(Duration::from_secs(2));
    let begin = Instant::now();
    let mut seen = finish(bench, Blind::default(), Ending::Well, Seen::default())?;
    let seconds = begin.elapsed().as_secs_f64();
    seen.require(seconds < 1.0, format!("it took {seconds:.2} s to end"));
    Ok(seen)
}

fn sigkill(rig: &Rig) -> Result<Seen, BenchError> {
    let mut bench = Bench::start(rig, &[], None)?;
    let mut seen = Seen::default();
    std::thread::sleep(Duration::from_secs(2));
    bench.module.signal(Signal::KILL);
    bench.module.wait(Duration::from_secs(2));
    let restarted = crate::clock::now_micros();
    bench.module = Module::start(&rig.installation, None, &rig.file("module.log"))?;
    match bench
        .listener
        .wait_for(Duration::from_secs(15), |heard| heard.is_good(STANDING))
    {
        Some(heard) => {
            let seconds = since(restarted, heard.at_micros);
            seen.recovery_s = Some(seconds);
            seen.require(seconds < 10.0, format!("the first good grid took {seconds:.1} s"));
        }
        None => seen.require(false, "no good answer after the restart"),
    }
    std::thread::sleep(Duration::from_secs(2));
    finish(bench, Blind { spots: true }, Ending::Well, seen)
}

fn disk_full(rig: &Rig) -> Result<Seen, BenchError> {
    if !rig.owns_kernel {
        return Err(BenchError::Lacking(
            "no small disk is mounted on a machine in use".to_owned(),
        ));
    }
    let disk = rig.file("disk");
    std::fs::create_dir_all(&disk)?;
    let at = disk.to_string_lossy().into_owned();
    command("mount", &["-t", "tmpfs", "-o", "size=2m", "disk", &at])?;
    let record = Log {
        folder: disk.join("drive"),
        mcap: None,
    };
    let bench = Bench::start(rig, &[], Some(&record))?;
    let mut seen = Seen::default();
    std::thread::sleep(Duration::from_secs(8));
    all_good_since(&bench, bench.first.at_micros, &mut seen);
    let log = rig.file("module.log");
    // A run whose recording is lost ends with an error.
    let mut seen = finish(bench, Blind::default(), Ending::WithError, seen)?;
    let told = std::fs::read_to_string(&log)?.contains("No space left");
    seen.require(told, "the full disk is not told");
    Ok(seen)
}

fn killed_readers(rig: &Rig) -> Result<Seen, BenchError> {
    let bench = Bench::start(rig, &[], None)?;
    let mut seen = Seen::default();
    std::thread::sleep(Duration::from_secs(5));
    let before = bench.module.resident_kb();
    for life in 0..100 {
        let mut reader = Command::new(&rig.installation.program)
            .args(["monitor", "--json"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        // Anywhere in its start and its first messages.
        std::thread::sleep(Duration::from_millis(10 + life * 37 % 190));
        reader.kill()?;
        reader.wait()?;
    }
    flat_since(before, &bench, &mut seen);
    all_good_since(&bench, bench.first.at_micros, &mut seen);
    finish(bench, Blind::default(), Ending::Well, seen)
}

/// Share of a soak's answers that may be less than good, and say so: few machines leave a test alone for ten minutes.
const RARE: f64 = 0.02;
/// Growth of the resident memory that is noise, kB.
const FLAT_KB: u64 = 1024;

/// The module's resident memory has not grown.
fn flat_since(before: Option<u64>, bench: &Bench, seen: &mut Seen) {
    if let (Some(before), Some(after)) = (before, bench.module.resident_kb()) {
        let growth = after.saturating_sub(before);
        seen.note(format!("memory grew by {growth} kB of {after}"));
        seen.require(growth < FLAT_KB, format!("memory grew by {growth} kB"));
    }
}

fn soak(rig: &Rig, seconds: u64) -> Result<Seen, BenchError> {
    let bench = Bench::start(rig, &[], None)?;
    let mut seen = Seen::default();
    std::thread::sleep(Duration::from_secs(10));
    let before = bench.module.resident_kb();
    std::thread::sleep(Duration::from_secs(seconds.saturating_sub(10)));
    flat_since(before, &bench, &mut seen);
    good_since(&bench, bench.first.at_micros, RARE, &mut seen);
    finish(bench, Blind::default(), Ending::Well, seen)
}
