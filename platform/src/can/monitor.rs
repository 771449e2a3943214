//! Every frame of an interface, for a reader at a terminal: blocking, and not for the loop.

use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::socket::{Filter, Interface, KernelSocket};
use super::wire::{Adapter as _, Wire as _, WireFault};

/// A frame seen.
#[derive(Clone, Copy, Debug)]
pub struct MonitoredFrame {
    /// Identifier without flags.
    pub id: u32,
    /// 29 bits instead of 11.
    pub is_extended: bool,
    /// Kernel's stamp in microseconds since 1970; 0 without.
    pub stamp_micros: u64,
    length: usize,
    data: [u8; 64],
}

impl MonitoredFrame {
    /// The data.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.data.get(..self.length).unwrap_or(&self.data)
    }
}

/// A socket that receives all.
pub struct CanMonitor(KernelSocket);

impl CanMonitor {
    /// Opens an interface.
    ///
    /// # Errors
    /// The kernel's fault.
    pub fn open(interface: &str) -> Result<Self, WireFault> {
        let mut interface = Interface {
            name: interface.to_owned(),
            filter: Filter::All,
            fd: true,
        };
        interface.open().map(Self)
    }

    /// The next data frame; none where none came in time.
    ///
    /// # Errors
    /// The kernel's fault.
    pub fn next_frame(&mut self, timeout: Duration) -> Result<Option<MonitoredFrame>, WireFault> {
        if let Some(fd) = self.0.descriptor() {
            let timeout = Timespec {
                tv_sec: i64::try_from(timeout.as_secs()).unwrap_or(i64::MAX),
                tv_nsec: i64::from(timeout.subsec_nanos()),
            };
            // A signal ends the wait early, which does no harm.
            let _ = poll(&mut [PollFd::from_borrowed_fd(fd, PollFlags::IN)], Some(&timeout));
        }
        let frame = self.0.receive()?;
        Ok(frame
            .filter(|frame| !frame.is_error && !frame.is_remote)
            .map(|frame| MonitoredFrame {
                id: frame.id,
                is_extended: frame.is_extended,
                stamp_micros: frame.software_ns.unwrap_or(0) / 1000,
                length: frame.length,
                data: frame.data,
            }))
    }
}
