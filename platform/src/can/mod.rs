//! CAN interfaces as devices: wheel readings in, publications out, on one thread of the role `can`.
//!
//! In: a [`CanPlan`]; frames of the wheel message; publications through the sink. Out: readings stamped on `CLOCK_MONOTONIC`, in
//! order; frames on the bus, paced; counters and events. Invariant: after the start the thread allocates nothing and waits
//! `IDLE_NS` at most; an interface that is absent, down, off the bus, removed or created again is lived through. Cost: per
//! wheel message one wake-up, one system call and one decoding; the kernel keeps all other messages away.
//! Full: a reading that finds `READINGS` others waiting is dropped and counted; a publication that does not fit is refused.
//! Files: `socket` is the kernel's, behind the traits of `wire`; `link` is the life of an interface; `stamp`, `pacer`, `back_off`,
//! `outbox` and `reports` are its parts, testable without a kernel.

mod back_off;
mod catalogue;
mod counters;
mod link;
mod monitor;
mod outbox;
mod pacer;
mod plan;
mod reports;
mod socket;
mod stamp;
mod thread;
mod wire;

pub use catalogue::{Catalogue, CatalogueMessage, SignalValue};
pub use counters::{CanCounts, CanEvent, CanListener, CanTrace};
pub use monitor::{CanMonitor, MonitoredFrame};
pub use plan::{CanPlan, CanWheelsPlan};
pub use reports::ControllerState;
pub use wire::WireFault;

pub(crate) use outbox::{OutState, Outgoing};
pub(crate) use thread::Ends;

use std::sync::Arc;

use rtrb::RingBuffer;

use crate::config::CanOut;
use crate::runtime::rights::{self, ThreadRole};
use crate::sink::SocketcanSink;
use crate::wheels::SocketcanWheels;
use counters::{EVENTS, Teller};
use link::{Link, SendSide, WheelSide};
use outbox::Outbox;
use pacer::Pacer;
use socket::{Filter, Interface};
use thread::{Shared, Thread};
use wire::Adapter as _;

/// Longest wait of the thread.
const IDLE_NS: u64 = 100_000_000;
/// Readings that wait for the frame task: ten seconds' at 100 Hz.
const READINGS: usize = 1024;
/// `ARPHRD_CAN` of linux/if_arp.h.
const CAN_DEVICE: &str = "280";

/// The devices of a run on CAN.
pub struct CanDevices {
    /// Wheel readings, where they come by CAN.
    pub wheels: Option<Box<SocketcanWheels>>,
    /// Where publications go, where they go by CAN.
    pub sink: Option<Box<SocketcanSink>>,
    /// Counters, for whoever monitors.
    pub watch: CanWatch,
    /// Events, for whoever logs.
    pub listener: CanListener,
}

/// Reads the thread's counters from any thread.
#[derive(Clone)]
pub struct CanWatch(Arc<Shared>);

impl CanWatch {
    /// All counters as they are now.
    #[must_use]
    pub fn counts(&self) -> CanCounts {
        self.0.counters.counts()
    }
}

/// Why CAN cannot be had at all; an interface that may come yet is no error.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum CanOpenError {
    /// The interface is another kind.
    #[error("{interface} is no CAN interface")]
    #[diagnostic(help("name one that `ip link show type can` or `type vcan` lists, in [can] or [wheels]"))]
    NotCan {
        /// Its name.
        interface: String,
    },
    /// The kernel or the process's rights forbid it.
    #[error("{interface} cannot be opened: {fault}")]
    #[diagnostic(help(
        "`freespace doctor` checks the interface; without one leave `interface` out of [can] and [wheels]"
    ))]
    Refused {
        /// Its name.
        interface: String,
        /// Why.
        fault: WireFault,
    },
    /// No thread.
    #[error("the CAN thread could not be started: {0}")]
    Thread(std::io::Error),
    /// No descriptor to wake it with.
    #[error("the CAN thread's bell could not be made: {0}")]
    Bell(std::io::Error),
}

/// Makes the devices and starts their thread; it ends when wheels and sink are dropped, and what the sink took last has left.
///
/// # Errors
/// A wrong configuration, a kernel without CAN, missing rights. An interface that is absent is waited for, and told once.
pub fn open(plan: CanPlan) -> Result<CanDevices, CanOpenError> {
    let mut links: Vec<Link<Interface>> = Vec::new();
    let shared = Arc::new(Shared::new().map_err(CanOpenError::Bell)?);
    let mut interfaces = Vec::new();
    for name in plan.interfaces() {
        let interface = interface(&plan, &name);
        check(&interface)?;
        links.push(Link::new(interface, links.len(), shared.counters.clone()));
        interfaces.push(name);
    }
    let number = |name: &str| interfaces.iter().position(|other| other == name);
    let mut wheels = None;
    if let Some(of) = plan.wheels
        && let Some(link) = number(&of.interface).and_then(|number| links.get_mut(number))
    {
        let (side, port) = wheel_side(of, &shared);
        link.wheels = Some(side);
        wheels = Some(Box::new(port));
    }
    let mut sink = None;
    if let Some(out) = plan.out
        && let Some(link) = (out.interface.as_deref())
            .and_then(number)
            .and_then(|number| links.get_mut(number))
    {
        let (side, port) = send_side(&out, &shared);
        link.sends = Some(side);
        sink = Some(Box::new(port));
    }
    let (teller, events) = RingBuffer::new(EVENTS);
    let thread = Thread::new(links, Teller(teller), Arc::clone(&shared));
    let real_time = plan.real_time;
    rights::thread_builder(ThreadRole::Can, &real_time)
        .spawn(move || {
            // What is refused was told when the rights were tried, before the start.
            let _ = rights::enter(ThreadRole::Can, &real_time);
            thread.run();
        })
        .map_err(CanOpenError::Thread)?;
    Ok(CanDevices {
        wheels,
        sink,
        watch: CanWatch(shared),
        listener: CanListener { events, interfaces },
    })
}

fn interface(plan: &CanPlan, name: &str) -> Interface {
    let filter = match &plan.wheels {
        Some(wheels) if wheels.interface == name => {
            let (id, is_extended) = wheels.decoder.id();
            Filter::One(id, is_extended)
        }
        _ => Filter::Errors,
    };
    Interface {
        name: name.to_owned(),
        filter,
        fd: plan.fd,
    }
}

/// What will not change by waiting is an error.
fn check(interface: &Interface) -> Result<(), CanOpenError> {
    let kind = std::fs::read_to_string(format!("/sys/class/net/{}/type", interface.name));
    if kind.is_ok_and(|kind| kind.trim() != CAN_DEVICE) {
        return Err(CanOpenError::NotCan {
            interface: interface.name.clone(),
        });
    }
    match interface.clone().open() {
        Err(fault @ (WireFault::NoCan | WireFault::Denied)) => Err(CanOpenError::Refused {
            interface: interface.name.clone(),
            fault,
        }),
        Ok(_) | Err(_) => Ok(()),
    }
}

fn wheel_side(of: CanWheelsPlan, shared: &Arc<Shared>) -> (WheelSide, SocketcanWheels) {
    let (to, readings) = RingBuffer::new(READINGS);
    let side = WheelSide {
        decoder: of.decoder,
        readings: to,
        offset_micros: of.offset_micros,
    };
    (side, SocketcanWheels::new(readings, Ends::of_wheels(shared)))
}

fn send_side(out: &CanOut, shared: &Arc<Shared>) -> (SendSide, SocketcanSink) {
    // A publication, and the next one while the first is still leaving.
    let frames = freespace::emit::can::FRAMES + out.grid_frames;
    let (to, ring) = RingBuffer::new(2 * frames);
    let side = SendSide {
        outbox: Outbox::new(ring, out.period_micros),
        state: Arc::clone(&shared.out),
        pacer: Pacer::new(out.share),
        rates: out.rates,
    };
    let sink = SocketcanSink::new(
        to,
        Arc::clone(&shared.out),
        Ends::of_sink(shared),
        out.grid_frames,
    );
    (side, sink)
}
