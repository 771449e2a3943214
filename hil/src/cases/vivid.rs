//! The kernel's own simulated camera, whose driver can be made to fail as a driver of hardware does.
//!
//! Its pictures are test patterns: what is looked at is that the module lives, tells, and comes back, not what it sees.

use std::path::{Path, PathBuf};
use std::time::Duration;

use freespace::health::Faults;

use crate::bench::{BenchError, Rig, command};
use crate::case::{Case, Seen};
use crate::clock::now_micros;
use crate::drive::{Ending, last_word, names};
use crate::listener::Listener;
use crate::module::{Installation, Module};
use crate::promise::{Blind, judge};

/// Cases of the driver.
pub(crate) const CASES: &[Case] = &[
    Case {
        name: "camera-unplugged",
        injected: "the device is gone for 4 s and comes back",
        required: "camera_silent is named, answers go on, frames again",
        is_quick: true,
        run: |rig| {
            let gone = |_: &str| driver("unbind");
            let back = |_: &str| driver("bind");
            run(rig, gone, back, |_, named| {
                named
                    .contains(Faults::CAMERA_SILENT)
                    .then_some(())
                    .ok_or("camera_silent was not named")
            })
        },
    },
    Case {
        name: "camera-disconnected",
        injected: "the driver disconnects its device as USB does: every call fails until it is opened anew",
        required: "it is opened anew, answers go on, frames again",
        is_quick: true,
        run: |rig| {
            run(
                rig,
                |node| set(node, "disconnect=1"),
                nothing,
                |log, _| is_opened_anew(log),
            )
        },
    },
    Case {
        name: "camera-queue-error",
        injected: "the driver reports a fatal error of its queue",
        required: "it is opened anew, answers go on, frames again",
        is_quick: true,
        run: |rig| {
            run(
                rig,
                |node| set(node, "inject_fatal_streaming_error=1"),
                nothing,
                |log, _| is_opened_anew(log),
            )
        },
    },
    Case {
        name: "camera-frames-lost",
        injected: "the driver drops a tenth of all frames for 4 s",
        required: "they are counted, answers go on, frames again",
        is_quick: true,
        run: |rig| {
            let drop = |node: &str| set(node, "percentage_of_dropped_buffers=10");
            let end = |node: &str| set(node, "percentage_of_dropped_buffers=0");
            run(rig, drop, end, |log, _| {
                (dropped(log) >= FEWEST_DROPPED)
                    .then_some(())
                    .ok_or("no lost frame was counted")
            })
        },
    },
];

/// How long the fault lasts.
const FAULT: Duration = Duration::from_secs(4);
const TO_RECOVER: Duration = Duration::from_secs(5);
/// Of the 12 that a tenth of four seconds are.
const FEWEST_DROPPED: u64 = 6;

type Done = Result<(), BenchError>;

fn run(
    rig: &Rig,
    begin: impl Fn(&str) -> Done,
    end: impl Fn(&str) -> Done,
    shows: impl Fn(&str, Faults) -> Result<(), &'static str>,
) -> Result<Seen, BenchError> {
    let device = vivid().ok_or_else(|| BenchError::Lacking("there is no vivid device".to_owned()))?;
    let node = device.to_string_lossy().into_owned();
    let listener = Listener::start(&rig.interface)?;
    let installation = Installation {
        config: config_for(rig, &node)?,
        ..rig.installation.clone()
    };
    let log = rig.file("module.log");
    let mut module = Module::start(&installation, None, &log)?;
    let has_frames = |faults: Faults| !faults.contains(Faults::CAMERA_SILENT);
    listener
        .wait_for(Duration::from_secs(15), |heard| has_frames(heard.faults))
        .ok_or_else(|| BenchError::NoAnswer(module.last_words()))?;
    std::thread::sleep(Duration::from_secs(2));
    let mut seen = Seen::default();
    let from = now_micros();
    begin(&node)?;
    std::thread::sleep(FAULT);
    seen.require(module.is_running(), "the module ended");
    end(&node)?;
    let back = listener.wait_for(TO_RECOVER, |heard| has_frames(heard.faults));
    seen.require(back.is_some(), "no frames again");
    std::thread::sleep(Duration::from_secs(1));
    let words = module.last_words();
    let status = module.end();
    std::thread::sleep(Duration::from_millis(100));
    let heard = listener.heard();
    last_word(status, Ending::Well, &heard, &words, &mut seen);
    let since = heard.iter().filter(|heard| heard.at_micros >= from);
    let named = since.fold(Faults::NONE, |all, heard| all | heard.faults);
    seen.note(format!("named {}", names(named)));
    if let Err(missing) = shows(&std::fs::read_to_string(&log)?, named) {
        seen.require(false, missing);
    }
    let kept = judge(&heard, Blind::default());
    seen.note(format!(
        "{} answers, latest {:.0} ms",
        kept.answers, kept.latest_ms
    ));
    seen.broken.extend(kept.broken);
    Ok(seen)
}

/// The fault ends by itself.
#[expect(clippy::unnecessary_wraps, reason = "one of several ends")]
const fn nothing(_: &str) -> Done {
    Ok(())
}

fn set(node: &str, control: &str) -> Done {
    command("v4l2-ctl", &["-d", node, "-c", control])
}

/// Takes the device from its driver, or gives it back: as a plug that is pulled.
fn driver(action: &str) -> Done {
    Ok(std::fs::write(
        format!("/sys/bus/platform/drivers/vivid/{action}"),
        "vivid.0",
    )?)
}

fn is_opened_anew(log: &str) -> Result<(), &'static str> {
    let opened = log.matches(": the camera gives ").count();
    (opened >= 2).then_some(()).ok_or("it was not opened anew")
}

/// Frames that the module says were lost.
fn dropped(log: &str) -> u64 {
    let count = |line: &str| line.split(", ").nth(1)?.strip_suffix(" dropped")?.parse().ok();
    log.lines()
        .filter(|line| line.starts_with("frames "))
        .find_map(count)
        .unwrap_or(0)
}

/// The capture node of vivid.
fn vivid() -> Option<PathBuf> {
    let nodes = std::fs::read_dir("/sys/class/video4linux").ok()?;
    nodes.filter_map(Result::ok).find_map(|node| {
        let name = std::fs::read_to_string(node.path().join("name")).ok()?;
        (name.starts_with("vivid") && name.contains("cap")).then(|| Path::new("/dev").join(node.file_name()))
    })
}

/// The module's configuration with another camera, beside it for its relative paths.
///
/// The driver gives frames out before they end, so that stamps of their end lie in the future: it stamps their start instead.
fn config_for(rig: &Rig, node: &str) -> Result<PathBuf, BenchError> {
    let own = format!("path = \"{}\"", rig.device.display());
    let vivid = format!("path = \"{node}\"\ncontrols = {{ timestamp_source = 1 }}");
    rig.config_with(&[(&own, &vivid)])
}
