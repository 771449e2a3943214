//! What the CAN thread tells: counters, and events for a log that others write.
//!
//! In: the thread's increments. Out: [`CanCounts`] whenever asked, and [`CanTrace`]s in order. Invariant: the thread never waits
//! for a reader. Cost: an atomic addition. A full ring of events drops the newest, and counts it.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

use freespace::space::Micros;
use rtrb::{Consumer, Producer};

use super::reports::ControllerState;
use super::wire::WireFault;
use crate::wheels::DecodeFault;

/// Events that wait for their reader: more than an interface makes in a second of trouble.
pub(super) const EVENTS: usize = 64;

macro_rules! counters {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Counters of the CAN thread, since its start.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
        pub struct CanCounts {
            $($(#[$doc])* pub $name: u64,)*
        }

        /// The same, shared between threads.
        #[derive(Debug, Default)]
        pub(super) struct Counters {
            $(pub(super) $name: Counter,)*
        }

        impl Counters {
            /// All of them, each as it is now.
            pub(super) fn counts(&self) -> CanCounts {
                CanCounts { $($name: self.$name.get(),)* }
            }
        }
    };
}

counters! {
    /// Frames received, error reports not among them.
    received,
    /// Wheel readings handed over.
    readings,
    /// Wheel messages shorter than their signals.
    refused_short,
    /// Wheel messages with a fault flag set.
    refused_flagged,
    /// Wheel messages with a speed beyond the DBC's range.
    refused_out_of_range,
    /// Wheel messages with a wrong check sum.
    refused_checksum,
    /// Wheel messages whose alive counter stands still.
    refused_counter_stuck,
    /// Wheel messages whose alive counter leaps.
    refused_counter_jumped,
    /// Readings that found their ring full: the frame task does not fetch them.
    readings_dropped,
    /// Frames that the socket's queue had no room for.
    queue_overflow,
    /// Readings stamped by the adapter.
    stamped_by_hardware,
    /// Readings stamped by the kernel.
    stamped_by_software,
    /// Readings stamped by this thread, for no other stamp fits.
    stamped_at_receipt,
    /// Steps of the wall clock that were seen.
    clock_steps,
    /// Frames handed to the interface.
    sent,
    /// Times that the transmit queue was full.
    queue_full,
    /// Frames dropped because a newer publication came.
    dropped_for_newer,
    /// Frames dropped because their publication's period was over.
    dropped_late,
    /// Frames dropped because the interface refuses them, CAN FD on a classic bus among them.
    dropped_unsupported,
    /// Publications refused: the ring is full, or the interface is away.
    publications_refused,
    /// Error reports of the controller.
    error_reports,
    /// Reports that the controller is error-passive.
    error_passive,
    /// Reports of an error on the bus.
    bus_errors,
    /// Reports of a frame that nobody acknowledged.
    unacknowledged,
    /// Times that the controller went off the bus.
    bus_off,
    /// Times that the interface was found down.
    downs,
    /// Times that the interface vanished.
    losses,
    /// Times that it was opened.
    opened,
    /// Allocations of the thread after its start.
    allocations,
    /// Events that found their ring full.
    events_dropped,
}

impl CanCounts {
    /// Wheel messages that gave no reading, for what they say themselves.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused_short
            + self.refused_flagged
            + self.refused_out_of_range
            + self.refused_checksum
            + self.refused_counter_stuck
            + self.refused_counter_jumped
    }
}

/// A counter that one thread advances and others read.
#[derive(Debug, Default)]
pub(super) struct Counter(AtomicU64);

impl Counter {
    pub(super) fn add(&self, count: u64) {
        self.0.fetch_add(count, Ordering::Relaxed);
    }

    pub(super) fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Counters {
    pub(super) fn refused(&self, fault: DecodeFault) {
        match fault {
            DecodeFault::Short => &self.refused_short,
            DecodeFault::Flagged => &self.refused_flagged,
            DecodeFault::OutOfRange => &self.refused_out_of_range,
            DecodeFault::Checksum => &self.refused_checksum,
            DecodeFault::CounterStuck => &self.refused_counter_stuck,
            DecodeFault::CounterJumped => &self.refused_counter_jumped,
        }
        .add(1);
    }
}

/// What happened to an interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanEvent {
    /// It was opened.
    Opened,
    /// The first frame with a stamp of the adapter came.
    HardwareStamps,
    /// It cannot be opened; told once for each cause.
    Unopened(WireFault),
    /// It is down.
    Down,
    /// It has vanished.
    Lost,
    /// It takes part in the bus again, after it was down or off.
    Running,
    /// Its controller went off the bus.
    BusOff,
    /// Its controller is in another state.
    State(ControllerState),
    /// It refuses a kind of frame, told once each time it is opened.
    Refuses(WireFault),
    /// The wall clock stepped; readings keep their time.
    ClockStep,
}

/// An event, when and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanTrace {
    /// When, `CLOCK_MONOTONIC`.
    pub at: Micros,
    /// Number of the interface in [`CanListener::interfaces`].
    pub interface: usize,
    /// What.
    pub event: CanEvent,
}

impl fmt::Display for CanEvent {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Opened => formatter.write_str("open"),
            Self::HardwareStamps => formatter.write_str("frames are stamped by the adapter"),
            Self::Unopened(fault) => write!(formatter, "cannot be opened yet: {fault}"),
            Self::Down => formatter.write_str("is down: ip link set NAME up"),
            Self::Lost => formatter.write_str("has vanished; it is opened again when it comes back"),
            Self::Running => formatter.write_str("takes part in the bus again"),
            Self::BusOff => formatter.write_str(
                "is off the bus: check wiring and bit rate; ip link set NAME type can restart-ms 100",
            ),
            Self::State(ControllerState::Active) => formatter.write_str("is error-active"),
            Self::State(ControllerState::Warning) => formatter.write_str("is in the error-warning state"),
            Self::State(ControllerState::Passive) => {
                formatter.write_str("is error-passive: check wiring, termination and bit rate")
            }
            Self::Refuses(fault) => write!(formatter, "refuses frames: {fault}"),
            Self::ClockStep => formatter.write_str("the wall clock stepped; readings keep their time"),
        }
    }
}

/// Writes events.
pub(super) struct Teller(pub(super) Producer<CanTrace>);

impl Teller {
    pub(super) fn tell(&mut self, counters: &Counters, trace: CanTrace) {
        if self.0.push(trace).is_err() {
            counters.events_dropped.add(1);
        }
    }
}

/// Reads events, from a thread that may log.
pub struct CanListener {
    pub(super) events: Consumer<CanTrace>,
    pub(super) interfaces: Vec<String>,
}

impl CanListener {
    /// The next event that was not told yet.
    pub fn next_event(&mut self) -> Option<CanTrace> {
        self.events.pop().ok()
    }

    /// Names of the interfaces, by their numbers.
    #[must_use]
    pub fn interfaces(&self) -> &[String] {
        &self.interfaces
    }

    /// A line for a log.
    #[must_use]
    pub fn line(&self, trace: &CanTrace) -> String {
        let name = self.interfaces.get(trace.interface).map_or("CAN", String::as_str);
        format!("{name} {}", trace.event.to_string().replace("NAME", name))
    }
}
