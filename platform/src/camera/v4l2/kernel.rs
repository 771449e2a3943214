//! V4L2 of the Linux kernel: each call one request, its structures those of the package `v4l`.
//!
//! Invariant: buffers are unmapped before their device is closed, and closing it ends the stream; neither can fail in a way that
//! matters, so dropping a device that was pulled out is silent. Cost: one system call a call. Source: the kernel's
//! `userspace-api/media/v4l`.

use std::ffi::c_void;
use std::mem::size_of;
use std::path::Path;
use std::ptr::{NonNull, null_mut};

use freespace::port::Clock as _;
use freespace::space::Micros;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{AsRawFd as _, OwnedFd};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags};
use v4l::v4l_sys as sys;
use v4l::v4l2::vidioc::{self, _IOC_TYPE};

use super::node::{
    Abilities, Buffers, Control, ControlKind, Devices, Filled, FourCc, Interval, Layout, Node, SizeOffer,
};
use super::{StampClock, StampSource};
use crate::clock::MonotonicClock;

/// One plane of memory a picture.
const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
const MAPPED: u32 = sys::v4l2_memory_V4L2_MEMORY_MMAP;

/// Devices of this computer.
#[derive(Debug)]
pub(super) struct Kernel(MonotonicClock);

impl Kernel {
    pub(super) fn new() -> Self {
        Self(MonotonicClock::of_devices())
    }
}

impl Devices for Kernel {
    type Node = KernelNode;

    fn open(&mut self, path: &Path) -> Result<KernelNode, Errno> {
        let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let device = rustix::fs::open(path, flags, Mode::empty())?;
        Ok(KernelNode {
            maps: Vec::new(),
            device,
        })
    }

    fn now(&self) -> Micros {
        self.0.now()
    }

    fn pause(&mut self, micros: u64) {
        std::thread::sleep(std::time::Duration::from_micros(micros));
    }
}

/// A structure of V4L2 that is handed to the kernel.
///
/// # Safety
/// Every pattern of bits is a value of it, and it holds no pointer that the kernel follows.
unsafe trait Argument: Sized {
    /// All zero, as the kernel wants the fields that are not used.
    fn zeroed() -> Self {
        // SAFETY: zero is a pattern of bits.
        unsafe { std::mem::zeroed() }
    }
}

macro_rules! arguments {
    ($($name:ty),+) => { $(
        // SAFETY: numbers, arrays and unions of numbers; pointers in the unions belong to kinds of memory and of controls
        // that are not asked for here.
        unsafe impl Argument for $name {}
    )+ };
}
arguments!(
    sys::v4l2_capability,
    sys::v4l2_fmtdesc,
    sys::v4l2_frmsizeenum,
    sys::v4l2_format,
    sys::v4l2_streamparm,
    sys::v4l2_query_ext_ctrl,
    sys::v4l2_querymenu,
    sys::v4l2_control,
    sys::v4l2_requestbuffers,
    sys::v4l2_buffer,
    u32
);

/// A buffer of the driver, mapped.
struct Map {
    start: NonNull<c_void>,
    len: usize,
}

// SAFETY: shared memory; it belongs to whoever owns the node, on any thread.
unsafe impl Send for Map {}

impl Drop for Map {
    fn drop(&mut self) {
        // SAFETY: mapped by `map_buffers` with this length, and borrowed by nobody: slices of it borrow the node.
        // It fails for wrong addresses only.
        let _ = unsafe { rustix::mm::munmap(self.start.as_ptr(), self.len) };
    }
}

/// An open device. Its fields are dropped in this order.
pub(super) struct KernelNode {
    maps: Vec<Map>,
    device: OwnedFd,
}

impl KernelNode {
    fn ask<T: Argument>(&self, request: _IOC_TYPE, argument: &mut T) -> Result<(), Errno> {
        // A request carries the size of its structure in bits 16 to 29.
        if (request >> 16) & 0x3fff != size_of::<T>() as _IOC_TYPE {
            return Err(Errno::INVAL);
        }
        let argument = std::ptr::from_mut(argument).cast();
        // SAFETY: the kernel reads and writes as many bytes as the request says, which is the argument's size; any bits that it
        // writes are a value of it, and it follows no pointer in it.
        unsafe { v4l::v4l2::ioctl(self.device.as_raw_fd(), request, argument) }
            .map_err(|error| Errno::from_io_error(&error).unwrap_or(Errno::IO))
    }

    fn buffer(index: u32) -> sys::v4l2_buffer {
        sys::v4l2_buffer {
            index,
            type_: CAPTURE,
            memory: MAPPED,
            ..Argument::zeroed()
        }
    }

    /// Maps a buffer; the flags tell how it will be stamped.
    fn map(&self, index: u32) -> Result<(Map, u32), Errno> {
        let mut buffer = Self::buffer(index);
        self.ask(vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
        let len = buffer.length as usize;
        // SAFETY: the kernel wrote this member, as the memory is mapped.
        let offset = u64::from(unsafe { buffer.m.offset });
        let access = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping where the kernel wants it; nothing that exists is touched.
        let start =
            unsafe { rustix::mm::mmap(null_mut(), len, access, MapFlags::SHARED, &self.device, offset)? };
        let start = NonNull::new(start).ok_or(Errno::NOMEM)?;
        Ok((Map { start, len }, buffer.flags))
    }
}

impl Node for KernelNode {
    fn abilities(&mut self) -> Result<Abilities, Errno> {
        let mut answer = sys::v4l2_capability::zeroed();
        self.ask(vidioc::VIDIOC_QUERYCAP, &mut answer)?;
        // The device's own abilities, where they are told apart from those of its other nodes.
        let bits = if answer.capabilities & sys::V4L2_CAP_DEVICE_CAPS == 0 {
            answer.capabilities
        } else {
            answer.device_caps
        };
        Ok(Abilities {
            is_capture: bits & sys::V4L2_CAP_VIDEO_CAPTURE != 0,
            is_multi_planar: bits & sys::V4L2_CAP_VIDEO_CAPTURE_MPLANE != 0,
            is_streaming: bits & sys::V4L2_CAP_STREAMING != 0,
        })
    }

    fn format_at(&mut self, number: u32) -> Result<FourCc, Errno> {
        let mut answer = sys::v4l2_fmtdesc {
            index: number,
            type_: CAPTURE,
            ..Argument::zeroed()
        };
        self.ask(vidioc::VIDIOC_ENUM_FMT, &mut answer)?;
        Ok(FourCc(answer.pixelformat.to_le_bytes()))
    }

    fn size_at(&mut self, format: FourCc, number: u32) -> Result<SizeOffer, Errno> {
        let mut answer = sys::v4l2_frmsizeenum {
            index: number,
            pixel_format: u32::from_le_bytes(format.0),
            ..Argument::zeroed()
        };
        self.ask(vidioc::VIDIOC_ENUM_FRAMESIZES, &mut answer)?;
        let of = answer.__bindgen_anon_1;
        // SAFETY: both members are numbers; the type says which of them are meant.
        Ok(unsafe {
            if answer.type_ == sys::v4l2_frmsizetypes_V4L2_FRMSIZE_TYPE_DISCRETE {
                SizeOffer::One(of.discrete.width, of.discrete.height)
            } else {
                let step = of.stepwise;
                SizeOffer::Between(
                    (step.min_width, step.min_height),
                    (step.max_width, step.max_height),
                )
            }
        })
    }

    fn set_layout(&mut self, wanted: Layout) -> Result<Layout, Errno> {
        let mut answer = sys::v4l2_format {
            type_: CAPTURE,
            ..Argument::zeroed()
        };
        answer.fmt.pix = sys::v4l2_pix_format {
            width: wanted.width,
            height: wanted.height,
            pixelformat: u32::from_le_bytes(wanted.format.0),
            field: sys::v4l2_field_V4L2_FIELD_NONE,
            // SAFETY: `zeroed` wrote this member.
            ..unsafe { answer.fmt.pix }
        };
        self.ask(vidioc::VIDIOC_S_FMT, &mut answer)?;
        // SAFETY: the type asked for has this member.
        let pix = unsafe { answer.fmt.pix };
        Ok(Layout {
            format: FourCc(pix.pixelformat.to_le_bytes()),
            width: pix.width,
            height: pix.height,
            bytes_per_line: pix.bytesperline,
            image_bytes: pix.sizeimage,
            is_progressive: [sys::v4l2_field_V4L2_FIELD_NONE, sys::v4l2_field_V4L2_FIELD_ANY]
                .contains(&pix.field),
        })
    }

    fn set_interval(&mut self, wanted: Interval) -> Result<Option<Interval>, Errno> {
        let mut answer = sys::v4l2_streamparm {
            type_: CAPTURE,
            ..Argument::zeroed()
        };
        answer.parm.capture.timeperframe = sys::v4l2_fract {
            numerator: wanted.numerator,
            denominator: wanted.denominator,
        };
        match self.ask(vidioc::VIDIOC_S_PARM, &mut answer) {
            Err(Errno::NOTTY) => return Ok(None),
            other => other?,
        }
        // SAFETY: the type asked for has this member.
        let capture = unsafe { answer.parm.capture };
        let interval = Interval {
            numerator: capture.timeperframe.numerator,
            denominator: capture.timeperframe.denominator,
        };
        let is_told = capture.capability & sys::V4L2_CAP_TIMEPERFRAME != 0
            && interval.numerator > 0
            && interval.denominator > 0;
        Ok(is_told.then_some(interval))
    }

    fn control_after(&mut self, id: u32) -> Result<Control, Errno> {
        let mut answer = sys::v4l2_query_ext_ctrl {
            id: id | sys::V4L2_CTRL_FLAG_NEXT_CTRL,
            ..Argument::zeroed()
        };
        self.ask(vidioc::VIDIOC_QUERY_EXT_CTRL, &mut answer)?;
        let closed = sys::V4L2_CTRL_FLAG_DISABLED | sys::V4L2_CTRL_FLAG_READ_ONLY;
        Ok(Control {
            id: answer.id,
            name: text(&answer.name.map(|letter| letter.to_ne_bytes()[0])),
            kind: match answer.type_ {
                sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER => ControlKind::Integer,
                sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BOOLEAN => ControlKind::Bool,
                sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_MENU => ControlKind::Menu,
                sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU => ControlKind::NumberMenu,
                _ => ControlKind::Other,
            },
            minimum: answer.minimum,
            maximum: answer.maximum,
            step: answer.step,
            is_writable: answer.flags & closed == 0,
        })
    }

    fn menu_item(&mut self, control: &Control, number: u32) -> Result<String, Errno> {
        let mut answer = sys::v4l2_querymenu {
            id: control.id,
            index: number,
            ..Argument::zeroed()
        };
        self.ask(vidioc::VIDIOC_QUERYMENU, &mut answer)?;
        // SAFETY: both members are plain bytes; the control's kind says which is meant.
        Ok(unsafe {
            match control.kind {
                ControlKind::NumberMenu => {
                    let value = answer.__bindgen_anon_1.value;
                    value.to_string()
                }
                _ => {
                    let name = answer.__bindgen_anon_1.name;
                    text(&name)
                }
            }
        })
    }

    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno> {
        self.ask(vidioc::VIDIOC_S_CTRL, &mut sys::v4l2_control { id, value })
    }

    fn map_buffers(&mut self, wanted: u32) -> Result<Buffers, Errno> {
        let mut answer = sys::v4l2_requestbuffers {
            count: wanted,
            type_: CAPTURE,
            memory: MAPPED,
            ..Argument::zeroed()
        };
        self.ask(vidioc::VIDIOC_REQBUFS, &mut answer)?;
        let mut flags = 0;
        self.maps = Vec::with_capacity(answer.count as usize);
        for index in 0..answer.count {
            let (map, its_flags) = self.map(index)?;
            self.maps.push(map);
            flags = its_flags;
        }
        Ok(Buffers {
            count: answer.count,
            clock: clock_of(flags),
            source: source_of(flags),
        })
    }

    fn queue(&mut self, buffer: u32) -> Result<(), Errno> {
        self.ask(vidioc::VIDIOC_QBUF, &mut Self::buffer(buffer))
    }

    fn start(&mut self) -> Result<(), Errno> {
        self.ask(vidioc::VIDIOC_STREAMON, &mut { CAPTURE })
    }

    fn wait(&mut self, micros: u64) -> Result<bool, Errno> {
        let mut device = [PollFd::new(&self.device, PollFlags::IN)];
        let limit = Timespec {
            tv_sec: (micros / 1_000_000).cast_signed(),
            tv_nsec: (micros % 1_000_000 * 1_000).cast_signed(),
        };
        match poll(&mut device, Some(&limit)) {
            // A signal: the caller comes again.
            Err(Errno::INTR) => return Ok(false),
            other => other?,
        };
        let seen = device[0].revents();
        if seen.contains(PollFlags::IN) {
            Ok(true)
        } else if seen.contains(PollFlags::HUP) {
            Err(Errno::NODEV)
        } else if seen.is_empty() {
            Ok(false)
        } else {
            Err(Errno::IO)
        }
    }

    fn dequeue(&mut self) -> Result<Filled, Errno> {
        let mut buffer = Self::buffer(0);
        self.ask(vidioc::VIDIOC_DQBUF, &mut buffer)?;
        let (seconds, micros) = (buffer.timestamp.tv_sec, buffer.timestamp.tv_usec);
        let stamp = seconds.saturating_mul(1_000_000).saturating_add(micros);
        Ok(Filled {
            buffer: buffer.index,
            sequence: buffer.sequence,
            stamp: Micros(u64::try_from(stamp).unwrap_or(0)),
            clock: clock_of(buffer.flags),
            len: buffer.bytesused,
            is_damaged: buffer.flags & sys::V4L2_BUF_FLAG_ERROR != 0,
        })
    }

    fn bytes(&self, buffer: u32, len: u32) -> &[u8] {
        let Some(map) = self.maps.get(buffer as usize) else {
            return &[];
        };
        let len = map.len.min(len as usize);
        // SAFETY: the mapping is that long and lives as long as the node, which the slice borrows. Between dequeueing a buffer
        // and queueing it again the driver leaves it alone, and queueing needs the node exclusively.
        unsafe { std::slice::from_raw_parts(map.start.as_ptr().cast(), len) }
    }
}

fn clock_of(flags: u32) -> StampClock {
    // A loopback sets both flags where its writer brought the stamp.
    if flags & sys::V4L2_BUF_FLAG_TIMESTAMP_COPY != 0 {
        return StampClock::Copied;
    }
    match flags & sys::V4L2_BUF_FLAG_TIMESTAMP_MASK {
        sys::V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC => StampClock::Monotonic,
        _ => StampClock::Unknown,
    }
}

fn source_of(flags: u32) -> StampSource {
    match flags & sys::V4L2_BUF_FLAG_TSTAMP_SRC_MASK {
        sys::V4L2_BUF_FLAG_TSTAMP_SRC_SOE => StampSource::StartOfExposure,
        _ => StampSource::EndOfFrame,
    }
}

/// A name as the kernel writes it, up to its first zero.
fn text(bytes: &[u8]) -> String {
    let len = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..len]).into_owned()
}
