//! Two plays against each other and against the limits that are kept in a file.

use std::path::{Path, PathBuf};

use clap::Args;

use super::Figures;

/// What is compared.
#[derive(Args)]
pub(crate) struct CheckArgs {
    /// Figures of the play on an idle host.
    idle: PathBuf,
    /// Figures of the play beside a load.
    loaded: PathBuf,
    /// The limits: a figures file that no figure may exceed.
    #[arg(long, value_name = "FILE", default_value = "hil/gauge.json")]
    limits: PathBuf,
    /// Write new limits: what was measured, and a tenth more.
    #[arg(long)]
    keep: bool,
}

/// Room in new limits.
const SPARE: f64 = 1.1;

/// Two plays differ by less: the counted clock does not see the host. A lesson that comes before another frame makes another
/// drive of it, idle or loaded alike, in which the median of *map* is 1.2 % off.
const SAME: f64 = 0.02;
/// A figure smaller than this is decided by the microsecond that it is rounded to, thousands of instructions.
const SMALL: f64 = 200.0;

/// Prints the table; whether the plays agree and keep the limits.
pub(crate) fn check(args: &CheckArgs) -> bool {
    let read = |path: &Path| -> Option<Figures> {
        let text = std::fs::read_to_string(path).ok()?;
        serde_json::from_str(&text).ok()
    };
    let (Some(idle), Some(loaded)) = (read(&args.idle), read(&args.loaded)) else {
        eprintln!("gauge: figures cannot be read");
        return false;
    };
    if args.keep && !keep(&args.limits, &idle) {
        return false;
    }
    let Some(limits) = read(&args.limits) else {
        eprintln!(
            "gauge: {}: no limits can be read; write them with `hil/rig --limits gauge`",
            args.limits.display()
        );
        return false;
    };
    let mut is_well = true;
    println!(
        "{:<22}{:>12}{:>12}{:>9}{:>12}",
        "thousand instructions", "idle", "loaded", "apart", "limit"
    );
    for (name, idle, loaded, limit) in rows(&idle, &loaded, &limits) {
        let apart = (idle - loaded).abs() / idle.max(loaded).max(f64::MIN_POSITIVE);
        // A stage that was not measured agrees with nothing.
        let agrees = apart <= SAME || (idle < SMALL && loaded < SMALL);
        let keeps = idle <= limit && loaded <= limit;
        let verdict = match (agrees, keeps) {
            (true, true) => "",
            (false, _) => "  APART",
            (true, false) => "  OVER",
        };
        is_well &= agrees && keeps;
        println!(
            "{name:<22}{idle:>12.0}{loaded:>12.0}{:>8.2}%{limit:>12.0}{verdict}",
            100.0 * apart
        );
    }
    println!(
        "{} and {} key frames, {} and {} misses",
        idle.key_frames, loaded.key_frames, idle.misses, loaded.misses
    );
    if idle.network_is_recorded {
        println!("the network's answers were recorded: *segmentation* is what is left without it");
    }
    let is_whole = idle.key_frames.min(loaded.key_frames) >= limits.key_frames;
    if !is_whole {
        println!("{} key frames were wanted", limits.key_frames);
    }
    is_well && is_whole && idle.misses + loaded.misses == 0
}

/// Writes limits that these figures keep.
fn keep(path: &Path, figures: &Figures) -> bool {
    let limits = Figures {
        stages: (figures.stages.iter())
            .map(|(name, value)| (name.clone(), (value * SPARE).ceil()))
            .collect(),
        capture_to_can_p50: (figures.capture_to_can_p50 * SPARE).ceil(),
        capture_to_can_p99: (figures.capture_to_can_p99 * SPARE).ceil(),
        capture_to_can_max: (figures.capture_to_can_max * SPARE).ceil(),
        ..figures.clone()
    };
    let text = serde_json::to_string_pretty(&limits).unwrap_or_default() + "\n";
    let written = std::fs::write(path, text);
    if let Err(error) = &written {
        eprintln!("{}: cannot be written: {error}", path.display());
    }
    written.is_ok()
}

type Line = (String, f64, f64, f64);

fn rows(idle: &Figures, loaded: &Figures, limits: &Figures) -> Vec<Line> {
    let of = |figures: &Figures, name: &str| {
        let found = figures.stages.iter().find(|(stage, _)| stage == name);
        found.map_or(f64::NAN, |(_, value)| *value)
    };
    // A stage that the limits know and nobody measured is as wrong as one that they do not know.
    let mut names: Vec<&String> = [limits, idle, loaded]
        .into_iter()
        .flat_map(|figures| figures.stages.iter().map(|(name, _)| name))
        .collect();
    names.sort();
    names.dedup();
    let stages = names
        .into_iter()
        .map(|name| (name.clone(), of(idle, name), of(loaded, name), of(limits, name)));
    let latency = [
        (
            "capture to CAN p50",
            idle.capture_to_can_p50,
            loaded.capture_to_can_p50,
            limits.capture_to_can_p50,
        ),
        (
            "capture to CAN p99",
            idle.capture_to_can_p99,
            loaded.capture_to_can_p99,
            limits.capture_to_can_p99,
        ),
        (
            "capture to CAN max",
            idle.capture_to_can_max,
            loaded.capture_to_can_max,
            limits.capture_to_can_max,
        ),
    ];
    let latency = latency.map(|(name, idle, loaded, limit)| (name.to_owned(), idle, loaded, limit));
    stages.chain(latency).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(stage: f64) -> Figures {
        Figures {
            stages: vec![("map".to_owned(), stage)],
            ..Figures::default()
        }
    }

    #[test]
    fn a_stage_that_the_limits_do_not_know_keeps_no_limit() {
        let unknown = Figures::default();
        let row = &rows(&figures(1000.0), &figures(1000.0), &unknown)[0];
        assert!(!(row.1 <= row.3));
    }
}
