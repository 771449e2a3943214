//! `freespace can decode`: each frame's signals, whether the module's own are whole, and what the wheel message says.

use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use freespace::emit::can::{self, PLANE_ID, SECTORS_ID, SECTORS_PER_FRAME, STATUS_ID};
use freespace::emit::grid_frames::{self, GRID_CELLS_ID, GRID_HEAD_ID, GridStep};
use freespace::emit::{CanFrame, GridReader};
use freespace::space::Micros;
use freespace::track::WheelReading;
use serde::Serialize;

use super::super::demo::shipped;
use super::super::{CanDecodeArgs, Failure};
use super::read_log;
use crate::bad_input::BadInput;
use crate::can::{CanMonitor, Catalogue, SignalValue, WireFault};
use crate::config::{Config, Wheels};
use crate::wheels::WheelDecoder;
use crate::wheels::candump_line::FrameKind;

/// How long a live reader waits before it looks whether its time is over.
const LOOK: Duration = Duration::from_millis(100);
/// Names of the module's messages begin so.
const PREFIX: &str = "FREESPACE_";
/// Number of the sector frames, whose identifiers follow one another.
const SECTOR_FRAMES: u32 = 8;
const _: () = assert!(SECTOR_FRAMES as usize == freespace::budget::SECTORS / SECTORS_PER_FRAME);

/// One frame, as it is printed.
#[derive(Serialize)]
struct Line<'a> {
    stamp_s: f64,
    interface: &'a str,
    id: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    message: Option<&'a str>,
    signals: Vec<SignalValue<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    e2e: Option<Verdict>,
    #[serde(skip_serializing_if = "Option::is_none")]
    wheels: Option<Wheel>,
}

/// Whether a frame of the module is whole.
#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case")]
enum Verdict {
    Ok { counter: u8 },
    Wrong,
}

/// What the wheel message gave.
#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case")]
enum Wheel {
    Counts([u32; 4]),
    Mps([f64; 4]),
    Refused(&'static str),
}

/// What all frames came to.
#[derive(Default, Serialize)]
struct Summary {
    frames: u64,
    described: u64,
    e2e_ok: u64,
    e2e_wrong: u64,
    grids: u64,
    grids_refused: u64,
    readings: u64,
    readings_refused: u64,
}

/// Decodes a log or an interface.
///
/// # Errors
/// A DBC, log, configuration or interface that cannot be read.
pub(super) fn run(args: &CanDecodeArgs) -> Result<(), Failure> {
    let dbc = args
        .dbc
        .clone()
        .unwrap_or_else(|| shipped("config/freespace.dbc"));
    let mut decoding = Decoding {
        catalogue: Catalogue::open(&dbc)?,
        wheels: wheels(args)?,
        grids: GridReader::new(freespace::budget::MAX_CELLS),
        all: args.all,
        json: args.json,
        out: BufWriter::new(std::io::stdout()),
        summary: Summary::default(),
    };
    let source = Path::new(&args.source);
    if source.is_file() {
        read_log(source, &mut |frame| match frame.kind {
            FrameKind::Data | FrameKind::Fd => decoding.take(
                frame.stamp.0,
                frame.interface,
                frame.id,
                frame.is_extended,
                frame.data(),
            ),
            FrameKind::Remote | FrameKind::Error => true,
        })?;
    } else if Path::new("/sys/class/net").join(&args.source).exists() {
        live(args, &mut decoding).map_err(|fault| {
            BadInput::new(
                format!("{}: {fault}", args.source),
                "freespace doctor --config FILE checks an interface",
            )
        })?;
    } else {
        return Err(BadInput::new(
            format!("{} is neither a file nor an interface", args.source),
            "give a candump log, or an interface that `ip link show type can` lists",
        )
        .into());
    }
    decoding.finish();
    Ok(())
}

fn wheels(args: &CanDecodeArgs) -> Result<Option<WheelDecoder>, Failure> {
    let Some(path) = &args.config else {
        return Ok(None);
    };
    let Wheels::Can(wheels) = Config::load(path)?.wheels() else {
        return Err(BadInput::new(
            format!("{} describes no wheel message", path.display()),
            "add [wheels] with `source = \"can\"`, dbc, message and signals, or leave --config out",
        )
        .into());
    };
    let decoder = WheelDecoder::open(&wheels.dbc, &wheels.mapping()).map_err(Failure::bad_input)?;
    Ok(Some(decoder))
}

fn live(args: &CanDecodeArgs, decoding: &mut Decoding) -> Result<(), WireFault> {
    let mut monitor = CanMonitor::open(&args.source)?;
    let end = args
        .seconds
        .map(|seconds| Instant::now() + Duration::from_secs_f64(seconds));
    while end.is_none_or(|end| Instant::now() < end) {
        let Some(frame) = monitor.next_frame(LOOK)? else {
            // A reader of a pipe sees what came without waiting for more.
            let _ = decoding.out.flush();
            continue;
        };
        if !decoding.take(
            frame.stamp_micros,
            &args.source,
            frame.id,
            frame.is_extended,
            frame.data(),
        ) {
            break;
        }
    }
    Ok(())
}

/// All that decoding needs.
struct Decoding {
    catalogue: Catalogue,
    wheels: Option<WheelDecoder>,
    grids: GridReader,
    all: bool,
    json: bool,
    out: BufWriter<std::io::Stdout>,
    summary: Summary,
}

impl Decoding {
    /// Prints a frame; false once nobody reads any more.
    fn take(&mut self, stamp_micros: u64, interface: &str, id: u32, is_extended: bool, data: &[u8]) -> bool {
        self.summary.frames += 1;
        // Another car's bus may have these identifiers for its own messages: the DBC says whose they are.
        let is_described =
            (self.catalogue.message(id, is_extended)).is_some_and(|message| message.name.starts_with(PREFIX));
        let e2e = (is_described && is_ours(id) && !is_extended).then(|| self.verdict(id, data));
        let wheels = self.wheel(id, is_extended, data, Micros(stamp_micros));
        let message = self.catalogue.message(id, is_extended);
        self.summary.described += u64::from(message.is_some());
        if message.is_none() && wheels.is_none() && !self.all {
            return true;
        }
        #[expect(clippy::cast_precision_loss, reason = "2^52 us are 142 years")]
        let stamp_s = stamp_micros as f64 * 1e-6;
        let line = Line {
            stamp_s,
            interface,
            id,
            message: message.map(|message| message.name.as_str()),
            signals: message.map_or_else(Vec::new, |message| message.values(data).collect()),
            e2e,
            wheels,
        };
        let written = if self.json {
            // A line always has a JSON form.
            writeln!(self.out, "{}", serde_json::to_string(&line).unwrap_or_default())
        } else {
            writeln!(self.out, "{}", text_of(&line))
        };
        written.is_ok()
    }

    /// Whether a frame of the module is whole.
    fn verdict(&mut self, id: u32, data: &[u8]) -> Verdict {
        let mut frame = CanFrame {
            id,
            ..CanFrame::default()
        };
        // At most 64 bytes, for which there is room.
        let _ = frame.data.extend_from_slice(data);
        let is_grid = matches!(id, GRID_HEAD_ID | GRID_CELLS_ID);
        let counter = if is_grid {
            match self.grids.take(&frame) {
                Ok(GridStep::Complete) => self.summary.grids += 1,
                Ok(GridStep::Ignored | GridStep::Taken) => {}
                Err(_) => self.summary.grids_refused += 1,
            }
            grid_frames::check(&frame)
        } else {
            can::check(&frame).ok()
        };
        if counter.is_some() {
            self.summary.e2e_ok += 1;
        } else {
            self.summary.e2e_wrong += 1;
        }
        counter.map_or(Verdict::Wrong, |counter| Verdict::Ok { counter })
    }

    fn wheel(&mut self, id: u32, is_extended: bool, data: &[u8], stamp: Micros) -> Option<Wheel> {
        let decoded = self.wheels.as_mut()?.decode(id, is_extended, data, stamp)?;
        Some(match decoded {
            Ok(reading) => {
                self.summary.readings += 1;
                match reading {
                    WheelReading::Counts { counts, .. } => Wheel::Counts(counts),
                    WheelReading::Speeds { mps, .. } => Wheel::Mps(mps),
                }
            }
            Err(fault) => {
                self.summary.readings_refused += 1;
                Wheel::Refused(fault.name())
            }
        })
    }

    fn finish(mut self) {
        let summary = &self.summary;
        // Where nobody reads any more there is nobody to tell.
        let _ = if self.json {
            writeln!(
                self.out,
                "{}",
                serde_json::json!({ "summary": serde_json::to_value(summary).unwrap_or_default() })
            )
        } else {
            writeln!(
                self.out,
                "{} frames, {} described; end to end {} ok, {} wrong{}; grids {} whole, {} refused; wheels {} readings, {} refused",
                summary.frames,
                summary.described,
                summary.e2e_ok,
                summary.e2e_wrong,
                whose(summary),
                summary.grids,
                summary.grids_refused,
                summary.readings,
                summary.readings_refused
            )
        };
        let _ = self.out.flush();
    }
}

/// What to think of frames none of which is whole.
const fn whose(summary: &Summary) -> &'static str {
    if summary.e2e_ok == 0 && summary.e2e_wrong > 0 {
        " (none is the module's: another device has its identifiers; give that bus's --dbc)"
    } else {
        ""
    }
}

const fn is_ours(id: u32) -> bool {
    matches!(id, STATUS_ID..=PLANE_ID | GRID_HEAD_ID | GRID_CELLS_ID)
        || (id >= SECTORS_ID && id < SECTORS_ID + SECTOR_FRAMES)
}

fn text_of(line: &Line<'_>) -> String {
    use std::fmt::Write as _;
    let name = line.message.unwrap_or("-");
    let mut text = format!(
        "{:.6} {} {:03X} {name:<22}",
        line.stamp_s, line.interface, line.id
    );
    // A `String` takes all that is written to it, here and below.
    for signal in &line.signals {
        let _ = write!(text, " {}={}", signal.name, rounded(signal.value));
        match signal.word {
            Some(word) => {
                let _ = write!(text, " ({word})");
            }
            None => text.push_str(signal.unit),
        }
    }
    match line.e2e {
        Some(Verdict::Ok { counter }) => {
            let _ = write!(text, "  e2e ok {counter}");
        }
        Some(Verdict::Wrong) => text.push_str("  e2e WRONG"),
        None => {}
    }
    match line.wheels {
        Some(Wheel::Counts(counts)) => {
            let _ = write!(text, "  wheels {counts:?}");
        }
        Some(Wheel::Mps(mps)) => {
            let _ = write!(text, "  wheels {:?} m/s", mps.map(rounded));
        }
        Some(Wheel::Refused(why)) => {
            let _ = write!(text, "  wheels REFUSED: {why}");
        }
        None => {}
    }
    text
}

/// Without the last digits of binary fractions.
fn rounded(value: f64) -> f64 {
    let rounded = (value * 1e6).round() / 1e6;
    if rounded.is_finite() { rounded } else { value }
}
