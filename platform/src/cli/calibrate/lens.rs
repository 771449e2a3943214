//! `freespace calibrate lens` and `import`.

use std::io::IsTerminal as _;

use freespace::frame::Lens;
use serde_json::json;

use super::print_json;
use crate::bad_input::BadInput;
use crate::calibrate::import::{self, Choice};
use crate::calibrate::lens::{Calibration, Picture, Report, View, calibrate, picture, read_folder, report};
use crate::calibrate::lens_table;
use crate::cli::drive::check_apart;
use crate::cli::{Failure, ImportArgs, LensArgs};
use crate::config::ImageSize;

/// Calibrates a lens from pictures.
///
/// # Errors
/// Bad pictures, or too few of them with a board.
pub(super) fn run(args: &LensArgs) -> Result<(), Failure> {
    if let Some(out) = &args.out {
        check_apart(&args.folder, out)?;
    }
    let is_shown = std::io::stderr().is_terminal();
    let (pictures, size) = read_folder(&args.folder, &args.board, &mut |done, of| {
        if is_shown {
            eprint!("\rpicture {done} of {of} ");
        }
    })?;
    if is_shown {
        eprint!("\r{:40}\r", "");
    }
    let views: Vec<View> = pictures
        .iter()
        .filter_map(|picture| picture.view().cloned())
        .collect();
    let calibration = calibrate(&views, args.square, size, args.model).map_err(|error| {
        let with = views.len();
        BadInput::of_file(
            &args.folder,
            format!("{error}: {with} of {} pictures show the board {}", pictures.len(), args.board),
            "take 15 to 20 sharp pictures with the whole board in sight, turned to all sides; --board counts inner corners",
        )
    })?;
    let report = report::judge(&pictures, &views, &calibration, size, args.model, &args.board);
    if let Some(out) = &args.out {
        picture::draw_all(&args.folder, out, &views, &calibration, size).map_err(|error| match error {
            picture::DrawError::Source(bad) => Failure::bad_input(bad),
            write @ picture::DrawError::Write { .. } => Failure::unmet(write.to_string()),
        })?;
    }
    if args.json {
        print_json(&json_of(&calibration, &report, size));
    } else {
        print_text(&pictures, &calibration, &report, size);
        if let Some(out) = &args.out {
            println!(
                "# pictures with corners, and residuals {} times as long: {}",
                picture::MAGNIFIED,
                out.display()
            );
        }
    }
    Ok(())
}

fn json_of(calibration: &Calibration, report: &Report, size: ImageSize) -> serde_json::Value {
    let parameters: serde_json::Map<String, serde_json::Value> = (calibration.parameters.iter())
        .map(|p| (p.name.to_owned(), json!({ "value": p.value, "sigma": p.sigma })))
        .collect();
    json!({
        "model": model_name(&calibration.lens),
        "width": size.width,
        "height": size.height,
        "parameters": parameters,
        "verdict": report.verdict(),
        "report": report,
    })
}

const fn model_name(lens: &Lens) -> &'static str {
    match lens {
        Lens::BrownConrady(_) => "brown_conrady",
        Lens::KannalaBrandt(_) => "kannala_brandt",
    }
}

/// The table to paste, everything else as comments.
fn print_text(pictures: &[Picture], calibration: &Calibration, report: &Report, size: ImageSize) {
    print!("{}", lens_table(&calibration.lens, Some(size)));
    println!("\n# picture                  corners   rms px   tilt");
    for picture in &report.pictures {
        let number = |value: Option<f64>, unit: &str| {
            value.map_or_else(|| "-".to_owned(), |v| format!("{v:.2}{unit}"))
        };
        println!(
            "# {:<24} {:>7} {:>8} {:>8}  {}",
            picture.name,
            picture.corners,
            number(picture.rms_px, ""),
            number(picture.tilt_deg, " deg"),
            picture.outcome.replace('_', " ")
        );
    }
    println!("# standard deviations:");
    for parameter in &calibration.parameters {
        println!(
            "#   {:<3} {:>12.6} +- {:.6}",
            parameter.name, parameter.value, parameter.sigma
        );
    }
    let hfov = report
        .hfov_deg
        .map_or_else(String::new, |angle| format!(", {angle:.1} degrees wide"));
    println!(
        "# {} of {} pictures, {:.3} px rms, {:.0} % of the image covered{hfov}",
        report.views,
        pictures.len(),
        report.rms_px,
        100.0 * report.coverage
    );
    println!("# verdict: {}", report.verdict());
    for finding in &report.findings {
        println!("#   {}: {}", finding.what, finding.fix);
    }
}

/// Prints the lens of another tool's file.
///
/// # Errors
/// A file that is missing, malformed, or of a lens that cannot be expressed.
pub(super) fn import(args: &ImportArgs) -> Result<(), Failure> {
    let choice = Choice {
        model: args.model,
        camera: args.camera.clone(),
    };
    let imported = import::read(&args.file, &choice)?;
    let table = lens_table(&imported.lens, imported.size);
    if args.json {
        print_json(&json!({
            "format": imported.format.name(),
            "model": model_name(&imported.lens),
            "width": imported.size.map(|size| size.width),
            "height": imported.size.map(|size| size.height),
            "table": table,
        }));
        return Ok(());
    }
    println!("# from {}, {}", args.file.display(), imported.format.name());
    if imported.size.is_none() {
        println!("# the file states no image size: add width and height of its pictures to [camera]");
    }
    print!("{table}");
    Ok(())
}
