//! Where the program was built without `v4l2`: no device can be opened, and it is said why.

use std::path::Path;

use freespace::port::Clock as _;
use freespace::space::Micros;
use rustix::io::Errno;

use super::node::{Abilities, Buffers, Control, Devices, Filled, FourCc, Interval, Layout, Node, SizeOffer};
use crate::clock::MonotonicClock;

/// No device at all.
#[derive(Debug)]
pub(super) struct Kernel(MonotonicClock);

impl Kernel {
    pub(super) fn new() -> Self {
        Self(MonotonicClock::of_devices())
    }
}

/// There is none.
pub(super) enum Nothing {}

impl Devices for Kernel {
    type Node = Nothing;

    fn open(&mut self, _: &Path) -> Result<Nothing, Errno> {
        Err(Errno::NOSYS)
    }

    fn now(&self) -> Micros {
        self.0.now()
    }

    fn pause(&mut self, micros: u64) {
        std::thread::sleep(std::time::Duration::from_micros(micros));
    }
}

impl Node for Nothing {
    fn abilities(&mut self) -> Result<Abilities, Errno> {
        match *self {}
    }

    fn format_at(&mut self, _: u32) -> Result<FourCc, Errno> {
        match *self {}
    }

    fn size_at(&mut self, _: FourCc, _: u32) -> Result<SizeOffer, Errno> {
        match *self {}
    }

    fn set_layout(&mut self, _: Layout) -> Result<Layout, Errno> {
        match *self {}
    }

    fn set_interval(&mut self, _: Interval) -> Result<Option<Interval>, Errno> {
        match *self {}
    }

    fn control_after(&mut self, _: u32) -> Result<Control, Errno> {
        match *self {}
    }

    fn menu_item(&mut self, _: &Control, _: u32) -> Result<String, Errno> {
        match *self {}
    }

    fn set_control(&mut self, _: u32, _: i32) -> Result<(), Errno> {
        match *self {}
    }

    fn map_buffers(&mut self, _: u32) -> Result<Buffers, Errno> {
        match *self {}
    }

    fn queue(&mut self, _: u32) -> Result<(), Errno> {
        match *self {}
    }

    fn start(&mut self) -> Result<(), Errno> {
        match *self {}
    }

    fn wait(&mut self, _: u64) -> Result<bool, Errno> {
        match *self {}
    }

    fn dequeue(&mut self) -> Result<Filled, Errno> {
        match *self {}
    }

    fn bytes(&self, _: u32, _: u32) -> &[u8] {
        match *self {}
    }
}
