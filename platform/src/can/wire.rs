//! What the CAN thread needs of a socket, as two small traits: the kernel's socket is one implementation, a script of tests another.
//!
//! In: an interface. Out: frames with the kernel's stamps, and faults by name. Invariant: no call waits. Time is an argument.

use freespace::emit::CanFrame;
use std::os::fd::BorrowedFd;

/// The two clocks, read together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Now {
    /// `CLOCK_MONOTONIC`, nanoseconds.
    pub(super) monotonic_ns: u64,
    /// `CLOCK_REALTIME`, nanoseconds: what the kernel stamps frames with, and what may step.
    pub(super) realtime_ns: u64,
    /// How long the reading took: the clocks are apart by that at most.
    pub(super) spread_ns: u64,
}

/// A frame as it came in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Received {
    /// Identifier without flags; of an error report, its class bits.
    pub(super) id: u32,
    /// 29 bits instead of 11.
    pub(super) is_extended: bool,
    /// A report of the controller, not of the bus.
    pub(super) is_error: bool,
    /// A remote request: no data.
    pub(super) is_remote: bool,
    /// Bytes of `data` that are its own.
    pub(super) length: usize,
    /// The data.
    pub(super) data: [u8; 64],
    /// The kernel's stamp, `CLOCK_REALTIME`.
    pub(super) software_ns: Option<u64>,
    /// The adapter's stamp, on a clock of its own.
    pub(super) hardware_ns: Option<u64>,
    /// Frames that the socket's queue had no room for, since it was opened.
    pub(super) overflow: Option<u32>,
}

/// Why a call of a socket did nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WireFault {
    /// The interface is down (`ENETDOWN`): the socket stays and works again once it is up.
    Down,
    /// There is no such interface, or no longer (`ENODEV`, `ENXIO`): to be opened anew.
    Gone,
    /// The transmit queue is full (`ENOBUFS`, `EAGAIN`): to be tried again.
    Full,
    /// The interface does not take such frames (`EINVAL`, `EMSGSIZE`): CAN FD on a classic bus.
    Unsupported,
    /// The process may not (`EPERM`, `EACCES`).
    Denied,
    /// The kernel knows no CAN (`EAFNOSUPPORT`, `EPROTONOSUPPORT`).
    NoCan,
    /// Any other number of errno(3).
    Other(i32),
}

impl WireFault {
    /// By the number of errno(3).
    pub(super) const fn of_errno(errno: i32) -> Self {
        match errno {
            libc::ENETDOWN => Self::Down,
            libc::ENODEV | libc::ENXIO => Self::Gone,
            libc::ENOBUFS | libc::EAGAIN => Self::Full,
            libc::EINVAL | libc::EMSGSIZE => Self::Unsupported,
            libc::EPERM | libc::EACCES => Self::Denied,
            libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT => Self::NoCan,
            other => Self::Other(other),
        }
    }
}

impl std::fmt::Display for WireFault {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Down => formatter.write_str("it is down: ip link set NAME up"),
            Self::Gone => formatter.write_str("there is no such interface: plug the adapter in"),
            Self::Full => formatter.write_str("its transmit queue is full: ip link set NAME txqueuelen 1000"),
            Self::Unsupported => {
                formatter.write_str("it takes no CAN FD frames: set its mtu to 72, or fd = false")
            }
            Self::Denied => formatter.write_str("the process may not: give it CAP_NET_RAW"),
            Self::NoCan => formatter.write_str("the kernel knows no CAN: modprobe can-raw"),
            Self::Other(errno) => write!(formatter, "{}", std::io::Error::from_raw_os_error(*errno)),
        }
    }
}

/// How an interface stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    /// Up, and its controller takes part in the bus.
    Running,
    /// Up, but its controller is off the bus.
    Off,
    /// Not up.
    Down,
    /// Gone, or another interface under the same name.
    Gone,
}

/// An open socket.
pub(super) trait Wire {
    /// The next frame; none where the queue is empty.
    fn receive(&mut self) -> Result<Option<Received>, WireFault>;
    /// Hands a frame to the interface's transmit queue.
    fn send(&mut self, frame: &CanFrame) -> Result<(), WireFault>;
    /// How the interface stands.
    fn standing(&mut self) -> Standing;
    /// What to wait on.
    fn descriptor(&self) -> Option<BorrowedFd<'_>>;
}

/// Opens sockets on one interface.
pub(super) trait Adapter {
    /// Its sockets.
    type Wire: Wire;
    /// A socket that receives what was asked for, and sends.
    fn open(&mut self) -> Result<Self::Wire, WireFault>;
}
