//! A camera by script: a driver with its queue, its faults, and a clock that only its own waits move.
//!
//! It keeps the kernel's rules: a buffer that is queued twice, or read while it is queued, fails the test.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::path::Path;
use std::rc::Rc;

use freespace::space::Micros;
use rustix::io::Errno;

use super::node::{
    Abilities, Buffers, Control, ControlKind, Devices, Filled, FourCc, Interval, Layout, Node, SizeOffer,
};
use super::{StampClock, StampSource};

/// What the driver does next.
#[derive(Clone, Copy, Debug)]
pub(super) enum Act {
    /// Fills a buffer, so long after it was waited for.
    Fill(Shot),
    /// Nothing for so long.
    Pause(u64),
    /// The next request for a frame fails, and all that follow on this connection.
    Fail(Errno),
    /// The wait itself fails: hung up.
    HangUp(Errno),
    /// Says that there is a frame, and has none.
    False,
}

/// A frame that the driver gives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shot {
    pub(super) sequence: u32,
    /// Stamp, from the driver's clock at that time.
    pub(super) stamp: fn(u64) -> u64,
    pub(super) clock: StampClock,
    pub(super) is_damaged: bool,
    /// Bytes that are missing at its end.
    pub(super) torn: u32,
    /// Time from the wait to the frame.
    pub(super) after_micros: u64,
}

/// A sound frame 20 ms after the last one, stamped 5 ms before it comes.
pub(super) const fn shot(sequence: u32) -> Shot {
    Shot {
        sequence,
        stamp: |now| now - 5_000,
        clock: StampClock::Monotonic,
        is_damaged: false,
        torn: 0,
        after_micros: 20_000,
    }
}

pub(super) fn fill(sequence: u32) -> Act {
    Act::Fill(shot(sequence))
}

/// A computer with one camera.
pub(super) struct World {
    pub(super) now: u64,
    pub(super) acts: VecDeque<Act>,
    /// What opening fails with; none where the camera is there.
    pub(super) absent: Option<Errno>,
    pub(super) abilities: Abilities,
    pub(super) layouts: Vec<Layout>,
    pub(super) interval: Option<Interval>,
    pub(super) controls: Vec<Control>,
    pub(super) menu: Vec<&'static str>,
    pub(super) set: Vec<(u32, i32)>,
    pub(super) stamps: StampClock,
    pub(super) start: Option<Errno>,
    pub(super) opens: Vec<u64>,
    /// What buffers hold.
    pub(super) picture: Vec<u8>,
}

pub(super) const SIZE: (u32, u32) = (8, 4);

pub(super) fn yuyv(width: u32, height: u32) -> Layout {
    Layout {
        format: FourCc(*b"YUYV"),
        width,
        height,
        bytes_per_line: 2 * width + 4,
        image_bytes: (2 * width + 4) * height,
        is_progressive: true,
    }
}

pub(super) fn control(id: u32, name: &str, kind: ControlKind, maximum: i64) -> Control {
    Control {
        id,
        name: name.to_owned(),
        kind,
        minimum: 0,
        maximum,
        step: if kind == ControlKind::Integer { 5 } else { 1 },
        is_writable: true,
    }
}

impl Default for World {
    fn default() -> Self {
        Self {
            now: 10_000_000,
            acts: VecDeque::new(),
            absent: None,
            abilities: Abilities {
                is_capture: true,
                is_multi_planar: false,
                is_streaming: true,
            },
            layouts: vec![yuyv(SIZE.0, SIZE.1)],
            interval: Some(Interval {
                numerator: 1,
                denominator: 30,
            }),
            controls: Vec::new(),
            menu: Vec::new(),
            set: Vec::new(),
            stamps: StampClock::Monotonic,
            start: None,
            opens: Vec::new(),
            picture: vec![7; 4096],
        }
    }
}

/// A handle of it: the test keeps one, the camera another.
#[derive(Clone, Default)]
pub(super) struct Script(pub(super) Rc<RefCell<World>>);

impl Script {
    pub(super) fn acts(&self, acts: impl IntoIterator<Item = Act>) {
        self.0.borrow_mut().acts.extend(acts);
    }
}

impl Devices for Script {
    type Node = ScriptNode;

    fn open(&mut self, _: &Path) -> Result<ScriptNode, Errno> {
        let mut world = self.0.borrow_mut();
        let now = world.now;
        world.opens.push(now);
        match world.absent {
            Some(errno) => Err(errno),
            None => Ok(ScriptNode {
                world: Rc::clone(&self.0),
                queued: VecDeque::with_capacity(32),
                filled: VecDeque::with_capacity(32),
                picture: world.picture.clone(),
                broken: None,
            }),
        }
    }

    fn now(&self) -> Micros {
        Micros(self.0.borrow().now)
    }

    fn pause(&mut self, micros: u64) {
        self.0.borrow_mut().now += micros;
    }
}

pub(super) struct ScriptNode {
    world: Rc<RefCell<World>>,
    queued: VecDeque<u32>,
    filled: VecDeque<Filled>,
    picture: Vec<u8>,
    /// What each request answers from now on.
    broken: Option<Errno>,
}

impl ScriptNode {
    /// Fills what comes without a further wait.
    fn fill(&mut self, shot: Shot) {
        let now = self.world.borrow().now;
        // As a driver does: a frame without a buffer is dropped.
        let Some(buffer) = self.queued.pop_front() else {
            return;
        };
        self.filled.push_back(Filled {
            buffer,
            sequence: shot.sequence,
            stamp: Micros((shot.stamp)(now)),
            clock: shot.clock,
            len: (2 * SIZE.0 + 4) * SIZE.1 - shot.torn,
            is_damaged: shot.is_damaged,
        });
    }
}

impl ScriptNode {
    /// The next frame, where it comes together with the last one.
    fn at_once(&self) -> Option<Shot> {
        let acts = &mut self.world.borrow_mut().acts;
        match acts.front() {
            Some(Act::Fill(next)) if next.after_micros == 0 => {
                let next = *next;
                acts.pop_front();
                Some(next)
            }
            _ => None,
        }
    }
}

impl Node for ScriptNode {
    fn abilities(&mut self) -> Result<Abilities, Errno> {
        Ok(self.world.borrow().abilities)
    }

    fn format_at(&mut self, number: u32) -> Result<FourCc, Errno> {
        let world = self.world.borrow();
        (world.layouts.get(number as usize))
            .map(|layout| layout.format)
            .ok_or(Errno::INVAL)
    }

    fn size_at(&mut self, format: FourCc, number: u32) -> Result<SizeOffer, Errno> {
        let world = self.world.borrow();
        (world.layouts.iter().filter(|layout| layout.format == format))
            .nth(number as usize)
            .map(|layout| SizeOffer::One(layout.width, layout.height))
            .ok_or(Errno::INVAL)
    }

    fn set_layout(&mut self, wanted: Layout) -> Result<Layout, Errno> {
        let world = self.world.borrow();
        let of = |layout: &&Layout| layout.format == wanted.format;
        let is_size = |layout: &&Layout| (layout.width, layout.height) == (wanted.width, wanted.height);
        (world.layouts.iter().filter(of).find(is_size))
            .or_else(|| world.layouts.iter().find(of))
            .or_else(|| world.layouts.first())
            .copied()
            .ok_or(Errno::INVAL)
    }

    fn set_interval(&mut self, _: Interval) -> Result<Option<Interval>, Errno> {
        Ok(self.world.borrow().interval)
    }

    fn control_after(&mut self, id: u32) -> Result<Control, Errno> {
        let world = self.world.borrow();
        (world.controls.iter().find(|control| control.id > id))
            .cloned()
            .ok_or(Errno::INVAL)
    }

    fn menu_item(&mut self, _: &Control, number: u32) -> Result<String, Errno> {
        let world = self.world.borrow();
        (world.menu.get(number as usize).filter(|name| !name.is_empty()))
            .map(|name| (*name).to_owned())
            .ok_or(Errno::INVAL)
    }

    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno> {
        self.world.borrow_mut().set.push((id, value));
        Ok(())
    }

    fn map_buffers(&mut self, wanted: u32) -> Result<Buffers, Errno> {
        Ok(Buffers {
            count: wanted,
            clock: self.world.borrow().stamps,
            source: StampSource::StartOfExposure,
        })
    }

    fn queue(&mut self, buffer: u32) -> Result<(), Errno> {
        assert!(!self.queued.contains(&buffer), "buffer {buffer} is queued twice");
        self.queued.push_back(buffer);
        self.broken.map_or(Ok(()), Err)
    }

    fn start(&mut self) -> Result<(), Errno> {
        self.world.borrow().start.map_or(Ok(()), Err)
    }

    fn wait(&mut self, micros: u64) -> Result<bool, Errno> {
        if !self.filled.is_empty() {
            return Ok(true);
        }
        let mut world = self.world.borrow_mut();
        match world.acts.front().copied() {
            Some(Act::Fill(shot)) => {
                world.acts.pop_front();
                world.now += shot.after_micros;
                drop(world);
                self.fill(shot);
                // Frames that come at once pile up.
                while let Some(next) = self.at_once() {
                    self.fill(next);
                }
                Ok(true)
            }
            Some(Act::HangUp(errno)) => {
                world.acts.pop_front();
                Err(errno)
            }
            Some(Act::Fail(_) | Act::False) => Ok(true),
            Some(Act::Pause(left)) => {
                let waited = left.min(micros);
                world.now += waited;
                world.acts[0] = Act::Pause(left - waited);
                if left == waited {
                    world.acts.pop_front();
                }
                Ok(false)
            }
            None => {
                world.now += micros;
                Ok(false)
            }
        }
    }

    fn dequeue(&mut self) -> Result<Filled, Errno> {
        if let Some(filled) = self.filled.pop_front() {
            return Ok(filled);
        }
        if let Some(errno) = self.broken {
            return Err(errno);
        }
        let mut world = self.world.borrow_mut();
        match world.acts.front().copied() {
            Some(Act::Fail(errno)) => {
                world.acts.pop_front();
                drop(world);
                self.broken = Some(errno);
                Err(errno)
            }
            Some(Act::False) => {
                world.acts.pop_front();
                Err(Errno::AGAIN)
            }
            _ => Err(Errno::AGAIN),
        }
    }

    fn bytes(&self, buffer: u32, len: u32) -> &[u8] {
        assert!(!self.queued.contains(&buffer), "buffer {buffer} is the driver's");
        &self.picture[..self.picture.len().min(len as usize)]
    }
}
