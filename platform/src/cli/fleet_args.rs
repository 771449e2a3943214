//! What can be said of a fleet on the command line.

use std::path::PathBuf;

use clap::Args;

use crate::eval::fleet::Shard;

/// Arguments of `freespace eval drives`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace eval drives fleet --out parts/0.json
  freespace eval drives fleet.txt --shard 3/8 --out parts/3.json

A drive is the folder of a finished run (it holds report.json), or a recording in MCAP: deadlines, quality and latency are what
it recorded, and accuracy is that of its replay. Truth (any of poses.txt, masks/, grids/) lies in the drive's folder under truth/, or beside NAME.mcap in NAME.truth/.
config/fleet-job.yaml runs the shards on Kubernetes, config/fleet.slurm on Slurm.")]
pub struct DrivesArgs {
    /// A folder of drives, or a text file that names one a line, relative to the file's own folder.
    #[arg(value_name = "LIST|FOLDER")]
    pub source: PathBuf,
    /// Take drive I, I + N, I + 2 N ... of the sorted list, I from 0 to N - 1.
    #[arg(long, value_name = "I/N", default_value_t = Shard::WHOLE)]
    pub shard: Shard,
    /// The part to write, for `freespace eval merge`; one that is finished is kept, and of one with drives that could not be
    /// evaluated those are tried again.
    #[arg(long, value_name = "PART.json")]
    pub out: PathBuf,
    /// Folder of truth: DIR/NAME/ for the drive NAME, or NAME.mcap, of the list.
    #[arg(long, value_name = "DIR")]
    pub truth: Option<PathBuf>,
    /// Configuration to replay recordings with; without it each one's own.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Keep what replays write, a folder a drive; without it they are removed one by one.
    #[arg(long, value_name = "DIR")]
    pub runs: Option<PathBuf>,
    /// Note a drive that cannot be evaluated in the part, and go on; without it the first one ends the shard.
    #[arg(long)]
    pub keep_going: bool,
    /// Evaluate again where the part is there already.
    #[arg(long)]
    pub force: bool,
}

/// Arguments of `freespace eval merge`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace eval merge parts
  freespace eval merge parts/0.json parts/1.json --json
  freespace eval merge parts --out fleet.json --html fleet.html

The total of N shards is that of one, byte for byte: counts are added as integers, and ratios made of the sums.")]
pub struct MergeArgs {
    /// The parts of all shards; a folder stands for its .json files.
    #[arg(value_name = "PART.json|FOLDER", required = true)]
    pub parts: Vec<PathBuf>,
    /// Write the result as JSON too, whole or not at all.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write a page of the result, which stands alone.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Print JSON in place of the table.
    #[arg(long)]
    pub json: bool,
}
