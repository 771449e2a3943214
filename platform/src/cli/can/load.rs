//! `freespace can load`: what the module's publications, and the frames of a log, cost a bus.

use std::collections::BTreeSet;
use std::path::Path;

use freespace::emit::{BitRates, BusLoad};
use serde::Serialize;

use super::super::demo::{SHIPPED, shipped};
use super::super::{CanLoadArgs, Failure};
use super::read_log;
use crate::bad_input::BadInput;
use crate::config::{CanOut, Config};
use crate::wheels::candump_line::FrameKind;

/// What is printed.
#[derive(Serialize)]
struct Loads {
    bit_rate: u32,
    data_bit_rate: u32,
    publications: Load,
    #[serde(skip_serializing_if = "Option::is_none")]
    log: Option<LogLoad>,
}

/// A load.
#[derive(Serialize)]
struct Load {
    frames_per_second: f64,
    bits_per_second: f64,
    share: f64,
}

/// The load of a log.
#[derive(Serialize)]
struct LogLoad {
    frames: u64,
    seconds: f64,
    mean_share: f64,
    busiest_second_share: f64,
}

/// Prints the loads.
///
/// # Errors
/// A configuration or log that cannot be read.
pub(super) fn run(args: &CanLoadArgs) -> Result<(), Failure> {
    let path = args.config.clone().unwrap_or_else(|| shipped(SHIPPED));
    let config = Config::load(&path)?;
    let out = config.can_out().ok_or_else(|| {
        // A configuration that was read has a plan.
        BadInput::of_file(&path, "its [can] has no plan", "correct [can]")
    })?;
    let log = args
        .log
        .as_deref()
        .map(|log| log_load(log, args.interface.as_deref(), out.rates))
        .transpose()?;
    let loads = Loads {
        bit_rate: out.rates.nominal,
        data_bit_rate: out.rates.data,
        publications: Load::of(out.load()),
        log,
    };
    if args.json {
        // Loads always have a JSON form.
        println!("{}", serde_json::to_string_pretty(&loads).unwrap_or_default());
    } else {
        print!("{}", text_of(&loads, &out));
    }
    Ok(())
}

impl Load {
    const fn of(load: BusLoad) -> Self {
        Self {
            frames_per_second: load.frames_per_second,
            bits_per_second: load.bits_per_second,
            share: load.share,
        }
    }
}

/// The load of one bus: that of `interface`, or of the only one in the log.
#[expect(clippy::cast_precision_loss, reason = "nanoseconds of a log")]
fn log_load(path: &Path, interface: Option<&str>, rates: BitRates) -> Result<LogLoad, BadInput> {
    let (mut frames, mut busy_ns, mut busiest_ns) = (0, 0, 0);
    let (mut first, mut last) = (None, 0);
    let (mut second, mut second_ns) = (0, 0);
    let mut interfaces = BTreeSet::new();
    read_log(path, &mut |frame| {
        if !interfaces.contains(frame.interface) {
            interfaces.insert(frame.interface.to_owned());
        }
        if interface.is_some_and(|wanted| wanted != frame.interface) {
            return true;
        }
        let is_fd = frame.kind == FrameKind::Fd;
        if frame.kind != FrameKind::Error {
            let nanos = rates.nanos(frame.data().len(), frame.is_extended, is_fd);
            frames += 1;
            busy_ns += nanos;
            if frame.stamp.0 / 1_000_000 != second {
                second = frame.stamp.0 / 1_000_000;
                second_ns = 0;
            }
            second_ns += nanos;
            busiest_ns = busiest_ns.max(second_ns);
            first.get_or_insert(frame.stamp.0);
            last = last.max(frame.stamp.0);
        }
        true
    })?;
    check_interface(path, interface, &interfaces)?;
    let micros = first.map_or(0, |first: u64| last.saturating_sub(first));
    if micros == 0 {
        return Err(BadInput::of_file(
            path,
            "the log has no two frames at different times",
            "record for some seconds with `candump -L`",
        ));
    }
    let seconds = micros as f64 * 1e-6;
    Ok(LogLoad {
        frames,
        seconds,
        mean_share: busy_ns as f64 * 1e-9 / seconds,
        busiest_second_share: busiest_ns as f64 * 1e-9,
    })
}

/// Loads of several buses do not add up to one.
fn check_interface(path: &Path, wanted: Option<&str>, found: &BTreeSet<String>) -> Result<(), BadInput> {
    let names = || found.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    match wanted {
        None if found.len() > 1 => Err(BadInput::of_file(
            path,
            format!("the log holds frames of {} interfaces: {}", found.len(), names()),
            "pick one with --interface",
        )),
        Some(wanted) if !found.contains(wanted) && !found.is_empty() => Err(BadInput::of_file(
            path,
            format!("the log holds no frame of {wanted}, but of {}", names()),
            "give one of these after --interface",
        )),
        _ => Ok(()),
    }
}

fn text_of(loads: &Loads, out: &CanOut) -> String {
    let mut text = format!("publications {out} (worst-case stuffing)\n");
    if let Some(log) = &loads.log {
        text.push_str(&format!(
            "log          {} frames in {:.1} s: {:.1} % of the bus, {:.1} % in the busiest second\n",
            log.frames,
            log.seconds,
            100.0 * log.mean_share,
            100.0 * log.busiest_second_share
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn buses_of_a_log_are_not_added_up() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("two.candump");
        let line = |second: u64, name: &str| format!("({second}.000000) {name} 123#0011223344556677\n");
        let both: String = (1..5).map(|s| line(s, "can0") + &line(s, "can1")).collect();
        std::fs::write(&path, both).unwrap();
        let rates = BitRates {
            nominal: 500_000,
            data: 2_000_000,
        };
        let refused = log_load(&path, None, rates).err().unwrap();
        assert!(
            refused.message().contains("2 interfaces: can0, can1"),
            "{refused}"
        );
        assert!(refused.fix().contains("--interface"));
        assert_eq!(log_load(&path, Some("can1"), rates).unwrap().frames, 4);
        let refused = log_load(&path, Some("can7"), rates).err().unwrap();
        assert!(
            refused.message().contains("no frame of can7, but of can0, can1"),
            "{refused}"
        );
    }
}
