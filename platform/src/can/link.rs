//! One interface: opened and opened again, read, and sent to, step by step.
//!
//! In: an [`Adapter`], the time, frames to send. Out: wheel readings, counters, events, and when to be stepped next.
//! Invariant: a step does a bounded amount of work ([`RECEIVE_MOST`] frames in, [`SEND_MOST`] out) and never waits; whatever the
//! interface does, the link lives. Cost: two clock readings and one decoding a frame.

use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use freespace::emit::BitRates;
use freespace::space::Micros;
use freespace::track::WheelReading;
use rtrb::Producer;

use super::back_off::BackOff;
use super::counters::{CanEvent, CanTrace, Counters, Teller};
use super::outbox::{OutState, Outbox};
use super::pacer::Pacer;
use super::reports::{ControllerState, Report};
use super::stamp::{StampMap, StampSource};
use super::wire::{Adapter, Now, Received, Standing, Wire, WireFault};
use crate::wheels::WheelDecoder;

/// Frames taken in one step: a tenth of a second of a full bus's wheel messages, in half a millisecond.
const RECEIVE_MOST: usize = 256;
/// Frames sent in one step; the pacer lets six go at once.
const SEND_MOST: usize = 16;
/// How often the interface is looked at: while all is well, and while it is down or off.
const LOOK_NS: u64 = 1_000_000_000;
const LOOK_OFTEN_NS: u64 = 100_000_000;

/// Where readings go.
pub(super) struct WheelSide {
    pub(super) decoder: WheelDecoder,
    pub(super) readings: Producer<WheelReading>,
    /// Added to every stamp.
    pub(super) offset_micros: i64,
}

/// Where frames come from.
pub(super) struct SendSide {
    pub(super) outbox: Outbox,
    pub(super) state: Arc<OutState>,
    pub(super) pacer: Pacer,
    pub(super) rates: BitRates,
}

/// One interface.
pub(super) struct Link<A: Adapter> {
    adapter: A,
    number: usize,
    wire: Option<A::Wire>,
    pub(super) wheels: Option<WheelSide>,
    pub(super) sends: Option<SendSide>,
    counters: Arc<Counters>,
    back_off: BackOff,
    stamps: StampMap,
    standing: Standing,
    controller: ControllerState,
    look_at_ns: u64,
    unopened: Option<WireFault>,
    has_refused: bool,
    has_hardware: bool,
    overflow: u32,
    steps: u64,
}

impl<A: Adapter> Link<A> {
    pub(super) fn new(adapter: A, number: usize, counters: Arc<Counters>) -> Self {
        Self {
            adapter,
            number,
            wire: None,
            wheels: None,
            sends: None,
            counters,
            back_off: BackOff::default(),
            stamps: StampMap::default(),
            standing: Standing::Gone,
            controller: ControllerState::Active,
            look_at_ns: 0,
            unopened: None,
            has_refused: false,
            has_hardware: false,
            overflow: 0,
            steps: 0,
        }
    }

    /// What to wait on until the next step.
    pub(super) fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        self.wire.as_ref().and_then(Wire::descriptor)
    }

    /// Does what is to be done now; returns when it must be called again, unless the descriptor is readable before.
    pub(super) fn step(&mut self, clock: &impl Fn() -> Now, teller: &mut Teller) -> u64 {
        let now = clock();
        if self.wire.is_none() && now.monotonic_ns >= self.back_off.next_ns() {
            self.open(now, teller);
        }
        if self.wire.is_some() && now.monotonic_ns >= self.look_at_ns {
            self.look(now, teller);
        }
        let is_emptied = self.receive(clock, teller);
        let send_at = self.send(clock().monotonic_ns, now, teller);
        let until = if self.wire.is_some() {
            self.look_at_ns
        } else {
            self.back_off.next_ns()
        };
        if is_emptied {
            send_at.map_or(until, |send_at| send_at.min(until))
        } else {
            now.monotonic_ns
        }
    }

    fn tell(&self, now: Now, event: CanEvent, teller: &mut Teller) {
        let trace = CanTrace {
            at: Micros(now.monotonic_ns / 1000),
            interface: self.number,
            event,
        };
        teller.tell(&self.counters, trace);
    }

    fn open(&mut self, now: Now, teller: &mut Teller) {
        match self.adapter.open() {
            Ok(wire) => {
                self.wire = Some(wire);
                self.counters.opened.add(1);
                self.tell(now, CanEvent::Opened, teller);
                self.back_off.succeeded();
                self.stamps.opened(now);
                self.unopened = None;
                self.has_refused = false;
                self.overflow = 0;
                self.controller = ControllerState::Active;
                self.standing = Standing::Running;
                self.look_at_ns = now.monotonic_ns;
            }
            Err(fault) => {
                self.back_off.failed(now.monotonic_ns);
                if self.unopened.replace(fault) != Some(fault) {
                    self.tell(now, CanEvent::Unopened(fault), teller);
                }
            }
        }
        self.say_whether_open();
    }

    /// Looks at the interface itself: an error report may be lost, and a new adapter may have the old one's name.
    fn look(&mut self, now: Now, teller: &mut Teller) {
        let Some(wire) = &mut self.wire else {
            return;
        };
        let standing = wire.standing();
        self.stand(standing, now, teller);
    }

    fn stand(&mut self, standing: Standing, now: Now, teller: &mut Teller) {
        if standing == Standing::Gone {
            return self.lose(now, teller);
        }
        self.look_at_ns = now.monotonic_ns
            + if standing == Standing::Running {
                LOOK_NS
            } else {
                LOOK_OFTEN_NS
            };
        if self.standing == standing {
            return;
        }
        self.standing = standing;
        match standing {
            Standing::Running => self.tell(now, CanEvent::Running, teller),
            Standing::Off => {
                self.counters.bus_off.add(1);
                self.tell(now, CanEvent::BusOff, teller);
            }
            Standing::Down | Standing::Gone => {
                self.counters.downs.add(1);
                self.tell(now, CanEvent::Down, teller);
            }
        }
        self.say_whether_open();
    }

    fn lose(&mut self, now: Now, teller: &mut Teller) {
        self.wire = None;
        self.standing = Standing::Gone;
        self.counters.losses.add(1);
        self.back_off.failed(now.monotonic_ns);
        self.tell(now, CanEvent::Lost, teller);
        self.say_whether_open();
    }

    fn say_whether_open(&self) {
        if let Some(sends) = &self.sends {
            let is_open = self.wire.is_some() && self.standing == Standing::Running;
            sends.state.is_open.store(is_open, Ordering::Release);
        }
    }

    /// A fault of a socket, in either direction.
    fn fail(&mut self, fault: WireFault, now: Now, teller: &mut Teller) {
        match fault {
            WireFault::Down => self.stand(Standing::Down, now, teller),
            // A socket that is broken in any other way is opened anew.
            _ => self.lose(now, teller),
        }
    }

    /// Whether the queue was emptied.
    fn receive(&mut self, clock: &impl Fn() -> Now, teller: &mut Teller) -> bool {
        for _ in 0..RECEIVE_MOST {
            let before = clock();
            let Some(wire) = &mut self.wire else {
                return true;
            };
            match wire.receive() {
                Ok(Some(frame)) => self.take(&frame, clock(), teller),
                Ok(None) => {
                    self.stamps.emptied(before);
                    self.tell_steps(before, teller);
                    return true;
                }
                Err(fault) => {
                    self.fail(fault, before, teller);
                    return true;
                }
            }
        }
        false
    }

    fn tell_steps(&mut self, now: Now, teller: &mut Teller) {
        let steps = self.stamps.steps();
        if steps != self.steps {
            self.counters.clock_steps.add(steps - self.steps);
            self.steps = steps;
            self.tell(now, CanEvent::ClockStep, teller);
        }
    }

    fn take(&mut self, frame: &Received, now: Now, teller: &mut Teller) {
        if let Some(overflow) = frame.overflow {
            let more = overflow.wrapping_sub(self.overflow);
            self.counters.queue_overflow.add(u64::from(more));
            self.overflow = overflow;
        }
        if frame.is_error {
            return self.report(frame, now, teller);
        }
        self.counters.received.add(1);
        if self.standing == Standing::Off {
            // What is received was on the bus, and so is the controller.
            self.stand(Standing::Running, now, teller);
        }
        if frame.is_remote {
            return;
        }
        let (stamp_ns, source) = self.stamps.monotonic(now, frame.software_ns, frame.hardware_ns);
        if source == StampSource::Hardware && !self.has_hardware {
            self.has_hardware = true;
            self.tell(now, CanEvent::HardwareStamps, teller);
        }
        self.read_wheels(frame, stamp_ns, source);
    }

    fn read_wheels(&mut self, frame: &Received, stamp_ns: u64, source: StampSource) {
        let Some(wheels) = &mut self.wheels else {
            return;
        };
        let stamp = Micros((stamp_ns / 1000).saturating_add_signed(wheels.offset_micros));
        let data = frame.data.get(..frame.length).unwrap_or(&frame.data);
        let Some(decoded) = wheels.decoder.decode(frame.id, frame.is_extended, data, stamp) else {
            return;
        };
        let reading = match decoded {
            Ok(reading) => reading,
            Err(fault) => return self.counters.refused(fault),
        };
        if wheels.readings.push(reading).is_err() {
            return self.counters.readings_dropped.add(1);
        }
        self.counters.readings.add(1);
        match source {
            StampSource::Hardware => &self.counters.stamped_by_hardware,
            StampSource::Software => &self.counters.stamped_by_software,
            StampSource::Receipt => &self.counters.stamped_at_receipt,
        }
        .add(1);
    }

    fn report(&mut self, frame: &Received, now: Now, teller: &mut Teller) {
        let report = Report::of(frame.id, &frame.data);
        let counters = &self.counters;
        counters.error_reports.add(1);
        counters.bus_errors.add(u64::from(report.is_bus_error));
        counters.unacknowledged.add(u64::from(report.is_unacknowledged));
        if report.is_bus_off {
            self.stand(Standing::Off, now, teller);
        } else if report.is_restarted {
            self.stand(Standing::Running, now, teller);
        }
        let Some(state) = report.state else {
            return;
        };
        self.counters
            .error_passive
            .add(u64::from(state == ControllerState::Passive));
        if self.controller != state {
            self.controller = state;
            self.tell(now, CanEvent::State(state), teller);
        }
    }

    /// Sends what may go now; returns when the next may.
    fn send(&mut self, mut now_ns: u64, now: Now, teller: &mut Teller) -> Option<u64> {
        now_ns = now_ns.max(now.monotonic_ns);
        for _ in 0..SEND_MOST {
            let sends = self.sends.as_mut()?;
            let frame = sends.outbox.next(now_ns, &sends.state, &self.counters)?;
            let wire = self.wire.as_mut()?;
            if self.standing != Standing::Running {
                return None;
            }
            let frame_ns = sends.rates.frame_nanos(frame);
            if let Some(at) = sends.pacer.wait_until(now_ns, frame_ns) {
                return Some(at);
            }
            match wire.send(frame) {
                Ok(()) => {
                    self.counters.sent.add(1);
                    sends.pacer.sent(now_ns, frame_ns);
                    sends.outbox.done();
                }
                Err(WireFault::Full) => {
                    self.counters.queue_full.add(1);
                    sends.pacer.refused(now_ns, frame_ns);
                }
                Err(fault @ (WireFault::Unsupported | WireFault::Denied)) => {
                    self.counters.dropped_unsupported.add(1);
                    sends.state.has_dropped.store(true, Ordering::Relaxed);
                    sends.outbox.done();
                    if !std::mem::replace(&mut self.has_refused, true) {
                        self.tell(now, CanEvent::Refuses(fault), teller);
                    }
                }
                Err(fault) => {
                    self.fail(fault, now, teller);
                    return None;
                }
            }
        }
        Some(now_ns)
    }

    /// Whether a frame waits that could leave.
    pub(super) fn has_to_send(&mut self, now_ns: u64) -> bool {
        let Some(sends) = &mut self.sends else {
            return false;
        };
        sends.outbox.next(now_ns, &sends.state, &self.counters).is_some()
    }
}

#[cfg(test)]
#[path = "link_tests.rs"]
mod tests;
