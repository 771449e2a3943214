//! `freespace calibrate ticks`.

use serde_json::json;

use super::print_json;
use super::recording::{open_wheels, survey_under};
use crate::bad_input::BadInput;
use crate::calibrate::mount::straight_stretches;
use crate::calibrate::ticks::{Ticks, WHEELS, from_distance, from_stretches};
use crate::cli::{Failure, TicksArgs};
use crate::config::{Config, WheelKind};

/// Finds the metres a count.
///
/// # Errors
/// Inputs that are missing or malformed, a message of speeds, or a log or recording that is too short.
pub(super) fn run(args: &TicksArgs) -> Result<(), Failure> {
    let config = Config::load(&args.config)?;
    let (readings, can) = open_wheels(&config, &args.log)?;
    if can.kind == WheelKind::Speeds {
        return Err(BadInput::of_file(
            &args.config,
            "its wheel message carries speeds, which have no metres a count",
            "compare distances with `freespace eval wheels`, and correct the signals' factor in the DBC file",
        )
        .into());
    }
    let unfit = |path: &std::path::Path, error: &dyn std::fmt::Display, fix: &str| {
        BadInput::of_file(path, error, fix)
    };
    let ticks = match (args.distance, &args.visual) {
        (Some(distance_m), _) => from_distance(readings.readings(), &can.odometer, distance_m),
        (None, Some(source)) => {
            let mount = config.camera.mount;
            let survey = survey_under(&config, source, None, &mount, None)?;
            let straight = straight_stretches(&survey).map_err(|error| unfit(source, &error, error.fix()))?;
            from_stretches(readings.readings(), &can.odometer, &straight)
        }
        // The argument parser wants one of them.
        (None, None) => return Err(BadInput::new("no scale is given", "give --distance or --visual").into()),
    };
    let ticks = ticks.map_err(|error| unfit(&args.log, &error, error.fix()))?;
    if args.json {
        print_json(&json!({
            "metres_per_count": ticks.metres_per_count,
            "configured": can.odometer.metres_per_count,
            "odd_wheels": ticks.odd_wheels(),
            "ticks": ticks,
        }));
    } else {
        print_text(
            &ticks,
            can.odometer.metres_per_count,
            config.camera.mount.height_m,
        );
    }
    Ok(())
}

fn print_text(ticks: &Ticks, configured: f64, height_m: f64) {
    println!("[wheels]\nmetres_per_count = {:.7}", ticks.metres_per_count);
    println!(
        "# +- {:.2} %; {:+.2} % of the configured {configured}",
        100.0 * ticks.sigma,
        100.0 * (ticks.metres_per_count / configured - 1.0)
    );
    if let Some(ratios) = &ticks.stretches {
        println!(
            "# from {} straight stretches, one of them +- {:.1} %, at a camera height of {height_m} m: an error of the height is one of the result",
            ratios.count,
            100.0 * ratios.spread / ratios.value
        );
    }
    let counts: Vec<String> = WHEELS
        .iter()
        .zip(ticks.counts)
        .map(|(name, count)| format!("{name} {count:.0}"))
        .collect();
    println!("# counts: {}", counts.join(", "));
    println!(
        "# left over right: front {:+.2} %, rear {:+.2} %; on a straight way it is the tyres, else the turns",
        100.0 * ticks.left_over_right[0],
        100.0 * ticks.left_over_right[1]
    );
    for wheel in ticks.odd_wheels() {
        println!("# {wheel} does not count like the others: stuck, slipping, or another signal");
    }
}
