//! Listens to the module on the bus: every frame with the time it came, and the publications that they make.
//!
//! Frames are read by what `config/freespace.dbc` says of them, not by the module's own encoder.

use std::fmt::Write as _;
use std::io::ErrorKind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use freespace::health::{Faults, QualityLevel};
use socketcan::{
    CanAnyFrame, CanFdSocket, CanFilter, EmbeddedFrame as _, Id, Socket as _, SocketOptions as _,
};

use crate::clock::now_micros;
use crate::feed::spawn;

/// Under the feeds alone.
const PRIORITY: u8 = 59;
const STATUS: u32 = 0x600;
pub(crate) const TIMING: u32 = 0x601;
const GRID_HEAD: u32 = 0x620;
/// Identifiers of the module: 0x600 to 0x63F.
const IDS: (u32, u32) = (0x600, 0x7C0);

/// A frame on the bus.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) at_micros: u64,
    pub(crate) id: u32,
    pub(crate) data: Vec<u8>,
    pub(crate) is_fd: bool,
}

/// One publication: its status and timing frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heard {
    /// When the timing frame came.
    pub(crate) at_micros: u64,
    pub(crate) level: QualityLevel,
    pub(crate) faults: Faults,
    pub(crate) sequence: u8,
    /// As the module says it.
    pub(crate) capture_to_publish_ms: f64,
    /// Until the head of its grid came, which follows at once; none where no grid did.
    pub(crate) capture_to_bus_ms: Option<f64>,
}

impl Heard {
    /// From the capture on: as the module says it, or as it was seen, where that is later.
    pub(crate) fn latency_ms(&self) -> f64 {
        self.capture_to_publish_ms
            .max(self.capture_to_bus_ms.unwrap_or(0.0))
    }

    /// Nothing held this answer back, apart from `expected` faults.
    pub(crate) fn is_good(&self, expected: Faults) -> bool {
        self.level <= QualityLevel::NoRefinement && self.faults.0 & !expected.0 == 0
    }
}

/// Listens until dropped.
pub(crate) struct Listener {
    frames: Arc<Mutex<Vec<Frame>>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Listener {
    pub(crate) fn start(interface: &str) -> std::io::Result<Self> {
        let frames = Arc::new(Mutex::new(Vec::new()));
        let is_over = Arc::new(AtomicBool::new(false));
        let ear = Ear {
            interface: interface.to_owned(),
            frames: Arc::clone(&frames),
            is_over: Arc::clone(&is_over),
        };
        // Above the module: what it hears late would look as if it had been sent late.
        let thread = spawn("listener", PRIORITY, move || ear.run())?;
        Ok(Self {
            frames,
            is_over,
            thread: Some(thread),
        })
    }

    /// Frames that came until now.
    pub(crate) fn frames(&self) -> Vec<Frame> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Publications that came until now.
    pub(crate) fn heard(&self) -> Vec<Heard> {
        publications(&self.frames.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Waits for a publication that `is_it`; none where it does not come in time.
    pub(crate) fn wait_for(&self, at_most: Duration, is_it: impl Fn(&Heard) -> bool) -> Option<Heard> {
        let from = now_micros();
        let until = from + u64::try_from(at_most.as_micros()).unwrap_or(u64::MAX / 2);
        while now_micros() < until {
            let found = self
                .heard()
                .into_iter()
                .find(|heard| heard.at_micros >= from && is_it(heard));
            if found.is_some() {
                return found;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        None
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Between two tries to listen.
const RETRY: Duration = Duration::from_millis(20);

struct Ear {
    interface: String,
    frames: Arc<Mutex<Vec<Frame>>>,
    is_over: Arc<AtomicBool>,
}

impl Ear {
    fn run(self) {
        let mut socket = None;
        while !self.is_over.load(Ordering::Relaxed) {
            if socket.is_none() {
                socket = open(&self.interface).ok();
            }
            let Some(open) = &socket else {
                std::thread::sleep(RETRY);
                continue;
            };
            match open.read_frame() {
                Ok(frame) => self.keep(&frame),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                // The interface is down or gone: listen again, but not at once, for nothing else would get the processor.
                Err(_) => {
                    socket = None;
                    std::thread::sleep(RETRY);
                }
            }
        }
    }

    fn keep(&self, frame: &CanAnyFrame) {
        let at_micros = now_micros();
        let (id, data, is_fd) = match frame {
            CanAnyFrame::Normal(frame) => (frame.id(), frame.data(), false),
            CanAnyFrame::Fd(frame) => (frame.id(), frame.data(), true),
            CanAnyFrame::Remote(_) | CanAnyFrame::Error(_) => return,
        };
        let id = match id {
            Id::Standard(id) => u32::from(id.as_raw()),
            Id::Extended(id) => id.as_raw(),
        };
        let mut frames = self.frames.lock().unwrap_or_else(PoisonError::into_inner);
        frames.push(Frame {
            at_micros,
            id,
            data: data.to_vec(),
            is_fd,
        });
    }
}

fn open(interface: &str) -> std::io::Result<CanFdSocket> {
    let socket = CanFdSocket::open(interface)?;
    socket.set_filters(&[CanFilter::new(IDS.0, IDS.1)])?;
    socket.set_read_timeout(Duration::from_millis(50))?;
    Ok(socket)
}

/// The publications of these frames: a status frame, and the timing frame that follows with the same counter.
pub(crate) fn publications(frames: &[Frame]) -> Vec<Heard> {
    let mut heard: Vec<Heard> = Vec::new();
    let mut status: Option<u64> = None;
    for frame in frames {
        if let (Some(capture), Some(last)) = (capture(frame), heard.last_mut()) {
            last.capture_to_bus_ms = Some(millis(frame.at_micros.saturating_sub(capture)));
        }
        let Some(payload) = payload(frame) else { continue };
        match (frame.id, status) {
            (STATUS, _) => status = Some(payload),
            (TIMING, Some(before)) if bits(before, 8, 4) == bits(payload, 8, 4) => {
                heard.extend(publication(before, payload, frame.at_micros));
                status = None;
            }
            _ => {}
        }
    }
    heard
}

/// The capture stamp in the head of a grid.
pub(crate) fn capture(frame: &Frame) -> Option<u64> {
    let bytes = frame.data.get(8..16).filter(|_| frame.id == GRID_HEAD)?;
    Some(u64::from_le_bytes(bytes.try_into().ok()?))
}

#[expect(clippy::cast_precision_loss, reason = "a part of a second")]
fn millis(micros: u64) -> f64 {
    micros as f64 * 1e-3
}

fn payload(frame: &Frame) -> Option<u64> {
    Some(u64::from_le_bytes(frame.data.as_slice().try_into().ok()?))
}

/// `length` bits from `start`, little-endian.
const fn bits(payload: u64, start: u32, length: u32) -> u64 {
    payload >> start & ((1 << length) - 1)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "signals of at most 32 bits"
)]
fn publication(status: u64, timing: u64, at_micros: u64) -> Option<Heard> {
    Some(Heard {
        at_micros,
        level: QualityLevel::from_wire(bits(status, 12, 4) as u8)?,
        faults: Faults(bits(status, 16, 32) as u32),
        sequence: bits(status, 56, 8) as u8,
        capture_to_publish_ms: bits(timing, 16, 16) as f64 * 0.1,
        capture_to_bus_ms: None,
    })
}

/// The frames as `candump -L` would have written them.
pub(crate) fn candump(frames: &[Frame], interface: &str) -> String {
    let mut log = String::new();
    for frame in frames {
        let (seconds, micros) = (frame.at_micros / 1_000_000, frame.at_micros % 1_000_000);
        let mark = if frame.is_fd { "##1" } else { "#" };
        // Writing to a string cannot fail.
        let _ = write!(log, "({seconds}.{micros:06}) {interface} {:03X}{mark}", frame.id);
        for byte in &frame.data {
            let _ = write!(log, "{byte:02X}");
        }
        log.push('\n');
    }
    log
}
