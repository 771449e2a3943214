#![allow(clippy::unwrap_used, reason = "tests")]

use std::cell::RefCell;
use std::collections::VecDeque;
use std::path::Path;
use std::rc::Rc;

use freespace::emit::{BitRates, CanFrame};
use rtrb::{Consumer, Producer, RingBuffer};

use super::super::counters::EVENTS;
use super::super::outbox::Outgoing;
use super::*;
use crate::wheels::WheelMapping;

const MS: u64 = 1_000_000;
const WALL: u64 = 1_700_000_000_000_000_000;

/// An interface that a test plays.
#[derive(Default)]
struct Stage {
    incoming: VecDeque<Result<Received, WireFault>>,
    sent: Vec<CanFrame>,
    /// What the next sends answer; all well once it is empty.
    answers: VecDeque<WireFault>,
    standing: Option<Standing>,
    open_fault: Option<WireFault>,
    opens: u32,
}

#[derive(Clone, Default)]
struct Fake(Rc<RefCell<Stage>>);

impl Adapter for Fake {
    type Wire = Self;

    fn open(&mut self) -> Result<Self, WireFault> {
        let mut stage = self.0.borrow_mut();
        stage.opens += 1;
        stage.open_fault.map_or_else(|| Ok(self.clone()), Err)
    }
}

impl Wire for Fake {
    fn receive(&mut self) -> Result<Option<Received>, WireFault> {
        self.0.borrow_mut().incoming.pop_front().transpose()
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), WireFault> {
        let mut stage = self.0.borrow_mut();
        if let Some(fault) = stage.answers.pop_front() {
            return Err(fault);
        }
        stage.sent.push(frame.clone());
        Ok(())
    }

    fn standing(&mut self) -> Standing {
        self.0.borrow().standing.unwrap_or(Standing::Running)
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        None
    }
}

/// A link on a stage, with both of its sides.
struct Play {
    stage: Fake,
    link: Link<Fake>,
    teller: Teller,
    events: Consumer<CanTrace>,
    readings: Consumer<WheelReading>,
    ring: Producer<Outgoing>,
    state: Arc<OutState>,
    counters: Arc<Counters>,
    now_ns: u64,
}

const DBC: &str = "VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: ABS\n\nBO_ 903 PULSES: 5 ABS\n \
    SG_ FL : 0|8@1+ (1,0) [0|0] \"\" ABS\n SG_ FR : 8|8@1+ (1,0) [0|0] \"\" ABS\n \
    SG_ RL : 16|8@1+ (1,0) [0|0] \"\" ABS\n SG_ RR : 24|8@1+ (1,0) [0|0] \"\" ABS\n \
    SG_ SUM : 32|8@1+ (1,0) [0|0] \"\" ABS\n";

pub(in crate::can) fn decoder() -> WheelDecoder {
    let text = "message = \"PULSES\"\nkind = \"counts\"\nsignals = [\"FL\", \"FR\", \"RL\", \"RR\"]\n\
        checksum = { signal = \"SUM\", algorithm = \"xor\" }";
    let mapping: WheelMapping = toml::from_str(text).unwrap();
    WheelDecoder::new(Path::new("car.dbc"), DBC, &mapping).unwrap()
}

impl Play {
    fn new() -> Self {
        Self::with_ring(32)
    }

    fn with_ring(frames: usize) -> Self {
        let (teller, events) = RingBuffer::new(EVENTS);
        let (readings_to, readings) = RingBuffer::new(8);
        let (ring, outgoing) = RingBuffer::new(frames);
        let (stage, state) = (Fake::default(), Arc::new(OutState::default()));
        let counters: Arc<Counters> = Arc::default();
        let mut link = Link::new(stage.clone(), 0, Arc::clone(&counters));
        link.wheels = Some(WheelSide {
            decoder: decoder(),
            readings: readings_to,
            offset_micros: -500,
        });
        link.sends = Some(SendSide {
            outbox: Outbox::new(outgoing, 500_000),
            state: Arc::clone(&state),
            pacer: Pacer::new(0.5),
            rates: BitRates {
                nominal: 500_000,
                data: 2_000_000,
            },
        });
        Self {
            stage,
            link,
            teller: Teller(teller),
            events,
            readings,
            ring,
            state,
            counters,
            now_ns: 10 * MS,
        }
    }

    /// One step, and the time moves to its end.
    fn step(&mut self) -> u64 {
        let now = Now {
            monotonic_ns: self.now_ns,
            realtime_ns: WALL + self.now_ns,
            spread_ns: 100,
        };
        self.link.step(&|| now, &mut self.teller)
    }

    /// Steps when the link asks for it, until `until_ns`.
    fn run_until(&mut self, until_ns: u64) {
        while self.now_ns < until_ns {
            let next = self.step();
            self.now_ns = next.max(self.now_ns + 1000).min(until_ns);
        }
    }

    fn publish(&mut self, publication: u32, frames: usize) {
        self.state.newest.store(publication, Ordering::Release);
        for at in 0..frames {
            let mut frame = CanFrame {
                id: 0x600 + u32::try_from(at).unwrap(),
                ..CanFrame::default()
            };
            frame.data.resize(8, publication.to_le_bytes()[0]).unwrap();
            self.ring.push(Outgoing { publication, frame }).ok().unwrap();
        }
    }

    fn wheel(&self, counts: [u8; 4], age_ns: u64) -> Received {
        let mut data = [0; 64];
        data[..4].copy_from_slice(&counts);
        data[4] = counts.iter().fold(0, |sum, count| sum ^ count);
        Received {
            id: 903,
            is_extended: false,
            is_error: false,
            is_remote: false,
            length: 5,
            data,
            software_ns: Some(WALL + self.now_ns - age_ns),
            hardware_ns: None,
            overflow: None,
        }
    }

    fn comes(&mut self, frame: Result<Received, WireFault>) {
        self.stage.0.borrow_mut().incoming.push_back(frame);
    }

    fn report(&mut self, class: u32, problem: u8) {
        let mut report = self.wheel([0; 4], 0);
        (report.id, report.is_error, report.data[1]) = (class, true, problem);
        self.comes(Ok(report));
    }

    fn events(&mut self) -> Vec<CanEvent> {
        std::iter::from_fn(|| self.events.pop().ok().map(|trace| trace.event)).collect()
    }

    fn sent(&self) -> usize {
        self.stage.0.borrow().sent.len()
    }
}

#[test]
fn readings_carry_the_kernels_stamp_and_garbage_is_none() {
    let mut play = Play::new();
    play.step();
    play.now_ns += 20 * MS;
    let good = play.wheel([1, 2, 3, 4], 3 * MS);
    let mut damaged = play.wheel([1, 2, 3, 5], MS);
    damaged.data[0] ^= 4;
    let mut short = play.wheel([1, 2, 3, 5], MS);
    short.length = 4;
    let mut remote = play.wheel([1, 2, 3, 5], MS);
    remote.is_remote = true;
    let mut lost = play.wheel([1, 2, 3, 5], 0);
    lost.overflow = Some(7);
    for frame in [good, damaged, short, remote, lost] {
        play.comes(Ok(frame));
    }
    play.step();
    // 30 ms, 3 ms old, and the configured offset of -0.5 ms.
    assert_eq!(play.readings.pop().unwrap().stamp(), Micros(26_500));
    assert_eq!(play.readings.pop().unwrap().stamp(), Micros(29_500));
    assert!(play.readings.pop().is_err());
    let counts = play.counters.counts();
    assert_eq!(
        (counts.refused_checksum, counts.refused_short, counts.refused()),
        (1, 1, 2)
    );
    assert_eq!(
        (counts.readings, counts.stamped_by_software, counts.queue_overflow),
        (2, 2, 7)
    );
}

#[test]
fn readings_that_nobody_fetches_are_dropped_and_a_flood_is_bounded() {
    let mut play = Play::new();
    play.step();
    for _ in 0..RECEIVE_MOST + 10 {
        let frame = play.wheel([0; 4], 0);
        play.comes(Ok(frame));
    }
    assert_eq!(play.step(), play.now_ns, "the rest is taken at once");
    assert_eq!(play.stage.0.borrow().incoming.len(), 10);
    assert_eq!(play.counters.counts().readings_dropped, RECEIVE_MOST as u64 - 8);
}

#[test]
fn an_absent_interface_is_told_once_and_taken_when_it_comes() {
    let mut play = Play::new();
    play.stage.0.borrow_mut().open_fault = Some(WireFault::Gone);
    play.run_until(5_000 * MS);
    let opens = play.stage.0.borrow().opens;
    assert!((6..=9).contains(&opens), "{opens} attempts in 5 s");
    assert_eq!(play.events(), [CanEvent::Unopened(WireFault::Gone)]);
    assert!(!play.state.is_open.load(Ordering::Acquire));
    play.stage.0.borrow_mut().open_fault = None;
    play.run_until(6_100 * MS);
    assert_eq!(play.events(), [CanEvent::Opened]);
    assert!(play.state.is_open.load(Ordering::Acquire));
}

#[test]
fn down_up_removed_and_created_again() {
    let mut play = Play::new();
    play.step();
    play.comes(Err(WireFault::Down));
    play.stage.0.borrow_mut().standing = Some(Standing::Down);
    play.run_until(500 * MS);
    assert_eq!(play.events(), [CanEvent::Opened, CanEvent::Down]);
    assert!(!play.state.is_open.load(Ordering::Acquire));
    play.stage.0.borrow_mut().standing = None;
    play.run_until(700 * MS);
    assert_eq!(play.events(), [CanEvent::Running]);
    assert_eq!(
        play.stage.0.borrow().opens,
        1,
        "the socket of an interface that is down stays"
    );
    play.comes(Err(WireFault::Gone));
    play.run_until(2_000 * MS);
    assert_eq!(play.events(), [CanEvent::Lost, CanEvent::Opened]);
    // Another adapter under the same name: the old socket hears nothing of it.
    play.stage.0.borrow_mut().standing = Some(Standing::Gone);
    let until = play.now_ns + 1_000 * MS;
    play.run_until(until);
    play.stage.0.borrow_mut().standing = None;
    play.run_until(until + 1_200 * MS);
    assert_eq!(play.events().last(), Some(&CanEvent::Opened));
    let counts = play.counters.counts();
    assert!(
        counts.downs == 1 && counts.losses >= 2 && counts.opened >= 3,
        "{counts:?}"
    );
}

#[test]
fn bus_off_holds_frames_until_the_controller_restarts() {
    let mut play = Play::new();
    play.step();
    play.report(0x004, 0x20);
    play.report(0x040, 0);
    play.stage.0.borrow_mut().standing = Some(Standing::Off);
    play.publish(1, 12);
    play.run_until(200 * MS);
    assert_eq!(play.sent(), 0);
    assert!(!play.state.is_open.load(Ordering::Acquire));
    let passive = CanEvent::State(ControllerState::Passive);
    assert_eq!(play.events(), [CanEvent::Opened, passive, CanEvent::BusOff]);
    play.stage.0.borrow_mut().standing = None;
    play.report(0x100, 0);
    play.run_until(300 * MS);
    assert_eq!(play.sent(), 12, "the publication's period is not over yet");
    let counts = play.counters.counts();
    assert_eq!(
        (counts.bus_off, counts.error_passive, counts.error_reports),
        (1, 1, 3)
    );
}

#[test]
fn frames_are_paced_and_a_full_queue_is_tried_again() {
    let mut play = Play::new();
    play.step();
    play.publish(1, 12);
    play.step();
    assert_eq!(play.sent(), 6, "a queue of ten is never filled");
    play.stage.0.borrow_mut().answers = [WireFault::Full; 3].into();
    play.run_until(60 * MS);
    assert_eq!(play.sent(), 12);
    let ids: Vec<u32> = play.stage.0.borrow().sent.iter().map(|frame| frame.id).collect();
    assert!(ids.is_sorted(), "{ids:?}");
    let counts = play.counters.counts();
    assert_eq!((counts.sent, counts.queue_full, counts.dropped_late), (12, 3, 0));
}

#[test]
fn the_newest_publication_wins_and_none_leaves_late() {
    let mut play = Play::new();
    play.step();
    play.stage.0.borrow_mut().answers = vec![WireFault::Full; 100_000].into();
    play.publish(1, 12);
    play.run_until(100 * MS);
    play.publish(2, 12);
    play.run_until(200 * MS);
    assert_eq!(play.counters.counts().dropped_for_newer, 12);
    play.run_until(800 * MS);
    assert_eq!(play.counters.counts().dropped_late, 12);
    assert_eq!(play.sent(), 0);
    play.stage.0.borrow_mut().answers.clear();
    play.publish(3, 12);
    play.run_until(900 * MS);
    assert!(play.stage.0.borrow().sent.iter().all(|frame| frame.data[0] == 3));
    assert_eq!(play.sent(), 12);
}

#[test]
fn frames_that_the_interface_does_not_take_are_left_out() {
    let mut play = Play::new();
    play.step();
    play.stage.0.borrow_mut().answers = [WireFault::Unsupported; 2].into();
    play.publish(1, 4);
    play.run_until(30 * MS);
    assert_eq!((play.sent(), play.counters.counts().dropped_unsupported), (2, 2));
    assert_eq!(
        play.events(),
        [CanEvent::Opened, CanEvent::Refuses(WireFault::Unsupported)]
    );
}
