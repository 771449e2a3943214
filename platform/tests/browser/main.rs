//! The monitor's page in a real browser, on a running demo. Pictures of it lie in `target/tmp/monitor_page/` afterwards.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A stage that is slow long after the start, when a page has had the time to be looked at.
const SLOW: &str = "crf=450@20";

/// What a check exits with that cannot run here.
const SKIPPED: i32 = 77;

/// A process that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The Python that has Playwright: that of CI's environment where there is one.
fn python() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let environment = root.join("target/browser/bin/python");
    let given = std::env::var_os("FREESPACE_BROWSER_PYTHON").map(PathBuf::from);
    let fallback = || PathBuf::from("python3");
    given.unwrap_or_else(|| {
        if environment.exists() {
            environment
        } else {
            fallback()
        }
    })
}

fn has_playwright() -> bool {
    let tried = Command::new(python())
        .args(["-c", "import playwright"])
        .stderr(Stdio::null())
        .status();
    tried.is_ok_and(|status| status.success())
}

/// A demo under a name of its own.
fn demo(name: &str, folder: &Path) -> Running {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/demo.toml");
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/road.toml");
    let text = std::fs::read_to_string(shipped).unwrap();
    let text = text.replace("freespace/grid", name).replace(
        "../models/road.toml",
        &manifest.canonicalize().unwrap().display().to_string(),
    );
    let config = folder.join("demo.toml");
    std::fs::write(&config, text).unwrap();
    let child = Command::new(env!("CARGO_BIN_EXE_freespace"))
        .args(["demo", "--seconds", "300", "--slow", SLOW, "--config"])
        .arg(&config)
        .arg("--out")
        .arg(folder.join("out"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    Running(child.unwrap())
}

/// A monitor, and the address it says that it listens on.
fn monitor(name: &str) -> (Running, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_freespace"))
        .args(["monitor", "--name", name, "--listen", "127.0.0.1:0"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stderr.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let address = line.trim().rsplit(' ').next().unwrap().to_owned();
    assert!(address.starts_with("http://127.0.0.1:"), "{line}");
    (Running(child), address)
}

#[test]
fn the_page_moves_in_light_dark_and_on_a_phone() {
    if !has_playwright() {
        eprintln!(
            "SKIPPED: the monitor's page in a browser: pip install playwright; apt-get install chromium"
        );
        return;
    }
    let name = format!("freespace/test/browser/{}", std::process::id());
    let folder = tempfile::tempdir().unwrap();
    let _demo = demo(&name, folder.path());
    let (_monitor, address) = monitor(&name);
    let pictures = Path::new(env!("CARGO_TARGET_TMPDIR")).join("monitor_page");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser/check.py");
    let output = Command::new(python())
        .arg(script)
        .arg(&address)
        .arg(&pictures)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    if output.status.code() == Some(SKIPPED) {
        eprintln!("{}", said.trim());
        return;
    }
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}{complaint}");
}
