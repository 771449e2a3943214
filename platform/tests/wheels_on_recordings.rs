//! Wheel messages of recorded drives: the decoded values and the distance they add up to.
//!
//! Looks for the recordings where `FREESPACE_DATA` points, else in `../shared/data` beside the repository.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "tests"
)]

use std::fs;
use std::path::{Path, PathBuf};

use freespace::track::WheelReading;
use freespace_platform::wheels::{CandumpOptions, CandumpWheels, WheelDecoder, WheelMapping};

fn recording(test: &str, folder: &str) -> Option<PathBuf> {
    let data = std::env::var_os("FREESPACE_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let found = data.join(folder);
    if found.is_dir() {
        return Some(data);
    }
    eprintln!("SKIPPED {test}: {} is absent", found.display());
    None
}

fn open(dbc: &Path, log: &Path, mapping: &str, offset_micros: i64) -> CandumpWheels {
    let mapping: WheelMapping = toml::from_str(mapping).unwrap();
    let decoder = WheelDecoder::open(dbc, &mapping).unwrap_or_else(|error| panic!("{error}"));
    let options = CandumpOptions {
        interface: None,
        offset_micros,
    };
    CandumpWheels::open(log, &decoder, &options).unwrap_or_else(|error| panic!("{error}"))
}

fn rows(path: &Path, separator: char, header: usize) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(path).unwrap();
    (text.lines().skip(header))
        .map(|line| line.split(separator).map(|word| word.parse().unwrap()).collect())
        .collect()
}

#[test]
fn toyota_wheel_speeds_equal_their_publishers_and_add_up_to_the_distance() {
    let Some(data) = recording("toyota_wheel_speeds", "comma2k19") else {
        return;
    };
    let wheels = open(
        &data.join("opendbc/opendbc/dbc/generator/toyota/_toyota_2017.dbc"),
        &data.join("comma2k19/can.candump"),
        r#"message = "WHEEL_SPEEDS"
kind = "speeds"
signals = ["WHEEL_SPEED_FL", "WHEEL_SPEED_FR", "WHEEL_SPEED_RL", "WHEEL_SPEED_RR"]
faults = ["WHEEL_SPEED_FL_FAULT", "WHEEL_SPEED_FR_FAULT", "WHEEL_SPEED_RL_FAULT", "WHEEL_SPEED_RR_FAULT"]"#,
        0,
    );
    let published = rows(&data.join("comma2k19/wheel_speed.csv"), ',', 1);
    println!("{:?}, {} published", wheels.summary(), published.len());
    assert_eq!(wheels.readings().len(), published.len());

    let mut distance_m = 0.0;
    let mut largest_difference: f64 = 0.0;
    let mut last = None;
    for (reading, published) in wheels.readings().iter().zip(&published) {
        let WheelReading::Speeds { stamp, mps } = *reading else {
            panic!("no speeds")
        };
        assert_eq!(stamp.0, (published[0] * 1e6).round() as u64);
        for (found, published) in mps.iter().zip(&published[1..]) {
            // The publisher's file is rounded to six digits; so is the value compared.
            let rounded = (found * 1e6).round() / 1e6;
            largest_difference = largest_difference.max((rounded - published).abs());
        }
        let mean = mps.iter().sum::<f64>() / 4.0;
        if let Some((before, mean_before)) = last {
            distance_m += 0.5 * (mean + mean_before) * stamp.seconds_since(before);
        }
        last = Some((stamp, mean));
    }
    println!("distance {distance_m:.2} m, largest difference {largest_difference:e} m/s");
    assert!(largest_difference < 1e-9, "{largest_difference:e}");
    assert!((distance_m / 1001.8 - 1.0).abs() < 0.005, "{distance_m}");
}

#[test]
fn kitti_wheel_pulses_add_up_to_the_length_of_the_path() {
    let Some(data) = recording("kitti_wheel_pulses", "kitti_odom03") else {
        return;
    };
    let wheels = open(
        &data.join("opendbc/opendbc/dbc/generator/hyundai/hyundai_can.dbc"),
        &data.join("kitti_odom03/wheel.candump"),
        r#"message = "WHL_PUL11"
kind = "counts"
signals = ["WHL_PUL_FL", "WHL_PUL_FR", "WHL_PUL_RL", "WHL_PUL_RR"]
directions = ["WHL_DIR_FL", "WHL_DIR_FR", "WHL_DIR_RL", "WHL_DIR_RR"]"#,
        -1_700_000_000_000_000,
    );
    println!("{:?}", wheels.summary());
    assert!(wheels.readings()[0].stamp().0 < 20_000);

    let times = rows(&data.join("kitti_odom03/times.txt"), ' ', 0);
    let poses = rows(&data.join("kitti_odom03/poses.txt"), ' ', 0);
    let end_micros = times.last().unwrap()[0] * 1e6;
    let mut counts_travelled = 0_i64;
    let mut last = None;
    for reading in wheels.readings() {
        let WheelReading::Counts {
            stamp,
            counts,
            direction,
        } = *reading
        else {
            panic!("no counts")
        };
        if stamp.0 as f64 > end_micros {
            break;
        }
        assert_eq!(direction, [1; 4]);
        if let Some(before) = last {
            let [_, _, rear_left, rear_right] = std::array::from_fn(|wheel| {
                let before: [u32; 4] = before;
                i64::from(
                    (counts[wheel] as u8)
                        .wrapping_sub(before[wheel] as u8)
                        .cast_signed(),
                )
            });
            counts_travelled += rear_left + rear_right;
        }
        last = Some(counts);
    }
    let distance_m = 0.5 * counts_travelled as f64 * 0.020_312_5;
    let path_m: f64 = (poses.windows(2))
        .map(|pair| {
            (0..3)
                .map(|axis| (pair[1][4 * axis + 3] - pair[0][4 * axis + 3]).powi(2))
                .sum::<f64>()
                .sqrt()
        })
        .sum();
    println!("wheels {distance_m:.2} m, path {path_m:.2} m");
    assert!((distance_m / path_m - 1.0).abs() < 0.005, "{distance_m} {path_m}");
}
