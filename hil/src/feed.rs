//! Feeds the devices at real pace: pictures to a V4L2 loopback device, wheel counters to the bus.
//!
//! Both threads run above the module's own priorities, as a camera and a brake controller do not wait for it. What was sent when
//! is kept, for the comparison afterwards.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use freespace_platform::runtime::rights::{self, Policy, RealTimeConfig, ThreadRole};
use socketcan::{CanDataFrame, CanFrame, CanSocket, EmbeddedFrame as _, Socket as _, StandardId};
use v4l::video::Output as _;
use v4l::{Device, Format, FourCC};

use crate::clock::{now_micros, sleep_until};
use crate::fault::{CameraFault, Switches, WheelFault};
use crate::listener::Frame;
use crate::road::{black, picture_micros};
use crate::wheel_frame::WheelFrame;

/// Above everything that the module runs at.
const PRIORITY: u8 = 60;

/// A picture that was handed to the kernel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sent {
    /// Number of the picture.
    pub(crate) picture: u64,
    /// When it was handed over.
    pub(crate) at_micros: u64,
}

/// Why a device cannot be fed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FeedError {
    #[error("{device}: no pictures can be written to it: {error}; load v4l2loopback and name its device")]
    Camera { device: PathBuf, error: std::io::Error },
    #[error("a thread could not be started: {0}")]
    Thread(#[from] std::io::Error),
}

/// Puts the next picture in place of the one it is given; false at the end.
pub(crate) type NextPicture = Box<dyn FnMut(&mut Vec<u8>) -> bool + Send>;

/// What is fed: pictures and wheel counts by their numbers, until there are no more.
pub(crate) struct Show {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) rate_hz: f64,
    pub(crate) wheel_period_micros: u64,
    /// YUYV; may wait until it is made.
    pub(crate) picture: NextPicture,
    pub(crate) counts: Box<dyn FnMut(u64) -> Option<[u32; 4]> + Send>,
}

/// The drive under way; it ends when dropped.
pub(crate) struct Feed {
    pub(crate) start_micros: u64,
    pub(crate) switches: Arc<Switches>,
    logs: Logs,
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

/// What was sent until now; it outlives the feed.
#[derive(Clone, Default)]
pub(crate) struct Logs {
    pictures: Arc<Mutex<Vec<Sent>>>,
    wheels: Arc<Mutex<Vec<Frame>>>,
}

impl Logs {
    pub(crate) fn pictures(&self) -> Vec<Sent> {
        copy(&self.pictures)
    }

    pub(crate) fn wheels(&self) -> Vec<Frame> {
        copy(&self.wheels)
    }
}

fn copy<T: Clone>(log: &Mutex<Vec<T>>) -> Vec<T> {
    log.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

impl Feed {
    /// Starts to drive; the first picture leaves 0.3 s from now.
    pub(crate) fn start(show: Show, device: &Path, interface: &str) -> Result<Self, FeedError> {
        // By then pictures wait.
        let start_micros = now_micros() + 1_500_000;
        let switches = Arc::new(Switches::default());
        let is_over = Arc::new(AtomicBool::new(false));
        let logs = Logs::default();
        let camera = CameraFeed {
            width: show.width,
            height: show.height,
            rate_hz: show.rate_hz,
            picture: show.picture,
            device: device.to_owned(),
            output: Some(open_output(device, show.width, show.height)?),
            last: Vec::new(),
            switches: Arc::clone(&switches),
            is_over: Arc::clone(&is_over),
            sent: Arc::clone(&logs.pictures),
        };
        let wheels = WheelFeed {
            period_micros: show.wheel_period_micros,
            counts: show.counts,
            socket: None,
            interface: interface.to_owned(),
            switches: Arc::clone(&switches),
            is_over: Arc::clone(&is_over),
            stuck: None,
            sent: Arc::clone(&logs.wheels),
        };
        let threads = vec![
            spawn("camera-feed", PRIORITY, move || camera.run(start_micros))?,
            spawn("wheel-feed", PRIORITY, move || wheels.run(start_micros))?,
        ];
        Ok(Self {
            start_micros,
            switches,
            logs,
            is_over,
            threads,
        })
    }

    /// Seconds of the drive at an instant of the clock.
    #[expect(clippy::cast_precision_loss, reason = "a drive of minutes")]
    pub(crate) fn seconds_at(&self, micros: u64) -> f64 {
        (micros.cast_signed() - self.start_micros.cast_signed()) as f64 * 1e-6
    }

    /// Latest that a picture was sent after its time: what the module makes of the rig, not of the road.
    pub(crate) fn lateness_micros(&self, rate_hz: f64) -> u64 {
        let late = |sent: &Sent| {
            sent.at_micros
                .saturating_sub(self.start_micros + picture_micros(sent.picture, rate_hz))
        };
        self.logs.pictures().iter().map(late).max().unwrap_or(0)
    }

    /// What was sent, and is being sent.
    pub(crate) fn logs(&self) -> Logs {
        self.logs.clone()
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// A thread of that priority; without the right it may be late, and the case says by how much.
pub(crate) fn spawn(
    name: &str,
    priority: u8,
    body: impl FnOnce() + Send + 'static,
) -> std::io::Result<JoinHandle<()>> {
    let mut config = RealTimeConfig::default();
    config.threads[ThreadRole::Camera as usize].policy = Policy::Fifo(priority);
    std::thread::Builder::new().name(name.to_owned()).spawn(move || {
        let _ = rights::enter(ThreadRole::Camera, &config);
        body();
    })
}

fn open_output(device: &Path, width: usize, height: usize) -> Result<Device, FeedError> {
    let fault = |error| FeedError::Camera {
        device: device.to_owned(),
        error,
    };
    let output = Device::with_path(device).map_err(fault)?;
    let size = |pixels: usize| u32::try_from(pixels).unwrap_or(0);
    output
        .set_format(&Format::new(size(width), size(height), FourCC::new(b"YUYV")))
        .map_err(fault)?;
    Ok(output)
}

struct CameraFeed {
    width: usize,
    height: usize,
    rate_hz: f64,
    picture: NextPicture,
    device: PathBuf,
    output: Option<Device>,
    last: Vec<u8>,
    switches: Arc<Switches>,
    is_over: Arc<AtomicBool>,
    sent: Arc<Mutex<Vec<Sent>>>,
}

impl CameraFeed {
    fn run(mut self, start_micros: u64) {
        let mut picture = Vec::new();
        for number in 0.. {
            if !(self.picture)(&mut picture) {
                return;
            }
            sleep_until(start_micros + picture_micros(number, self.rate_hz));
            if self.is_over.load(Ordering::Relaxed) {
                return;
            }
            self.show(number, &mut picture);
        }
    }

    fn show(&mut self, number: u64, picture: &mut Vec<u8>) {
        let (width, height) = (self.width, self.height);
        match self.switches.camera() {
            CameraFault::None => {
                self.write(number, picture, width, height);
                std::mem::swap(&mut self.last, picture);
            }
            CameraFault::Drops if number.is_multiple_of(2) => self.write(number, picture, width, height),
            CameraFault::Duplicates => {
                if number.is_multiple_of(2) {
                    std::mem::swap(&mut self.last, picture);
                }
                self.write_last(number);
            }
            CameraFault::Freezes => self.write_last(number),
            CameraFault::Black => self.write(number, &black(width, height), width, height),
            CameraFault::Drops | CameraFault::Silent => {}
            CameraFault::Unplugged => self.output = None,
            CameraFault::WrongSize => {
                self.write(number, &black(width / 2, height / 2), width / 2, height / 2)
            }
        }
    }

    fn write_last(&mut self, number: u64) {
        let last = std::mem::take(&mut self.last);
        self.write(number, &last, self.width, self.height);
        self.last = last;
    }

    fn write(&mut self, picture: u64, bytes: &[u8], width: usize, height: usize) {
        if self.output.is_none() {
            self.output = open_output(&self.device, width, height).ok();
        }
        let Some(output) = &mut self.output else { return };
        let at_micros = now_micros();
        match output.write_all(bytes) {
            Ok(()) => {
                let mut sent = self.sent.lock().unwrap_or_else(PoisonError::into_inner);
                sent.push(Sent { picture, at_micros });
            }
            // The reader still holds the device at its old size: try again with the next picture.
            Err(_) => self.output = None,
        }
    }
}

struct WheelFeed {
    period_micros: u64,
    counts: Box<dyn FnMut(u64) -> Option<[u32; 4]> + Send>,
    socket: Option<CanSocket>,
    interface: String,
    switches: Arc<Switches>,
    is_over: Arc<AtomicBool>,
    /// The count at which a wheel stands still.
    stuck: Option<u32>,
    sent: Arc<Mutex<Vec<Frame>>>,
}

impl WheelFeed {
    fn run(mut self, start_micros: u64) {
        let mut frame = WheelFrame::default();
        for number in 0.. {
            let Some(counts) = (self.counts)(number) else {
                return;
            };
            sleep_until(start_micros + number * self.period_micros);
            if self.is_over.load(Ordering::Relaxed) {
                return;
            }
            let fault = self.switches.wheels();
            let counts = self.stick(counts, fault);
            if let Some(bytes) = frame.bytes(counts, fault) {
                self.send(&bytes);
            }
        }
    }

    fn stick(&mut self, mut counts: [u32; 4], fault: WheelFault) -> [u32; 4] {
        if fault == WheelFault::StuckWheel {
            counts[2] = *self.stuck.get_or_insert(counts[2]);
        } else {
            self.stuck = None;
        }
        counts
    }

    /// A frame that cannot be sent is lost, as on a bus that is off.
    fn send(&mut self, bytes: &[u8; 8]) {
        if self.socket.is_none() {
            self.socket = CanSocket::open(&self.interface).ok();
        }
        let id = StandardId::new(WheelFrame::ID);
        let frame = id.and_then(|id| CanDataFrame::new(id, bytes));
        let (Some(socket), Some(frame)) = (&self.socket, frame) else {
            return;
        };
        if socket.write_frame(&CanFrame::Data(frame)).is_err() {
            self.socket = None;
            return;
        }
        let mut sent = self.sent.lock().unwrap_or_else(PoisonError::into_inner);
        sent.push(Frame {
            at_micros: now_micros(),
            id: u32::from(WheelFrame::ID),
            data: bytes.to_vec(),
            is_fd: false,
        });
    }
}
