//! Bad input through the program itself: exit code 2, the file, the line or field and the fix on standard error, and
//! nothing written.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "tests"
)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const CONFIG: &str = "\
[camera]
frame_rate_hz = 10.0
[camera.mount]
height_m = 1.5
[camera.lens]
hfov_deg = 60.0
[network]
manifest = \"none.toml\"
";

/// A folder of three frames with times, and a configuration for it.
fn inputs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("images")).unwrap();
    for frame in 0..3 {
        image::GrayImage::from_fn(96, 64, |x, y| image::Luma([(x * y + frame) as u8]))
            .save(folder.path().join(format!("images/{frame:06}.png")))
            .unwrap();
    }
    fs::write(folder.path().join("times.txt"), "0\n0.1\n0.2\n").unwrap();
    fs::write(folder.path().join("car.toml"), CONFIG).unwrap();
    folder
}

fn freespace(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_freespace"))
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .args(arguments)
        .output()
        .unwrap()
}

const REPLAY: [&str; 6] = ["replay", ".", "--config", "car.toml", "--out", "result"];

#[test]
fn each_fault_is_named_with_its_fix_and_nothing_is_written() {
    type Spoil = fn(&Path);
    let cases: [(&str, Spoil, &[&str], &[&str]); 8] = [
        (
            "truncated image",
            |f| {
                let path = f.join("images/000001.png");
                let bytes = fs::read(&path).unwrap();
                fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
            },
            &[],
            &["000001.png", "truncated", "copy the file again"],
        ),
        (
            "wrong size",
            |f| {
                image::GrayImage::new(80, 64)
                    .save(f.join("images/000002.png"))
                    .unwrap()
            },
            &[],
            &["000002.png", "80x64", "96x64", "one size"],
        ),
        (
            "no images",
            |f| fs::remove_dir_all(f.join("images")).unwrap(),
            &[],
            &["no PNG or JPEG", "SOURCE is"],
        ),
        (
            "times that go backwards",
            |f| fs::write(f.join("times.txt"), "0\n0.2\n0.1\n").unwrap(),
            &[],
            &["times.txt:3", "backwards", "increase"],
        ),
        (
            "unknown key",
            |f| fs::write(f.join("car.toml"), CONFIG.replace("hfov_deg", "hfov")).unwrap(),
            &[],
            &["car.toml:6", "unknown key `hfov`", "did you mean `hfov_deg`?"],
        ),
        (
            "unknown key frame",
            |f| fs::write(f.join("list.txt"), "000001\n000009\n").unwrap(),
            &["--key-frames", "list.txt"],
            &["list.txt:2", "000009", "name frames as their files"],
        ),
        (
            "log without wheels",
            |_| {},
            &["--can", "log.candump"],
            &["car.toml", "describes no CAN message", "[wheels]"],
        ),
        (
            "truth that is not there",
            |_| {},
            &["--truth-poses", "gone.txt"],
            &["gone.txt", "cannot be read"],
        ),
    ];
    for (name, spoil, more, wanted) in cases {
        let folder = inputs();
        spoil(folder.path());
        let output = freespace(folder.path(), &[&REPLAY[..], more].concat());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{name}: {error}");
        for text in wanted {
            assert!(error.contains(text), "{name}: no `{text}` in\n{error}");
        }
        assert!(
            !folder.path().join("result").exists(),
            "{name} left something behind"
        );
    }
}

#[test]
fn eval_names_its_faults_and_prints_the_keys_of_the_report() {
    let folder = inputs();
    let row = "1 0 0 0 0 1 0 0 0 0 1 ";
    fs::write(folder.path().join("a.kitti"), format!("{row}0\n{row}1\n{row}2\n")).unwrap();
    fs::write(folder.path().join("b.kitti"), format!("{row}0\n{row}2\n{row}4\n")).unwrap();
    let output = freespace(
        folder.path(),
        &["eval", "trajectory", "a.kitti", "b.kitti", "--json"],
    );
    assert_eq!(output.status.code(), Some(0));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let truth = &json["truth"];
    assert!((truth["scale_error"].as_f64().unwrap() - 1.0).abs() < 1e-9);
    assert_eq!(truth["distance_m"].as_f64(), Some(4.0));
    assert!(truth["ate_sim3_m"].as_f64().unwrap() < 1e-9 && truth["road"].is_null());

    fs::write(folder.path().join("a.kitti"), format!("{row}0\n1 2 3\n")).unwrap();
    let output = freespace(folder.path(), &["eval", "trajectory", "a.kitti", "b.kitti"]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        error.contains("a.kitti:2") && error.contains("12 numbers"),
        "{error}"
    );
}

#[test]
fn calibrate_names_its_faults() {
    let folder = inputs();
    let path = folder.path();
    fs::create_dir(path.join("empty")).unwrap();
    fs::write(
        path.join("omni.yaml"),
        "cam0:\n  camera_model: omni\n  intrinsics: [1, 2, 3, 4]\n",
    )
    .unwrap();
    fs::write(
        path.join("yaml.toml"),
        CONFIG.replace("hfov_deg = 60.0", "source = \"omni.yaml\""),
    )
    .unwrap();
    let lens = [
        "calibrate",
        "lens",
        "images",
        "--board",
        "9x6",
        "--square",
        "0.025",
    ];
    let cases: [(&[&str], &[&str]); 8] = [
        (&lens, &["0 of 3 pictures show the board 9x6", "inner corners"]),
        (
            &[
                "calibrate",
                "lens",
                "empty",
                "--board",
                "9x6",
                "--square",
                "0.025",
            ],
            &["empty", "no PNG or JPEG"],
        ),
        (
            &["calibrate", "lens", "images", "--board", "9", "--square", "0.025"],
            &["INNER corners"],
        ),
        (
            &["calibrate", "import", "omni.yaml"],
            &["omni.yaml:2", "`omni` is not supported", "pinhole-radtan"],
        ),
        (
            &["calibrate", "import", "times.txt"],
            &["times.txt", "no `camera_matrix`"],
        ),
        (
            &["replay", ".", "--config", "yaml.toml", "--out", "result"],
            &["omni.yaml:2", "not supported"],
        ),
        (
            &["calibrate", "mount", ".", "--config", "car.toml"],
            &["it stands", "record a drive"],
        ),
        (
            &[
                "calibrate",
                "ticks",
                "log",
                "--config",
                "car.toml",
                "--distance",
                "100",
            ],
            &["describes no CAN message", "[wheels]"],
        ),
    ];
    for (arguments, wanted) in cases {
        let output = freespace(path, arguments);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
        for text in wanted {
            assert!(error.contains(text), "{arguments:?}: no `{text}` in\n{error}");
        }
    }
    assert!(!path.join("result").exists());
}
