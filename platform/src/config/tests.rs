#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
#![allow(clippy::cast_possible_wrap, reason = "tests")]

use std::collections::BTreeSet;
use std::path::Path;

use freespace::frame::Lens;
use nalgebra::Vector2;

use super::*;
use crate::runtime::rights::{Cpus, Policy, RealTimeConfig, ThreadRole};
use crate::sink::shared_memory::SharingConfig;

const SHIPPED: [(&str, &str); 4] = [
    ("kitti", include_str!("../../../config/kitti.toml")),
    ("camvid", include_str!("../../../config/camvid.toml")),
    ("toyota", include_str!("../../../config/toyota.toml")),
    ("demo", include_str!("../../../config/demo.toml")),
];
const SCHEMA: &str = include_str!("../../../config/freespace.schema.json");

fn shipped(name: &str) -> &'static str {
    SHIPPED.iter().find(|(n, _)| *n == name).unwrap().1
}

fn parse(text: &str) -> Result<Config, BadInput> {
    Config::parse(Path::new("config/car.toml"), text)
}

#[test]
fn shipped_configurations_are_valid() {
    for (name, text) in SHIPPED {
        let config = parse(text).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(config.deadline.publish_micros(), 500_000, "{name}");
        assert!(config.network.manifest.starts_with("config"), "{name}");
    }
}

#[test]
fn kitti_describes_its_wheel_counters() {
    let Wheels::Can(wheels) = parse(shipped("kitti")).unwrap().wheels() else {
        panic!("no CAN wheels");
    };
    assert_eq!(wheels.dbc, Path::new("config/wheels_hyundai.dbc"));
    assert_eq!(wheels.signals.names()[0], "WHL_PUL_FL");
    assert_eq!(
        (wheels.odometer.modulus, wheels.odometer.timeout_micros),
        (256, 200_000)
    );
    assert_eq!(wheels.direction.unwrap().backward, 2);
}

#[test]
fn working_image_keeps_the_aspect_within_the_networks_pixels() {
    let config = parse(shipped("kitti")).unwrap();
    let size = |width, height| ImageSize { width, height };
    assert_eq!(config.working_size(1242, 375), size(621, 188));
    assert_eq!(config.working_size(480, 360), size(480, 360));
    assert_eq!(config.working_size(640, 480), size(480, 360));
    assert_eq!(
        parse(shipped("demo")).unwrap().working_size(640, 480),
        size(480, 360)
    );
}

#[test]
fn field_of_view_spans_the_image() {
    let lens = parse(shipped("camvid"))
        .unwrap()
        .camera_for(Path::new("."), 480, 360)
        .unwrap()
        .lens;
    let edge = lens.unproject(&Vector2::new(-0.5, 179.5)).unwrap();
    assert!((edge.x.atan2(edge.z).to_degrees() + 30.0).abs() < 1e-9);
    // Anamorphic: the height of 16:9 at 60 degrees wide.
    let top = lens.unproject(&Vector2::new(239.5, -0.5)).unwrap();
    assert!((top.y / top.z / (edge.x / edge.z) - 9.0 / 16.0).abs() < 1e-6);
}

#[test]
fn calibration_of_the_folder_is_the_lens() {
    let folder = tempfile::tempdir().unwrap();
    let config = parse(shipped("kitti")).unwrap();
    let lens = |text: &str| {
        std::fs::write(folder.path().join("calib.txt"), text).unwrap();
        config
            .camera_for(folder.path(), 1242, 375)
            .map(|camera| camera.lens)
    };
    let good = lens("P0: 721.5 0 609.5 0 0 721.5 172.8 0 0 0 1 0\n").unwrap();
    assert_eq!(good, Lens::pinhole(721.5, 721.5, 609.5, 172.8));
    for (text, wanted) in [
        ("P1: 1 2 3\n", "no line that begins with `P0:`"),
        (
            "\nP0: 721.5 0 x 0 0 721.5 172.8 0 0 0 1 0\n",
            "calib.txt:2: `x` is not a number",
        ),
        ("P0: 721.5 0 609.5 0 0 721.5 172.8\n", "7 numbers"),
    ] {
        let error = lens(text).unwrap_err();
        assert!(error.message().contains(wanted), "{error}");
    }
    std::fs::remove_file(folder.path().join("calib.txt")).unwrap();
    let error = config.camera_for(folder.path(), 1242, 375).unwrap_err();
    assert!(error.message().contains("calib.txt") && error.fix().contains("[camera.lens]"));
}

#[test]
fn faults_name_the_line_and_the_fix() {
    let cases = [
        (
            "heigth_m = 1.65",
            "+0|unknown key `heigth_m` in [camera.mount]",
            "did you mean `height_m`?",
        ),
        ("height_m = \"1.65\"", "+0|invalid type", "config/kitti.toml"),
        (
            "height_m = 165",
            "+0|`camera.mount.height_m` is 165",
            "between 0.2 and 5 metres",
        ),
        (
            "height_m = nan",
            "+0|`camera.mount.height_m` is NaN",
            "between 0.2 and 5 metres",
        ),
        (
            "",
            "-1|key `height_m` is missing in [camera.mount]",
            "add `height_m`",
        ),
        ("height_m = 1.65\nheight_m = 2.0", "+1|duplicate key", ""),
        ("height_m 1.65", "+0|", ""),
    ];
    let (number, line) = shipped("kitti")
        .lines()
        .enumerate()
        .find(|(_, line)| line.starts_with("height_m"))
        .unwrap();
    for (replacement, place, fix) in cases {
        let error = parse(&shipped("kitti").replace(line, replacement)).unwrap_err();
        let (offset, message) = place.split_once('|').unwrap();
        let at = number as i64 + 1 + offset.parse::<i64>().unwrap();
        let wanted = format!("config/car.toml:{at}: {message}");
        assert!(error.message().starts_with(&wanted), "{replacement}: {error}");
        assert!(error.fix().contains(fix), "{replacement}: {}", error.fix());
    }
}

#[test]
fn contradictions_are_refused() {
    let cases = [
        (
            "camvid",
            "source = \"none\"",
            "source = \"can\"",
            "`wheels.kind` is missing",
        ),
        (
            "camvid",
            "source = \"none\"",
            "message = \"X\"",
            "source of [wheels] is \"none\"",
        ),
        (
            "camvid",
            "hfov_deg = 60.0",
            "hfov_deg = 60.0\nsource = \"calib.txt\"",
            "exactly one way",
        ),
        (
            "camvid",
            "hfov_deg = 60.0",
            "hfov_deg = 60.0\nfx = 3.0",
            "belong to `model`",
        ),
        (
            "camvid",
            "hfov_deg = 60.0",
            "model = \"fish\"",
            "unknown value \"fish\"",
        ),
        (
            "camvid",
            "publish_ms = 500.0",
            "publish_ms = 700.0",
            "`deadline.publish_ms` is 700",
        ),
        ("demo", "modulus = 256", "", "`wheels.modulus` is missing"),
        (
            "demo",
            "k = [-0.12, 0.02, 0.0]",
            "k = [0.1]",
            "has 1 coefficients, this model has 3",
        ),
        (
            "toyota",
            "width = 1164",
            "",
            "`width` and `height` of [camera] belong together",
        ),
        (
            "kitti",
            "metres_per_count = 0.0203125",
            "",
            "`wheels.metres_per_count` is missing",
        ),
        (
            "kitti",
            "[network]",
            "[priors.belief]\nwitness_against = 3.0\n[network]",
            "`priors.belief.witness_against` is 3",
        ),
        (
            "toyota",
            "source = \"can\"",
            "source = \"can\"\nchecksum = { signal = \"S\", algorithm = \"autosar_e2e_p01\" }",
            "`wheels.checksum` lacks `data_id`",
        ),
        (
            "toyota",
            "source = \"can\"",
            "source = \"can\"\ninterface = \"can 0\"",
            "`wheels.interface` is \"can 0\"",
        ),
        (
            "kitti",
            "source = \"can\"",
            "source = \"can\"\ninterface = \"can0\"",
            "`wheels.time_offset_s` is 1700000000",
        ),
        (
            "demo",
            "[network]",
            "[can]\ninterface = \"can0\"\ngrid = true\n[network]",
            "`can.fd` is not",
        ),
        (
            "demo",
            "[network]",
            "[can]\ninterface = \"can0\"\nfd = true\ngrid = true\nshare = 0.1\n[network]",
            "take 18 % of the bus",
        ),
        (
            "demo",
            "[network]",
            "[can]\nbit_rate = 2000000\n[network]",
            "`can.bit_rate` is 2000000",
        ),
    ];
    for (name, from, to, message) in cases {
        assert!(shipped(name).contains(from), "{name} has no {from}");
        let error = parse(&shipped(name).replacen(from, to, 1)).unwrap_err();
        assert!(error.message().contains(message), "{from} -> {to}: {error}");
        assert!(!error.fix().is_empty());
    }
}

/// The keys that the program knows of a table, from its own answer to an unknown one.
fn known_keys(text: &str) -> BTreeSet<String> {
    let error = parse(text).unwrap_err();
    let (_, list) = error.fix().rsplit_once(": ").unwrap_or_else(|| panic!("{error}"));
    list.split(", ").map(str::to_owned).collect()
}

#[test]
fn schema_has_the_keys_that_the_program_knows() {
    let schema: serde_json::Value = serde_json::from_str(SCHEMA).unwrap();
    let text = format!(
        "{}\n[working_image]\nwidth = 480\nheight = 360\n[runtime]\n[runtime.camera]\n[runtime.monitor]\n[can]\n[camera.device]\npath = \"/dev/video0\"\n",
        shipped("kitti").replace(
            "[wheels]\n",
            "[wheels]\nchecksum = { signal = \"S\", algorithm = \"xor\" }\n"
        )
    );
    let cases = [
        ("", "zzz = 1\n[camera]", "[camera]"),
        ("/camera", "[camera]\nzzz = 1", "[camera]"),
        ("/camera/mount", "[camera.mount]\nzzz = 1", "[camera.mount]"),
        ("/camera/lens", "[camera.lens]\nzzz = 1", "[camera.lens]"),
        ("/camera/device", "[camera.device]\nzzz = 1", "[camera.device]"),
        ("/wheels", "[wheels]\nzzz = 1", "[wheels]"),
        ("/wheels/signals", "signals = { zzz = 1, ", "signals = { "),
        (
            "/wheels/direction",
            "[wheels.direction]\nzzz = 1",
            "[wheels.direction]",
        ),
        ("/can", "[can]\nzzz = 1", "[can]"),
        ("/wheels/checksum", "checksum = { zzz = 1, ", "checksum = { "),
        ("/network", "[network]\nzzz = 1", "[network]"),
        ("/key_frames", "[key_frames]\nzzz = 1", "[key_frames]"),
        ("/deadline", "[deadline]\nzzz = 1", "[deadline]"),
        ("/runtime", "[runtime]\nzzz = 1", "[runtime]"),
        ("/runtime/camera", "[runtime.camera]\nzzz = 1", "[runtime.camera]"),
        (
            "/runtime/monitor",
            "[runtime.monitor]\nzzz = 1",
            "[runtime.monitor]",
        ),
        ("/shared_memory", "[shared_memory]\nzzz = 1", "[shared_memory]"),
        ("/working_image", "[working_image]\nzzz = 1", "[working_image]"),
    ];
    for (pointer, with, place) in cases {
        let pointer = pointer.replace('/', "/properties/");
        let described: BTreeSet<String> = schema
            .pointer(&format!("{pointer}/properties"))
            .and_then(serde_json::Value::as_object)
            .unwrap_or_else(|| panic!("the schema has no {pointer}"))
            .keys()
            .cloned()
            .collect();
        assert_eq!(described, known_keys(&text.replacen(place, with, 1)), "{place}");
    }
}

#[test]
fn sharing_is_wanted_unless_it_is_said_and_its_name_is_one_that_readers_can_write() {
    let with = |table: &str| parse(&format!("{}\n[shared_memory]\n{table}", shipped("camvid")));
    let default = SharingConfig::default();
    assert_eq!(with("").unwrap().sharing(), Sharing::Wanted(default.clone()));
    assert_eq!(with("enabled = false").unwrap().sharing(), Sharing::Off);
    let rear = SharingConfig {
        name: "freespace/grid/rear".to_owned(),
        max_readers: 7,
    };
    let config = with("enabled = true\nname = \"freespace/grid/rear\"\nmax_readers = 7").unwrap();
    assert_eq!(config.sharing(), Sharing::Required(rear));
    for (text, message, fix) in [
        (
            "name = \"\"",
            "`shared_memory.name` is \"\"",
            "such as \"freespace/grid\"",
        ),
        (
            "name = \"Rear grid\"",
            "`shared_memory.name` is \"Rear grid\"",
            "a to z",
        ),
        (
            "max_readers = 0",
            "`shared_memory.max_readers` is 0",
            "between 1 and 32 readers",
        ),
    ] {
        let error = with(text).unwrap_err();
        assert!(error.message().contains(message), "{error}");
        assert!(error.fix().contains(fix), "{error}");
    }
}

#[test]
fn threads_keep_their_defaults_but_for_what_is_written() {
    let with = |table: &str| parse(&format!("{}\n{table}", shipped("demo")));
    let plain = with("").unwrap().real_time();
    assert_eq!(plain, RealTimeConfig::default());
    let text = "[runtime]\nlock_memory = false\n[runtime.key_frame]\npolicy = \"rr\"\ncpus = [1, 3]\n\
                [runtime.camera]\npriority = 12\nstack_kib = 2048\n[runtime.network]\npolicy = \"normal\"\n";
    let config = with(text).unwrap().real_time();
    let of = |role| *config.of(role);
    assert!(!config.lock_memory);
    assert_eq!(of(ThreadRole::KeyFrame).policy, Policy::RoundRobin(40));
    assert_eq!(of(ThreadRole::KeyFrame).cpus, Cpus(0b1010));
    assert_eq!(
        (of(ThreadRole::Camera).policy, of(ThreadRole::Camera).stack_kib),
        (Policy::Fifo(12), 2048)
    );
    assert_eq!(of(ThreadRole::Network).policy, Policy::Normal);
    assert_eq!(of(ThreadRole::Publisher), *plain.of(ThreadRole::Publisher));
    for (table, message) in [
        (
            "[runtime.frame]\npriority = 100\n",
            "`runtime.frame.priority` is 100",
        ),
        (
            "[runtime.frame]\npolicy = \"normal\"\npriority = 5\n",
            "the policy is normal",
        ),
        (
            "[runtime.monitor]\npolicy = \"fifo\"\n",
            "it may not be real-time",
        ),
        ("[runtime.network]\ncpus = [64]\n", "`runtime.network.cpus` is 64"),
        (
            "[runtime.camera]\nstack_kib = 16\n",
            "`runtime.camera.stack_kib` is 16",
        ),
        (
            "[runtime.camera]\npolicy = \"batch\"\n",
            "unknown value \"batch\"",
        ),
    ] {
        let error = with(table).unwrap_err();
        assert!(error.message().contains(message), "{table}: {error}");
        assert!(!error.fix().is_empty());
    }
}

#[test]
fn frames_of_another_size_are_refused() {
    let config = parse(shipped("camvid")).unwrap();
    let error = config.camera_for(Path::new("clip"), 640, 480).unwrap_err();
    assert!(error.message().contains("frames are 640x480") && error.message().contains("480x360"));
}

#[test]
fn a_camera_device_is_read_and_its_faults_are_told() {
    let with = |table: &str| parse(&format!("{}\n[camera.device]\n{table}\n", shipped("toyota")));
    let device = with("path = \"/dev/video0\"").unwrap().camera.device.unwrap();
    assert_eq!((device.formats[0], device.buffers), (DeviceFormat::Yuyv, 4));
    assert_eq!(device.formats.last(), Some(&DeviceFormat::Mjpeg));
    let text = "path = \"/dev/v4l/by-path/x\"\nformats = [\"mjpeg\"]\nstamp_offset_s = -0.008\n\
                controls = { auto_exposure = \"manual_mode\", gain = 3, white_balance_automatic = false }";
    let device = with(text).unwrap().camera.device.unwrap();
    assert_eq!(device.stamp_offset_micros(), -8_000);
    assert_eq!(device.controls["gain"], ControlValue::Integer(3));
    assert_eq!(
        device.controls["white_balance_automatic"],
        ControlValue::Bool(false)
    );
    for (table, message) in [
        ("", "key `path` is missing in [camera.device]"),
        ("path = \"video0\"", "`video0` is no path of a device"),
        ("path = \"/dev/video0\"\nformats = []", "names no format"),
        (
            "path = \"/dev/video0\"\nformats = [\"h264\"]",
            "unknown value \"h264\"",
        ),
        (
            "path = \"/dev/video0\"\nbuffers = 1",
            "`camera.device.buffers` is 1",
        ),
        (
            "path = \"/dev/video0\"\nstamp_offset_s = 20",
            "`camera.device.stamp_offset_s` is 20",
        ),
        (
            "path = \"/dev/video0\"\ncontrols = { gain = 0.5 }",
            "a whole number, true or false",
        ),
    ] {
        let error = with(table).unwrap_err();
        assert!(error.message().contains(message), "{table}: {error}");
        assert!(!error.fix().is_empty());
    }
    let unsized_camera = format!("{}\n[camera.device]\npath = \"/dev/video0\"\n", shipped("kitti"));
    let error = parse(&unsized_camera).unwrap_err();
    assert!(error.fix().contains("width and height"), "{error}");
}

#[test]
fn the_interfaces_that_a_configuration_suggests_make_a_plan() {
    let text = shipped("toyota")
        .replace("# interface", "interface")
        .replace("# [can]", "[can]");
    let text = text
        .replace("# bit_rate", "bit_rate")
        .replace("# fd", "fd")
        .replace("# grid", "grid");
    let config = parse(&text).unwrap();
    let out = config.can_out().unwrap();
    assert_eq!((out.interface.as_deref(), out.grid_frames), (Some("can1"), 208));
    assert!(
        out.to_string().contains("17.54 % of a bus of 500 kbit/s"),
        "{out}"
    );
    let Wheels::Can(wheels) = config.wheels() else {
        panic!("no CAN wheels");
    };
    assert_eq!(wheels.interface.as_deref(), Some("can0"));
    assert!(
        parse(shipped("toyota"))
            .unwrap()
            .can_out()
            .unwrap()
            .interface
            .is_none()
    );
}

/// A calibration file of another tool is the lens, looked for beside the configuration and held to the frames' size.
#[test]
fn yaml_beside_the_configuration_is_the_lens() {
    let folder = tempfile::tempdir().unwrap();
    let text = shipped("kitti").replace("source = \"calib.txt\"", "source = \"front.yaml\"");
    let config = Config::parse(&folder.path().join("car.toml"), &text).unwrap();
    let yaml = "image_width: 1242\nimage_height: 375\ncamera_matrix:\n  data: [721.5, 0, 609.5, 0, 721.5, 172.8, 0, 0, 1]\n";
    std::fs::write(folder.path().join("front.yaml"), yaml).unwrap();
    let elsewhere = Path::new("elsewhere");
    let camera = config.camera_for(elsewhere, 1242, 375).unwrap();
    assert_eq!(camera.lens, Lens::pinhole(721.5, 721.5, 609.5, 172.8));
    let error = config.camera_for(elsewhere, 640, 480).unwrap_err();
    assert!(
        error.message().contains("belongs to images of 1242x375"),
        "{error}"
    );
}
