//! One connection: a device that streams, and the newest of the frames that wait.
//!
//! In: buffers that the driver filled. Out: the newest sound one, copied. Invariant: every buffer but the one being copied is with
//! the driver, and none is ever queued twice. Cost: one wait, then at most as many requests as there are buffers. A full queue means
//! that the driver drops frames, which its count shows; overtaken frames go back at once.

use freespace::port::FrameBuffer;
use freespace::space::Micros;
use rustix::io::Errno;

use super::controls;
use super::error::{OpenError, Trouble};
use super::jpeg::Jpeg;
use super::negotiate::{Agreement, negotiate};
use super::node::{Buffers, Devices, Filled, Node};
use super::request::Request;
use super::stamps::{FrameCount, StampGate};
use super::status::Teller;
use super::{Loss, Mode, StampClock};

/// A device that streams.
pub(super) struct Session<N> {
    node: N,
    agreement: Agreement,
    buffers: Buffers,
    decoder: Option<Jpeg>,
}

/// A frame that was taken from the queue.
#[derive(Clone, Copy)]
pub(super) struct Taken {
    filled: Filled,
    index: u64,
}

/// What the queue held.
pub(super) enum Newest {
    /// A sound frame, to be copied and given back.
    Frame(Taken),
    /// Damaged frames alone.
    Damaged,
    /// Nothing, though the driver said that there was something.
    Empty,
    /// Nothing, all the time.
    Silence,
}

impl<N: Node> Session<N> {
    /// Opens a device, sets it up and starts it.
    pub(super) fn connect<D: Devices<Node = N>>(devices: &mut D, request: &Request) -> Result<Self, Trouble> {
        let mut node = open(devices, request)?;
        let agreement = negotiate(&mut node, request)?;
        controls::apply(&mut node, request)?;
        let buffers = node.map_buffers(request.buffers)?;
        if buffers.clock != StampClock::Monotonic {
            return Err(Trouble::Wrong(OpenError::Stamps {
                device: request.device.clone(),
                clock: buffers.clock,
            }));
        }
        for buffer in 0..buffers.count {
            node.queue(buffer)?;
        }
        node.start()?;
        let decoder = (agreement.rows.is_compressed()).then(|| Jpeg::new(longest(request)));
        Ok(Self {
            node,
            agreement,
            buffers,
            decoder,
        })
    }

    /// What was agreed, as it is told.
    pub(super) fn mode(&self) -> Mode {
        Mode {
            format: self.agreement.format,
            width: self.agreement.rows.width,
            height: self.agreement.rows.height,
            rate_millihertz: self.agreement.rate_millihertz,
            stamps: self.buffers.source,
        }
    }

    /// Waits for a frame, and takes the newest; what it overtook goes back at once.
    pub(super) fn newest(
        &mut self,
        micros: u64,
        count: &mut FrameCount,
        teller: &mut Teller,
    ) -> Result<Newest, Errno> {
        if !self.node.wait(micros)? {
            return Ok(Newest::Silence);
        }
        let mut newest = Newest::Empty;
        for _ in 0..self.buffers.count {
            let filled = match self.node.dequeue() {
                Ok(filled) => filled,
                Err(Errno::AGAIN) => break,
                // A frame that is sound counts; the next call meets the fault again.
                Err(_) if matches!(newest, Newest::Frame(_)) => break,
                Err(errno) => return Err(errno),
            };
            let (index, missing) = count.take(filled.sequence);
            if missing > 0 {
                teller.lost(Loss::Gap, missing);
            }
            if filled.is_damaged {
                teller.lost(Loss::Damaged, 1);
                self.node.queue(filled.buffer)?;
                if matches!(newest, Newest::Empty) {
                    newest = Newest::Damaged;
                }
                continue;
            }
            let taken = Taken { filled, index };
            if let Newest::Frame(older) = std::mem::replace(&mut newest, Newest::Frame(taken)) {
                teller.count(|counters| &counters.superseded, 1);
                self.node.queue(older.filled.buffer)?;
            }
        }
        Ok(newest)
    }

    /// Judges a frame, and copies its pixels.
    pub(super) fn deliver(
        &mut self,
        taken: Taken,
        stamps: &mut StampGate,
        now: Micros,
        buffer: &mut FrameBuffer,
    ) -> Result<(), Loss> {
        let filled = taken.filled;
        if filled.clock != StampClock::Monotonic {
            return Err(Loss::StampClock);
        }
        let stamp = stamps.pass(filled.stamp, now)?;
        let bytes = self.node.bytes(filled.buffer, filled.len);
        let rows = &self.agreement.rows;
        match &mut self.decoder {
            None if rows.copy(bytes, buffer) => {}
            None => return Err(Loss::Damaged),
            Some(decoder) => {
                rows.describe(buffer);
                (buffer.bytes).resize(rows.format.byte_len(rows.width, rows.height), 0);
                if !decoder.decode(bytes, (rows.width, rows.height), &mut buffer.bytes) {
                    return Err(Loss::Undecodable);
                }
            }
        }
        buffer.stamp = stamp;
        buffer.index = taken.index;
        buffer.key_frame_wanted = false;
        Ok(())
    }

    /// Gives a frame's buffer back to the driver.
    pub(super) fn give_back(&mut self, taken: Taken) -> Result<(), Errno> {
        self.node.queue(taken.filled.buffer)
    }
}

/// Bytes of a compressed picture are seldom more than of a plain one.
const fn longest(request: &Request) -> usize {
    request.width as usize * request.height as usize
}

fn open<D: Devices>(devices: &mut D, request: &Request) -> Result<D::Node, Trouble> {
    let wrong = |what| {
        Trouble::Wrong(OpenError::NotACamera {
            device: request.device.clone(),
            what,
        })
    };
    let mut node = devices.open(&request.device).map_err(|errno| match errno {
        Errno::NOSYS => Trouble::Wrong(OpenError::NotBuilt {
            device: request.device.clone(),
        }),
        Errno::ACCESS | Errno::PERM => Trouble::Wrong(OpenError::NotAllowed {
            device: request.device.clone(),
            errno,
        }),
        Errno::ISDIR | Errno::NOTDIR => wrong("is no device"),
        errno => Trouble::Away(errno),
    })?;
    let abilities = node.abilities().map_err(|errno| match errno {
        Errno::NOTTY | Errno::INVAL => wrong("is no video device"),
        errno => Trouble::Away(errno),
    })?;
    if !abilities.is_capture {
        return Err(wrong(if abilities.is_multi_planar {
            "gives its pictures in several planes, which is not read"
        } else {
            "gives no pictures"
        }));
    }
    if !abilities.is_streaming {
        return Err(wrong("has no buffers to stream with"));
    }
    Ok(node)
}
