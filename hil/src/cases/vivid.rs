//! The kernel's own simulated camera, whose driver can be made to fail as a driver of hardware does.
//!
//! Its pictures are test patterns: what is looked at is that the module lives, tells, and comes back, not what it sees.

use std::path::{Path, PathBuf};
use std::time::Duration;

use freespace::health::Faults;

use crate::bench::{BenchError, Rig, command};
use crate::case::{Case, Seen};
use crate::drive::last_word;
use crate::listener::Listener;
use crate::module::{Installation, Module};
use crate::promise::{Blind, judge};

/// Cases of the driver.
pub(crate) const CASES: &[Case] = &[
    Case {
        name: "camera-unplugged",
        injected: "the device is disconnected, as USB does it: every call fails until it is opened anew",
        required: "camera_silent is named, answers go on, frames again",
        is_quick: true,
        run: |rig| control(rig, "disconnect=1"),
    },
    Case {
        name: "camera-queue-error",
        injected: "the driver reports a fatal error of its queue",
        required: "answers go on, frames again",
        is_quick: true,
        run: |rig| control(rig, "inject_fatal_streaming_error=1"),
    },
    Case {
        name: "camera-frames-lost",
        injected: "the driver drops a tenth of all frames for 4 s",
        required: "answers go on, frames again",
        is_quick: true,
        run: |rig| control(rig, "percentage_of_dropped_buffers=10"),
    },
];

/// How long the fault is looked at.
const LOOK: Duration = Duration::from_secs(4);
const TO_RECOVER: Duration = Duration::from_secs(5);

fn control(rig: &Rig, control: &str) -> Result<Seen, BenchError> {
    let device = vivid().ok_or_else(|| BenchError::Lacking("there is no vivid device".to_owned()))?;
    let node = device.to_string_lossy().into_owned();
    let listener = Listener::start(&rig.interface)?;
    let installation = Installation {
        config: config_for(rig, &device)?,
        ..rig.installation.clone()
    };
    let mut module = Module::start(&installation, None, &rig.file("module.log"))?;
    let has_frames = |faults: Faults| !faults.contains(Faults::CAMERA_SILENT);
    listener
        .wait_for(Duration::from_secs(15), |heard| has_frames(heard.faults))
        .ok_or_else(|| BenchError::NoAnswer(module.last_words()))?;
    std::thread::sleep(Duration::from_secs(2));
    let mut seen = Seen::default();
    command("v4l2-ctl", &["-d", &node, "-c", control])?;
    std::thread::sleep(LOOK);
    seen.require(module.is_running(), "the module ended");
    let named = listener
        .heard()
        .iter()
        .fold(Faults::NONE, |all, heard| all | heard.faults);
    seen.note(format!("named {}", crate::drive::names(named)));
    if control.starts_with("percentage") {
        command(
            "v4l2-ctl",
            &["-d", &node, "-c", "percentage_of_dropped_buffers=0"],
        )?;
    }
    let back = listener.wait_for(TO_RECOVER, |heard| has_frames(heard.faults));
    seen.require(back.is_some(), "no frames again");
    let words = module.last_words();
    let status = module.end();
    std::thread::sleep(Duration::from_millis(100));
    let heard = listener.heard();
    last_word(status, &heard, &words, &mut seen);
    let kept = judge(&heard[..heard.len().saturating_sub(1)], Blind::default());
    seen.note(format!(
        "{} answers, latest {:.0} ms",
        kept.answers, kept.latest_ms
    ));
    seen.broken.extend(kept.broken);
    Ok(seen)
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
fn config_for(rig: &Rig, device: &Path) -> Result<PathBuf, BenchError> {
    let shipped = &rig.installation.config;
    let text = std::fs::read_to_string(shipped)?;
    let path = shipped.with_file_name("rig-vivid.toml");
    let own = format!("path = \"{}\"", rig.device.display());
    std::fs::write(
        &path,
        text.replace(
            &own,
            &format!(
                "path = \"{}\"\ncontrols = {{ timestamp_source = 1 }}",
                device.display()
            ),
        ),
    )?;
    Ok(path)
}
