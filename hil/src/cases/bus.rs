//! The bus and the wheels misbehave.

use std::io::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use freespace::health::Faults;
use freespace_platform::world::Slip;
use socketcan::{CanDataFrame, CanFrame, CanSocket, EmbeddedFrame as _, Socket as _, StandardId};

use crate::bench::{Bench, BenchError, Rig};
use crate::case::{Case, Seen};
use crate::drive::{Script, drive};
use crate::fault::WheelFault;
use crate::promise::Blind;

/// A slip of a third, as on a wet manhole cover, from the seventh second of the drive on.
const SLIP: Slip = Slip {
    from_s: 7.0,
    to_s: 9.0,
    share: 0.35,
};

/// Cases of the bus.
pub(crate) const CASES: &[Case] = &[
    Case {
        name: "wheels-silent",
        injected: "no wheel frame for 4 s",
        required: "wheels_silent is named, the scale is held, recovers",
        is_quick: true,
        run: |rig| wheels(rig, WheelFault::Silent, unreadable()),
    },
    Case {
        name: "wheels-garbage",
        injected: "random bytes in the wheel frames for 4 s",
        required: "none is believed: wheels_silent is named, the scale is held",
        is_quick: true,
        run: |rig| wheels(rig, WheelFault::Garbage, unreadable()),
    },
    Case {
        name: "wheels-counter",
        injected: "the alive counter stands still for 4 s",
        required: "none is believed: wheels_silent is named, the scale is held",
        is_quick: true,
        run: |rig| wheels(rig, WheelFault::WrongCounter, unreadable()),
    },
    Case {
        name: "wheels-checksum",
        injected: "wrong checksums for 4 s",
        required: "none is believed: wheels_silent is named, the scale is held",
        is_quick: true,
        run: |rig| wheels(rig, WheelFault::WrongChecksum, unreadable()),
    },
    Case {
        name: "wheels-wrap",
        injected: "counters of 8 bits wrap twice a second, nothing else",
        required: "no fault is named",
        is_quick: true,
        run: |rig| wheels(rig, WheelFault::None, Script::default()),
    },
    Case {
        name: "wheel-stuck",
        injected: "the counter of the rear left wheel stands still for 4 s",
        required: "wheels_slip is named, recovers",
        is_quick: true,
        run: |rig| {
            let script = Script {
                named: Faults::WHEELS_SLIP,
                allowed: Faults::SCALE_HELD,
                ..Script::default()
            };
            wheels(rig, WheelFault::StuckWheel, script)
        },
    },
    Case {
        name: "wheel-slip",
        injected: "all wheels turn 35 % too fast from second 7 to 9 of the drive",
        required: "wheels_slip is named, the scale is held, recovers",
        is_quick: true,
        run: slip,
    },
    Case {
        name: "bus-loaded",
        injected: "8,000 foreign frames a second for 5 s: a 1 Mbit/s bus at its limit",
        required: "no fault is named",
        is_quick: true,
        run: |rig| loaded(rig),
    },
    Case {
        name: "bus-off",
        injected: "the controller reports bus-off, and 2 s later its restart",
        required: "can_send_failed is named, recovers",
        is_quick: true,
        run: bus_off,
    },
    Case {
        name: "bus-down",
        injected: "the interface is down for 3 s and up again",
        required: "the module lives on, can_send_failed is named, recovers",
        is_quick: true,
        run: bus_down,
    },
    Case {
        name: "slow-reader",
        injected: "a reader that does not read, another that is killed",
        required: "no fault is named",
        is_quick: true,
        run: slow_reader,
    },
];

/// The readings cannot be used: the pose comes from the picture alone.
fn unreadable() -> Script {
    Script {
        named: Faults::WHEELS_SILENT | Faults::SCALE_HELD,
        ..Script::default()
    }
}

fn wheels(rig: &Rig, fault: WheelFault, script: Script) -> Result<Seen, BenchError> {
    let set = |fault: WheelFault| {
        move |bench: &mut Bench| {
            bench.feed.switches.set_wheels(fault);
            Ok(())
        }
    };
    let (begin, end) = (Box::new(set(fault)), Box::new(set(WheelFault::None)));
    drive(rig, &Script { begin, end, ..script })
}

fn slip(rig: &Rig) -> Result<Seen, BenchError> {
    let until = |seconds: f64| {
        move |bench: &mut Bench| {
            let left = seconds - bench.feed.seconds_at(crate::clock::now_micros());
            if left < 0.0 {
                return Err(BenchError::NoAnswer(
                    "it took too long to drive: the slip is over".to_owned(),
                ));
            }
            std::thread::sleep(Duration::from_secs_f64(left));
            Ok(())
        }
    };
    let script = Script {
        begin: Box::new(until(SLIP.from_s)),
        fault_s: SLIP.to_s - SLIP.from_s + 0.5,
        named: Faults::WHEELS_SLIP | Faults::SCALE_HELD,
        slips: &[SLIP],
        recovers_s: 4.0,
        ..Script::default()
    };
    drive(rig, &script)
}

/// Frames of a whole second are sent in portions of a millisecond.
const FOREIGN_A_MILLISECOND: u32 = 8;

fn loaded(rig: &Rig) -> Result<Seen, BenchError> {
    let is_over = Arc::new(AtomicBool::new(false));
    let flood = {
        let (interface, is_over) = (rig.interface.clone(), Arc::clone(&is_over));
        move |_: &mut Bench| {
            let socket = CanSocket::open(&interface)?;
            let is_over = Arc::clone(&is_over);
            std::thread::spawn(move || flood(&socket, &is_over));
            Ok(())
        }
    };
    let script = Script {
        fault_s: 5.0,
        begin: Box::new(flood),
        end: Box::new(move |_| {
            is_over.store(true, Ordering::Relaxed);
            Ok(())
        }),
        ..Script::default()
    };
    drive(rig, &script)
}

fn flood(socket: &CanSocket, is_over: &AtomicBool) {
    let Some(frame) = StandardId::new(0x123).and_then(|id| CanDataFrame::new(id, &[0x55; 8])) else {
        return;
    };
    let mut at = crate::clock::now_micros();
    while !is_over.load(Ordering::Relaxed) {
        for _ in 0..FOREIGN_A_MILLISECOND {
            let _ = socket.write_frame(&CanFrame::Data(frame));
        }
        at += 1000;
        crate::clock::sleep_until(at);
    }
}

/// Error frames of the controller, as `linux/can/error.h` gives them: only a virtual bus lets anyone send them.
const ERROR_FRAME: u32 = 0x2000_0000;
const BUS_OFF: u32 = 0x40;
const RESTARTED: u32 = 0x100;

/// A controller that is off says so again to whoever opens it.
const SAY_AGAIN: Duration = Duration::from_millis(5);

fn bus_off(rig: &Rig) -> Result<Seen, BenchError> {
    let is_over = Arc::new(AtomicBool::new(false));
    let off = {
        let (interface, is_over) = (rig.interface.clone(), Arc::clone(&is_over));
        move |bench: &mut Bench| {
            let socket = CanSocket::open(&interface)?;
            let is_over = Arc::clone(&is_over);
            // A controller that is off hears nothing: one that hears a frame is on the bus again, and the module takes it so.
            bench.feed.switches.set_wheels(WheelFault::Silent);
            std::thread::spawn(move || {
                while !is_over.load(Ordering::Relaxed) {
                    let _ = report(&socket, BUS_OFF);
                    std::thread::sleep(SAY_AGAIN);
                }
                let _ = report(&socket, RESTARTED);
            });
            Ok(())
        }
    };
    let script = Script {
        fault_s: 2.0,
        begin: Box::new(off),
        end: Box::new(move |bench| {
            is_over.store(true, Ordering::Relaxed);
            bench.feed.switches.set_wheels(WheelFault::None);
            Ok(())
        }),
        named: Faults::CAN_SEND_FAILED,
        allowed: Faults::WHEELS_SILENT | Faults::SCALE_HELD,
        recovers_s: 5.0,
        // While it is off nothing is heard: the first message after it tells.
        blind: Blind { spots: true },
        ..Script::default()
    };
    drive(rig, &script)
}

fn report(socket: &CanSocket, class: u32) -> std::io::Result<()> {
    let frame = socketcan::CanErrorFrame::new_error(ERROR_FRAME | class, &[0; 8])
        .map_err(|error| Error::other(error.to_string()))?;
    socket.write_frame(&CanFrame::Error(frame))
}

fn bus_down(rig: &Rig) -> Result<Seen, BenchError> {
    let link = |state: &'static str| move |bench: &mut Bench| bench.rig.link(state);
    let script = Script {
        fault_s: 3.0,
        begin: Box::new(link("down")),
        end: Box::new(link("up")),
        named: Faults::CAN_SEND_FAILED,
        allowed: Faults::WHEELS_SILENT | Faults::SCALE_HELD,
        recovers_s: 5.0,
        blind: Blind { spots: true },
        ..Script::default()
    };
    drive(rig, &script)
}

fn slow_reader(rig: &Rig) -> Result<Seen, BenchError> {
    let interface = rig.interface.clone();
    let begin = move |_: &mut Bench| {
        // Its receive buffer fills up; it is not read until the process ends.
        std::mem::forget(CanSocket::open(&interface)?);
        let mut reader = std::process::Command::new(std::env::current_exe()?)
            .args(["listen", &interface])
            .spawn()?;
        std::thread::sleep(Duration::from_millis(1500));
        reader.kill()?;
        reader.wait()?;
        Ok(())
    };
    let script = Script {
        begin: Box::new(begin),
        ..Script::default()
    };
    drive(rig, &script)
}
