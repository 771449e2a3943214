//! What can be said after `freespace calibrate`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::calibrate::lens::Board;
use crate::config::LensModel;

/// What to calibrate.
#[derive(Debug, Subcommand)]
pub enum CalibrateCommand {
    /// The lens, from pictures of a chessboard.
    Lens(LensArgs),
    /// The lens, from the file of another tool: OpenCV, ROS camera_info or Kalibr YAML.
    Import(ImportArgs),
    /// The camera's pitch, yaw, roll and height, from a recording of straight driving.
    Mount(MountArgs),
    /// Metres a count of the wheel encoders, from a known distance or a recording.
    Ticks(TicksArgs),
}

/// Arguments of `freespace calibrate lens`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace calibrate lens pictures --board 9x6 --square 0.025
  freespace calibrate lens pictures --board 9x6 --square 0.025 --model kannala_brandt --out corners")]
pub struct LensArgs {
    /// Folder of PNG or JPEG pictures of the board, 15 to 30 of them.
    pub folder: PathBuf,
    /// Inner corners of the board, columns x rows: 9x6 for 10x7 squares.
    #[arg(long, value_name = "CxR")]
    pub board: Board,
    /// Side of a square in metres.
    #[arg(long, value_name = "METRES", value_parser = metres)]
    pub square: f64,
    /// Lens model; kannala_brandt for a lens wider than 110 degrees.
    #[arg(long, value_enum, default_value_t = LensModel::BrownConrady)]
    pub model: LensModel,
    /// Folder for pictures with the corners found and how far each is off.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace calibrate import`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace calibrate import camera.yaml
  freespace calibrate import camchain.yaml --camera cam1")]
pub struct ImportArgs {
    /// Calibration in YAML.
    pub file: PathBuf,
    /// Camera of a Kalibr chain; the first without it.
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Lens model, where the file does not state it; brown_conrady without it.
    #[arg(long, value_enum)]
    pub model: Option<LensModel>,
    /// Print JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace calibrate mount`.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  freespace calibrate mount drive --config config/kitti.toml --can drive/wheel.candump")]
pub struct MountArgs {
    /// Recording of straight driving: a KITTI odometry folder or a folder of PNG or JPEG files.
    pub source: PathBuf,
    /// Vehicle and camera; its mount is where the search begins.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// candump log with the wheel message that the configuration describes; without it there is no height.
    #[arg(long, value_name = "LOG")]
    pub can: Option<PathBuf>,
    /// Print JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `freespace calibrate ticks`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace calibrate ticks way.candump --config car.toml --distance 200
  freespace calibrate ticks drive/wheel.candump --config config/kitti.toml --visual drive")]
pub struct TicksArgs {
    /// candump log with the wheel message that the configuration describes.
    pub log: PathBuf,
    /// Vehicle and camera; its metres_per_count may be a guess.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Metres that were driven during the whole log.
    #[arg(long, value_name = "METRES", value_parser = metres, required_unless_present = "visual")]
    pub distance: Option<f64>,
    /// Recording of the same drive: the scale comes from the configured camera height.
    #[arg(long, value_name = "SOURCE", conflicts_with = "distance")]
    pub visual: Option<PathBuf>,
    /// Print JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}

fn metres(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if (1e-4..=1e6).contains(&value) => Ok(value),
        _ => Err("give metres, more than 0.0001".to_owned()),
    }
}
