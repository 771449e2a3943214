//! The kernel's CAN socket.
//!
//! In: an interface's name, the identifier to receive. Out: a [`Wire`]. Invariant: no call waits, and none allocates, opening
//! included. The kernel filters: of a full bus only the wheel message, and the controller's error reports, reach the process.
//! Source: Documentation/networking/can.rst and timestamping.rst of the Linux kernel.

use std::io::IoSliceMut;
use std::os::fd::{AsFd as _, AsRawFd as _, BorrowedFd};

use freespace::emit::CanFrame;
use nix::errno::Errno;
use nix::net::if_::if_nametoindex;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg};
use nix::sys::time::TimeSpec;
use rustix::net::SendFlags;
use socketcan::{CanAddr, CanFdSocket, CanSocket, Socket as _};

use super::reports::WANTED;
use super::wire::{Adapter, Received, Standing, Wire, WireFault};

/// Bytes of a classic frame, and of one of CAN FD: CAN_MTU and CANFD_MTU of linux/can.h.
const CLASSIC_FRAME: usize = 16;
const FD_FRAME: usize = 72;
/// Bytes before a frame's data.
const DATA_AT: usize = 8;
/// The switch of the bit rate, and the mark of a CAN FD frame, in its flags.
const FD_FLAGS: u8 = 0x01 | 0x04;
/// Receive queue: a second of wheel messages many times over; the kernel doubles it, and caps it at `net.core.rmem_max`.
const RECEIVE_BYTES: libc::c_int = 262_144;

/// What a socket receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filter {
    /// Nothing but error reports.
    Errors,
    /// One identifier, and error reports.
    One(u32, bool),
    /// All.
    All,
}

/// Opens sockets on an interface.
#[derive(Clone, Debug)]
pub(super) struct Interface {
    pub(super) name: String,
    pub(super) filter: Filter,
    pub(super) fd: bool,
}

/// A classic or CAN FD socket.
enum Either {
    Classic(CanSocket),
    Fd(CanFdSocket),
}

/// An open socket.
pub(super) struct KernelSocket {
    socket: Either,
    index: u32,
    name: [libc::c_char; libc::IFNAMSIZ],
    control: [u8; CONTROL_BYTES],
}

/// Room for stamps and drop count.
const CONTROL_BYTES: usize = 160;

impl Adapter for Interface {
    type Wire = KernelSocket;

    fn open(&mut self) -> Result<KernelSocket, WireFault> {
        let index = if_nametoindex(self.name.as_str()).map_err(fault_of)?;
        let address = CanAddr::new(index);
        let socket = if self.fd {
            Either::Fd(CanFdSocket::open_addr(&address).map_err(|error| fault_of_io(&error))?)
        } else {
            Either::Classic(CanSocket::open_addr(&address).map_err(|error| fault_of_io(&error))?)
        };
        set_options(&socket, self.filter).map_err(|error| fault_of_io(&error))?;
        let mut name = [0; libc::IFNAMSIZ];
        for (to, byte) in name.iter_mut().zip(self.name.bytes().take(libc::IFNAMSIZ - 1)) {
            *to = libc::c_char::from_ne_bytes([byte]);
        }
        Ok(KernelSocket {
            socket,
            index,
            name,
            control: [0; CONTROL_BYTES],
        })
    }
}

/// An error of the operating system by its number.
fn fault_of_io(error: &std::io::Error) -> WireFault {
    WireFault::of_errno(error.raw_os_error().unwrap_or(libc::EIO))
}

const fn fault_of(errno: Errno) -> WireFault {
    WireFault::of_errno(errno as i32)
}

fn set_options(socket: &Either, filter: Filter) -> std::io::Result<()> {
    match socket {
        Either::Classic(socket) => {
            socket.set_nonblocking(true)?;
            set_raw_options(socket, filter)
        }
        Either::Fd(socket) => {
            socket.set_nonblocking(true)?;
            set_raw_options(socket, filter)
        }
    }
}

fn set_raw_options(socket: &impl socketcan::SocketOptions, filter: Filter) -> std::io::Result<()> {
    let filters = match filter {
        Filter::Errors => None,
        // Nothing is asked of the identifier: all pass.
        Filter::All => Some([0, 0]),
        // All bits of the identifier, and that it is no remote request.
        Filter::One(id, is_extended) => {
            let flag = if is_extended { libc::CAN_EFF_FLAG } else { 0 };
            Some([
                id | flag,
                libc::CAN_EFF_MASK | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG,
            ])
        }
    };
    match filters {
        None => socket.set_socket_option_bytes(libc::SOL_CAN_RAW, libc::CAN_RAW_FILTER, &[])?,
        Some([id, mask]) => {
            // `struct can_filter`: identifier and mask.
            let mut bytes = [0; 8];
            bytes[..4].copy_from_slice(&id.to_ne_bytes());
            bytes[4..].copy_from_slice(&mask.to_ne_bytes());
            socket.set_socket_option_bytes(libc::SOL_CAN_RAW, libc::CAN_RAW_FILTER, &bytes)?;
        }
    }
    socket.set_error_filter(WANTED)?;
    let stamps = libc::SOF_TIMESTAMPING_RX_SOFTWARE
        | libc::SOF_TIMESTAMPING_SOFTWARE
        | libc::SOF_TIMESTAMPING_RX_HARDWARE
        | libc::SOF_TIMESTAMPING_RAW_HARDWARE;
    socket.set_socket_option_bytes(libc::SOL_SOCKET, libc::SO_TIMESTAMPING, &stamps.to_ne_bytes())?;
    socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RXQ_OVFL, 1)?;
    socket.set_socket_option_int(libc::SOL_SOCKET, libc::SO_RCVBUF, RECEIVE_BYTES)
}

impl KernelSocket {
    fn fd(&self) -> BorrowedFd<'_> {
        match &self.socket {
            Either::Classic(socket) => socket.as_fd(),
            Either::Fd(socket) => socket.as_fd(),
        }
    }

    /// The interface's flags of linux/if.h.
    fn flags(&self) -> Result<i32, Errno> {
        // SAFETY: an all-zero `ifreq` is a valid one.
        let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
        request.ifr_name = self.name;
        // SAFETY: SIOCGIFFLAGS reads the name and writes the flags of the `ifreq` it is given, which lives through the call; the
        // descriptor is that of our open socket.
        let result = unsafe { libc::ioctl(self.fd().as_raw_fd(), libc::SIOCGIFFLAGS, &raw mut request) };
        Errno::result(result)?;
        // SAFETY: the call wrote this member of the union.
        Ok(i32::from(unsafe { request.ifr_ifru.ifru_flags }))
    }
}

impl Wire for KernelSocket {
    fn receive(&mut self) -> Result<Option<Received>, WireFault> {
        let mut bytes = [0_u8; FD_FRAME];
        let fd = self.fd().as_raw_fd();
        let mut parts = [IoSliceMut::new(&mut bytes)];
        let flags = MsgFlags::MSG_DONTWAIT;
        let message = match recvmsg::<()>(fd, &mut parts, Some(&mut self.control), flags) {
            Ok(message) => message,
            Err(Errno::EAGAIN | Errno::EINTR) => return Ok(None),
            Err(errno) => return Err(fault_of(errno)),
        };
        let length = message.bytes;
        let mut frame = Received {
            id: 0,
            is_extended: false,
            is_error: false,
            is_remote: false,
            length: 0,
            data: [0; 64],
            software_ns: None,
            hardware_ns: None,
            overflow: None,
        };
        // Cut-off control data leave a frame without a stamp.
        for control in message.cmsgs().into_iter().flatten() {
            match control {
                ControlMessageOwned::ScmTimestampsns(stamps) => {
                    frame.software_ns = nanos(stamps.system);
                    frame.hardware_ns = nanos(stamps.hw_raw);
                }
                ControlMessageOwned::RxqOvfl(overflow) => frame.overflow = Some(overflow),
                _ => {}
            }
        }
        parse(&bytes[..length.min(FD_FRAME)], &mut frame);
        Ok(Some(frame))
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), WireFault> {
        let (bytes, length) = to_bytes(frame);
        match rustix::net::send(self.fd(), &bytes[..length], SendFlags::DONTWAIT) {
            Ok(_) => Ok(()),
            Err(error) => Err(WireFault::of_errno(error.raw_os_error())),
        }
    }

    fn standing(&mut self) -> Standing {
        let name = &self.name.map(|byte| byte.to_ne_bytes()[0]);
        let name = std::ffi::CStr::from_bytes_until_nul(name).unwrap_or_default();
        if if_nametoindex(name) != Ok(self.index) {
            return Standing::Gone;
        }
        match self.flags() {
            Err(_) => Standing::Gone,
            Ok(flags) if flags & libc::IFF_UP == 0 => Standing::Down,
            Ok(flags) if flags & libc::IFF_RUNNING == 0 => Standing::Off,
            Ok(_) => Standing::Running,
        }
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.fd())
    }
}

/// A stamp; all zero where there is none.
fn nanos(stamp: TimeSpec) -> Option<u64> {
    let seconds = u64::try_from(stamp.tv_sec()).ok()?;
    let nanos = u64::try_from(stamp.tv_nsec()).ok()?;
    let stamp = seconds.checked_mul(1_000_000_000)?.checked_add(nanos)?;
    (stamp > 0).then_some(stamp)
}

/// `struct can_frame` or `canfd_frame`: identifier with flags, length, flags, two bytes, data.
fn parse(bytes: &[u8], frame: &mut Received) {
    let (Some(id), Some(length)) = (bytes.first_chunk::<4>(), bytes.get(4)) else {
        return;
    };
    let id = u32::from_ne_bytes(*id);
    frame.is_extended = id & libc::CAN_EFF_FLAG != 0;
    frame.is_error = id & libc::CAN_ERR_FLAG != 0;
    frame.is_remote = id & libc::CAN_RTR_FLAG != 0;
    frame.id = if frame.is_extended || frame.is_error {
        id & libc::CAN_EFF_MASK
    } else {
        id & libc::CAN_SFF_MASK
    };
    let data = bytes.get(DATA_AT..).unwrap_or_default();
    frame.length = usize::from(*length).min(data.len());
    frame.data[..data.len()].copy_from_slice(data);
}

fn to_bytes(frame: &CanFrame) -> ([u8; FD_FRAME], usize) {
    let mut bytes = [0; FD_FRAME];
    let flag = if frame.extended { libc::CAN_EFF_FLAG } else { 0 };
    bytes[..4].copy_from_slice(&(frame.id | flag).to_ne_bytes());
    bytes[4] = frame.data.len().to_le_bytes()[0];
    bytes[DATA_AT..DATA_AT + frame.data.len()].copy_from_slice(&frame.data);
    if frame.is_fd() {
        bytes[5] = FD_FLAGS;
        (bytes, FD_FRAME)
    } else {
        (bytes, CLASSIC_FRAME)
    }
}

const _: () = assert!(
    CONTROL_BYTES >= cmsg_len_of_all(),
    "room for all control messages"
);

/// Three stamps and a count, each behind a header, rounded up.
const fn cmsg_len_of_all() -> usize {
    2 * (size_of::<libc::cmsghdr>() + 8) + 3 * size_of::<libc::timespec>() + 8
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn frames_come_back_from_the_kernels_layout() {
        for (length, extended) in [(0, false), (8, true), (64, false)] {
            let mut frame = CanFrame {
                id: if extended { 0x18FF_0015 } else { 0x610 },
                extended,
                ..CanFrame::default()
            };
            frame.data.resize(length, 0xA5).unwrap();
            let (bytes, size) = to_bytes(&frame);
            let mut back = Received {
                id: 0,
                is_extended: false,
                is_error: false,
                is_remote: false,
                length: 0,
                data: [0; 64],
                software_ns: None,
                hardware_ns: None,
                overflow: None,
            };
            parse(&bytes[..size], &mut back);
            assert_eq!((back.id, back.is_extended), (frame.id, extended));
            assert_eq!(&back.data[..back.length], &frame.data[..]);
            assert_eq!(size, if length > 8 { 72 } else { 16 });
            parse(&bytes[..3], &mut back);
        }
    }
}
