//! The camera as a port: a connection, or the wait for the next one.
//!
//! Invariant: a call returns after one wait at most, but for a device that blocks while it is opened, which only happens while there
//! are no frames to miss; the camera never ends. Stamps and indices rise over all connections. Cost: as a
//! [session](super::session); no allocation while it is connected and gives plain formats.

use freespace::port::{CameraAnswer, CameraPort, FrameBuffer};
use freespace::space::Micros;
use rustix::io::Errno;

use super::error::{OpenError, Trouble};
use super::node::Devices;
use super::request::Request;
use super::session::{Newest, Session};
use super::stamps::{FrameCount, StampGate};
use super::status::Teller;
use super::{CameraEvent, Mode};

/// Longest wait of a call: a camera at 10 Hz is still waited for in one.
pub(super) const WAIT_MICROS: u64 = 100_000;

/// Waits between attempts: at once after a loose contact, then rarely, for opening a device costs milliseconds.
const FIRST_BACK_OFF_MICROS: u64 = 100_000;
const LAST_BACK_OFF_MICROS: u64 = 2_000_000;

/// A camera without a sound frame for so long is opened anew: what a hung USB camera needs.
const STUCK_MICROS: u64 = 2_000_000;

enum Link<N> {
    Up(Session<N>),
    /// Tried again at that time.
    Down(Micros),
}

/// A driver that promises frames and has none must not be asked without a pause.
const EMPTY_PAUSE_MICROS: u64 = 10_000;

/// A camera that comes back.
pub(super) struct Reconnecting<D: Devices> {
    devices: D,
    request: Request,
    link: Link<D::Node>,
    back_off_micros: u64,
    stamps: StampGate,
    count: FrameCount,
    teller: Teller,
    /// When the last sound frame came, or the connection was made.
    last_frame: Micros,
    /// Whether a frame came since the connection was made.
    is_giving: bool,
    /// Frames that the camera took, as far as answers or `skip_before` told of them.
    accounted: u64,
}

impl<D: Devices> Reconnecting<D> {
    /// Opens the camera; one that is merely away is waited for later.
    pub(super) fn open(
        devices: D,
        request: Request,
        offset_micros: i64,
        teller: Teller,
    ) -> Result<Self, OpenError> {
        let now = devices.now();
        let mut camera = Self {
            devices,
            request,
            link: Link::Down(now),
            back_off_micros: FIRST_BACK_OFF_MICROS,
            stamps: StampGate::new(offset_micros),
            count: FrameCount::default(),
            teller,
            last_frame: now,
            is_giving: false,
            accounted: 0,
        };
        match camera.connect() {
            Err(Trouble::Wrong(error)) => Err(error),
            Ok(()) | Err(Trouble::Away(_)) => Ok(camera),
        }
    }

    /// How it streams; none while it does not.
    pub(super) fn mode(&self) -> Option<Mode> {
        match &self.link {
            Link::Up(session) => Some(session.mode()),
            Link::Down(_) => None,
        }
    }

    fn connect(&mut self) -> Result<(), Trouble> {
        let tried = Session::connect(&mut self.devices, &self.request);
        // Opening may have taken long.
        let now = self.devices.now();
        match tried {
            Ok(session) => {
                self.teller.count(|counters| &counters.connections, 1);
                self.is_giving = false;
                self.count.reconnect();
                self.last_frame = now;
                self.link = Link::Up(session);
                Ok(())
            }
            Err(trouble) => {
                match &trouble {
                    Trouble::Away(errno) => self.teller.tell_once(CameraEvent::away(*errno)),
                    Trouble::Wrong(error) => {
                        self.teller.count(|counters| &counters.refusals, 1);
                        self.teller.tell_once(CameraEvent::Refused(error.kind()));
                    }
                }
                self.back_off(now);
                Err(trouble)
            }
        }
    }

    /// Closes the device, if it is open, and waits; longer each time until a frame came.
    fn back_off(&mut self, now: Micros) {
        self.link = Link::Down(now.plus(self.back_off_micros));
        self.back_off_micros = (2 * self.back_off_micros).min(LAST_BACK_OFF_MICROS);
    }

    fn disconnect(&mut self, event: CameraEvent) {
        self.teller.count(|counters| &counters.disconnections, 1);
        self.teller.tell_once(event);
        self.back_off(self.devices.now());
    }

    fn wait_for_camera(&mut self, until: Micros) -> CameraAnswer {
        let left = until.since(self.devices.now());
        if left > 0 {
            self.devices.pause(left.min(WAIT_MICROS));
        }
        if self.devices.now() >= until {
            // Told by an event; the frames come with the next call.
            let _ = self.connect();
        }
        CameraAnswer::Silent
    }

    /// No sound frame came with this call; without any for long, the camera is opened anew.
    fn without_frame(&mut self, answer: CameraAnswer) -> CameraAnswer {
        if self.devices.now().since(self.last_frame) >= STUCK_MICROS {
            self.disconnect(CameraEvent::Stuck);
        }
        answer
    }

    fn gone(&mut self, errno: Errno) {
        self.disconnect(CameraEvent::away(errno));
    }

    fn answer(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let session = match &mut self.link {
            Link::Up(session) => session,
            Link::Down(until) => {
                let until = *until;
                return self.wait_for_camera(until);
            }
        };
        let taken = match session.newest(WAIT_MICROS, &mut self.count, &mut self.teller) {
            Ok(Newest::Frame(taken)) => taken,
            Ok(Newest::Damaged) => return self.without_frame(CameraAnswer::Lost),
            Ok(Newest::Silence) => return self.without_frame(CameraAnswer::Silent),
            Ok(Newest::Empty) => {
                self.devices.pause(EMPTY_PAUSE_MICROS);
                return self.without_frame(CameraAnswer::Silent);
            }
            Err(errno) => {
                self.gone(errno);
                return CameraAnswer::Silent;
            }
        };
        let now = self.devices.now();
        let delivered = session.deliver(taken, &mut self.stamps, now, buffer);
        let given_back = session.give_back(taken);
        let mode = session.mode();
        let answer = match delivered {
            Ok(()) => {
                if !std::mem::replace(&mut self.is_giving, true) {
                    self.teller.connected(mode);
                }
                self.last_frame = now;
                self.back_off_micros = FIRST_BACK_OFF_MICROS;
                self.teller.count(|counters| &counters.frames, 1);
                CameraAnswer::Frame
            }
            Err(loss) => {
                self.teller.lost(loss, 1);
                self.without_frame(CameraAnswer::Lost)
            }
        };
        // The frame is sound, its device is not.
        if let Err(errno) = given_back {
            self.gone(errno);
        }
        answer
    }
}

impl<D: Devices> CameraPort for Reconnecting<D> {
    fn next_frame(&mut self, buffer: &mut FrameBuffer) -> CameraAnswer {
        let answer = self.answer(buffer);
        match answer {
            CameraAnswer::Frame | CameraAnswer::Lost => self.accounted += 1,
            CameraAnswer::Silent => self.teller.count(|counters| &counters.silences, 1),
            CameraAnswer::End => {}
        }
        answer
    }

    /// The driver left them out already: those that are missing in its count, and those that newer ones overtook.
    fn skip_before(&mut self, _: Micros) -> u64 {
        let taken = self.count.taken();
        let left_out = taken.saturating_sub(self.accounted);
        self.accounted = taken;
        left_out
    }
}
