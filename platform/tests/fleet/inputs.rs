//! A fleet of three drives, two seconds each: two finished runs and a recording, made once a test run.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::{freespace, said, text};

/// The shipped demo, with half the frames and a smaller working image: enough for a build without optimisation.
fn config(folder: &Path) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let shipped = fs::read_to_string(root.join("config/demo.toml")).unwrap();
    let manifest = root.join("models/road.toml").canonicalize().unwrap();
    let name = format!("freespace/test/fleet/{}", std::process::id());
    let mut config = shipped
        .replace("../models/road.toml", text(&manifest))
        .replace("freespace/grid", &name);
    for (shipped, small) in [
        ("frame_rate_hz = 30.0", "frame_rate_hz = 15.0"),
        ("width = 480 ", "width = 240 "),
        ("height = 360 ", "height = 180 "),
        ("far_tile = true", "far_tile = false"),
    ] {
        assert!(config.contains(shipped), "{shipped}");
        config = config.replace(shipped, small);
    }
    let path = folder.join("small.toml");
    fs::write(&path, config).unwrap();
    path
}

/// The folder of the fleet.
pub(crate) fn fleet() -> &'static PathBuf {
    static FLEET: OnceLock<PathBuf> = OnceLock::new();
    FLEET.get_or_init(|| {
        let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fleet");
        let _ = fs::remove_dir_all(&root);
        let fleet = root.join("drives");
        fs::create_dir_all(fleet.join("b")).unwrap();
        let config = config(&root);
        for (seed, name) in [("1", "a/monday"), ("2", "a/tuesday")] {
            let out = fleet.join(name);
            let arguments = ["--pace", "fast", "--seed", seed, "--out", text(&out)];
            drive(&config, &arguments);
        }
        recording(&config, &root, &fleet.join("b/wednesday.mcap"));
        fleet
    })
}

fn drive(config: &Path, arguments: &[&str]) {
    let command = ["demo", "--seconds", "2", "--config", text(config)];
    said(&freespace(&[&command[..], arguments].concat()).output().unwrap());
}

/// A recording with its truth beside it.
fn recording(config: &Path, root: &Path, mcap: &Path) {
    let out = root.join("wednesday");
    drive(
        config,
        &["--seed", "3", "--mcap", text(mcap), "--out", text(&out)],
    );
    fs::rename(out.join("truth"), mcap.with_extension("truth")).unwrap();
}
