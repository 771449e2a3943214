//! `freespace eval`: results and truth in, a short table or JSON out.

use std::path::Path;

use freespace::space::{Micros, Pose};
use freespace::track::{WheelOdometer, WheelReading};
use serde::Serialize;

use super::{EvalCommand, Failure, fleet};
use crate::bad_input::{BadInput, read_text};
use crate::config::{Config, Wheels};
use crate::eval::{Truth, grid, masks, page, trajectory};
use crate::wheels::{CandumpOptions, CandumpWheels, WheelDecoder};
use crate::whole_file::write_whole;

/// What `--json` prints.
#[derive(Serialize)]
struct Json {
    truth: Truth,
}

/// Runs a comparison and prints it.
///
/// # Errors
/// Where an input is missing, malformed, or does not belong to the other.
pub fn run(command: &EvalCommand) -> Result<(), Failure> {
    match command {
        EvalCommand::Masks {
            predictions,
            truth_dir,
            truth,
            frames,
            html,
            json,
        } => {
            let score = masks::compare_folders(predictions, truth_dir, *truth)?;
            if let Some(html) = html {
                let text = page::render_masks(&score, predictions, truth_dir, *truth)?;
                write_whole(html, text.as_bytes())?;
            }
            if *json {
                print_json(Truth::default().with_road(&score.pooled, score.frames.len()));
            } else {
                print_masks(&score, *frames);
            }
        }
        EvalCommand::Trajectory {
            estimate,
            truth,
            times,
            html,
            json,
        } => {
            let (poses, true_poses) = paired_trajectories(estimate, truth, times.as_deref())?;
            let score = compare_trajectories(estimate, &poses, &true_poses)?;
            if let Some(html) = html {
                let names = (&*estimate.to_string_lossy(), &*truth.to_string_lossy());
                let text = page::render_trajectory(&score, &poses, &true_poses, names);
                write_whole(html, text.as_bytes())?;
            }
            if *json {
                print_json(Truth::default().with_trajectory(&score));
            } else {
                print_trajectory(&score);
            }
        }
        EvalCommand::Drives(args) => fleet::drives(args)?,
        EvalCommand::Merge(args) => fleet::merge(args)?,
        EvalCommand::Wheels { log, config, json } => wheels(log, config, *json)?,
        EvalCommand::Grid {
            predictions,
            truth_dir,
            range,
            html,
            json,
        } => {
            if range.is_nan() || *range <= 0.0 {
                let message = format!("--range {range} holds no cell");
                return Err(BadInput::new(message, "give metres ahead, such as --range 30").into());
            }
            let score = grid::compare_folders(predictions, truth_dir, &(0.0..*range))?;
            if let Some(html) = html {
                let text = page::render_grid(&score, predictions, truth_dir, *range)?;
                write_whole(html, text.as_bytes())?;
            }
            if *json {
                print_json(Truth::default().with_grid(&score.pooled));
            } else {
                print_grid(&score, *range);
            }
        }
    }
    Ok(())
}

/// Reads and pairs two trajectory files.
///
/// # Errors
/// Where a file is missing or malformed, or the two have no pose in common.
fn paired_trajectories(
    estimate: &Path,
    truth: &Path,
    times: Option<&Path>,
) -> Result<(Vec<Pose>, Vec<Pose>), BadInput> {
    let times = times.map(read_times).transpose()?;
    trajectory::associate(
        (estimate, trajectory::read(estimate)?),
        (truth, trajectory::read(truth)?),
        times.as_deref(),
    )
}

/// Compares what is paired.
///
/// # Errors
/// Fewer than two pairs.
fn compare_trajectories(
    estimate: &Path,
    poses: &[Pose],
    true_poses: &[Pose],
) -> Result<trajectory::TrajectoryScore, BadInput> {
    trajectory::compare(poses, true_poses).ok_or_else(|| {
        BadInput::of_file(
            estimate,
            "has fewer than two poses to compare",
            "compare a longer run",
        )
    })
}

fn read_times(path: &Path) -> Result<Vec<f64>, BadInput> {
    let fix = "write one time in seconds a line";
    let text = read_text(path, fix)?;
    text.lines()
        .enumerate()
        .filter(|(_, row)| !row.trim().is_empty())
        .map(|(line, row)| {
            let fault = |_| BadInput::at_line(path, &text, line, format!("`{}` is no time", row.trim()), fix);
            row.trim().parse().map_err(fault)
        })
        .collect()
}

fn print_json(truth: Truth) {
    println!(
        "{}",
        serde_json::to_string_pretty(&Json { truth }).unwrap_or_default()
    );
}

fn print_missing(missing: &[String]) {
    if !missing.is_empty() {
        println!("without a prediction: {} ({})", missing.len(), missing.join(", "));
    }
}

fn print_masks(score: &masks::MaskScore, each: bool) {
    let line = |name: &str, count: &masks::PixelCount| {
        let (precision, recall, f) = (count.precision(), count.recall(), count.f());
        println!(
            "{name:<24} {:>9.2} {:>8.2} {:>8.2}",
            100.0 * precision,
            100.0 * recall,
            100.0 * f
        );
    };
    println!("{:<24} {:>9} {:>8} {:>8}", "road, %", "precision", "recall", "F");
    for (name, count) in score.frames.iter().filter(|_| each) {
        line(name, count);
    }
    line(&format!("{} frames pooled", score.frames.len()), &score.pooled);
    print_missing(&score.missing);
}

fn print_trajectory(score: &trajectory::TrajectoryScore) {
    println!("poses                    {:>10}", score.poses);
    println!("true path                {:>10.2} m", score.distance_m);
    println!("estimated path           {:>10.2} m", score.estimated_distance_m);
    println!("ATE, SE(3) alignment     {:>10.3} m", score.ate_se3_m);
    if let (Some(ate), Some(scale)) = (score.ate_sim3_m, score.scale) {
        println!("ATE, Sim(3) alignment    {ate:>10.3} m");
        println!("scale error              {:>10.3} %", 100.0 * (scale - 1.0).abs());
    }
    match &score.segments {
        Some(segments) => {
            println!("segments of 100 to 800 m {:>10}", segments.count);
            println!(
                "  translation            {:>10.3} %",
                segments.translation_percent
            );
            println!(
                "  rotation               {:>10.5} deg/m",
                segments.rotation_deg_per_m
            );
        }
        None => println!("segments of 100 to 800 m       none: the path is too short"),
    }
}

fn print_grid(score: &grid::GridScore, range_m: f64) {
    println!("key frames               {:>10}", score.frames.len());
    println!("cells seen, 0 to {range_m:.0} m  {:>10}", score.pooled.seen);
    println!("free-space IoU           {:>10.4}", score.pooled.iou());
    println!("falsely free cells       {:>10}", score.pooled.falsely_free);
    print_missing(&score.missing);
}

/// Distance and duration of a CAN log, through the same odometer as a drive's.
fn wheels(log: &Path, config: &Path, json: bool) -> Result<(), Failure> {
    let Wheels::Can(wheels) = Config::load(config)?.wheels() else {
        let message = format!("{} describes no CAN message", config.display());
        return Err(BadInput::new(
            message,
            "set source = \"can\", dbc, message and signals in [wheels]",
        )
        .into());
    };
    let decoder = WheelDecoder::open(&wheels.dbc, &wheels.mapping()).map_err(Failure::bad_input)?;
    let options = CandumpOptions {
        interface: None,
        offset_micros: wheels.offset_micros(),
    };
    let readings = CandumpWheels::open(log, &decoder, &options).map_err(Failure::bad_input)?;
    let mut odometer = WheelOdometer::new(wheels.odometer);
    for reading in readings.readings() {
        odometer.push(*reading);
    }
    let distance_m = odometer
        .newest()
        .and_then(|stamp| odometer.travel_at(stamp))
        .map_or(0.0, |t| t.distance_m);
    let first = readings.readings().first().map_or(Micros(0), WheelReading::stamp);
    let seconds = odometer.newest().map_or(0.0, |stamp| stamp.seconds_since(first));
    let (count, rejected) = (readings.readings().len(), odometer.rejected());
    if json {
        let value = serde_json::json!({
            "readings": count, "rejected": rejected, "seconds": seconds, "distance_m": distance_m,
        });
        println!("{value:#}");
    } else {
        println!("readings    {count}, {rejected} rejected, over {seconds:.1} s");
        println!("distance    {distance_m:.1} m");
    }
    Ok(())
}
