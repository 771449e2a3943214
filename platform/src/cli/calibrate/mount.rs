//! `freespace calibrate mount`.

use serde_json::json;

use super::print_json;
use super::recording::{open_wheels, survey_under};
use crate::bad_input::BadInput;
use crate::calibrate::mount::{MountEstimate, ROUNDS, calibrate};
use crate::calibrate::mount_table;
use crate::calibrate::robust::Robust;
use crate::calibrate::survey::Survey;
use crate::cli::{Failure, MountArgs};
use crate::config::Config;

/// Finds the mount in a recording.
///
/// # Errors
/// Inputs that are missing or malformed, or a recording that stands, is too short or too curved.
pub(super) fn run(args: &MountArgs) -> Result<(), Failure> {
    let config = Config::load(&args.config)?;
    let wheels = args
        .can
        .as_deref()
        .map(|log| open_wheels(&config, log))
        .transpose()?;
    let mut failure = None;
    let found = calibrate(&config.camera.mount, &mut |mount, round| {
        survey_under(&config, &args.source, wheels.as_ref(), mount, Some(round)).unwrap_or_else(|error| {
            failure = Some(error);
            Survey::default()
        })
    });
    if let Some(failure) = failure {
        return Err(failure);
    }
    let estimate = found.map_err(|error| BadInput::of_file(&args.source, error, error.fix()))?;
    let mount = estimate.applied(&config.camera.mount);
    if args.json {
        print_json(&json!({ "mount": {
            "height_m": mount.height_m, "ahead_m": mount.ahead_m, "left_m": mount.left_m,
            "pitch_rad": mount.pitch_rad, "yaw_rad": mount.yaw_rad, "roll_rad": mount.roll_rad,
        }, "estimate": estimate }));
        return Ok(());
    }
    print!("{}", mount_table(&mount));
    print_spreads(&estimate, wheels.is_some());
    Ok(())
}

fn print_spreads(estimate: &MountEstimate, has_wheels: bool) {
    println!(
        "# {} straight stretches, {} left out, {} rounds",
        estimate.stretches, estimate.left_out, estimate.rounds
    );
    if !estimate.is_still {
        println!(
            "# NOT SETTLED: after {ROUNDS} rounds it still moves; put these values into the configuration and run this again, and \
             if that does not help record on a straighter and flatter road"
        );
    }
    let line = |name: &str, unit: &str, value: &Robust| {
        println!(
            "# {name:<24} {:>8.4} {unit} +- {:.4} (one stretch {:.4}, {} of them)",
            value.value, value.sigma, value.spread, value.count
        );
    };
    line("pitch, by travel", "rad", &estimate.pitch_rad);
    line("yaw, by travel", "rad", &estimate.yaw_rad);
    if let Some(pitch) = &estimate.plane_pitch_rad {
        line("pitch, by the road", "rad", pitch);
    }
    match &estimate.roll_rad {
        Some(roll) => {
            line("roll, by the road", "rad", roll);
            println!(
                "# the roll is as configured: the road's crown and verges are in the one seen; take it where the horizon is as tilted"
            );
        }
        None => println!("# roll: not seen well enough, as configured"),
    }
    match &estimate.height_m {
        Some(height) => line("height", "m", height),
        None if has_wheels => {
            println!("# height: the road was seen too seldom or too vaguely, as configured")
        }
        None => println!("# height: as configured; it needs the wheels' scale, give --can"),
    }
    println!("# ahead_m and left_m are not observable on a straight road: measure them");
}
