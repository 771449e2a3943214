//! An interface that goes down and up, is removed and created again; needs the rights to do that, else it is skipped by name.

use std::process::Command;
use std::time::Duration;

use freespace::port::{Clock as _, SinkMiss, SinkPort as _, WheelPort as _};
use freespace::space::Micros;
use freespace_platform::can::{self, CanEvent};
use freespace_platform::clock::MonotonicClock;
use socketcan::{CanDataFrame, CanSocket, EmbeddedFrame as _, Socket as _, StandardId};

use super::rig::{interface, plan, publication, wait_for, wheel_bytes};

fn ip(arguments: &str) -> bool {
    Command::new("ip")
        .args(arguments.split(' '))
        .output()
        .is_ok_and(|output| output.status.success())
}

#[test]
fn an_interface_goes_and_comes_back() {
    if interface("an_interface_goes_and_comes_back").is_none() {
        return;
    }
    let name = "fstest0";
    let create =
        || ip(&format!("link add dev {name} mtu 72 type vcan")) && ip(&format!("link set {name} up"));
    if !create() {
        eprintln!("SKIPPED: an_interface_goes_and_comes_back: {name} cannot be created");
        return;
    }
    let mut devices = can::open(plan(name)).unwrap();
    let mut sink = devices.sink.take().unwrap();
    let mut events = Vec::new();
    let (message, frames) = publication(&mut freespace::emit::CanEncoder::default(), 1);
    let mut listener = devices.listener;
    let mut until = |wanted: CanEvent| {
        wait_for(&format!("{wanted:?}"), || {
            while let Some(trace) = listener.next_event() {
                println!("{}", listener.line(&trace));
                events.push(trace.event);
            }
            events.last() == Some(&wanted)
        });
    };
    until(CanEvent::Opened);
    wait_for("taking", || sink.publish(&message, &frames).is_ok());
    assert!(ip(&format!("link set {name} down")));
    until(CanEvent::Down);
    assert_eq!(sink.publish(&message, &frames), Err(SinkMiss::Refused));
    assert!(ip(&format!("link set {name} up")));
    until(CanEvent::Running);
    wait_for("taking", || sink.publish(&message, &frames).is_ok());
    assert!(ip(&format!("link del {name}")));
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(sink.publish(&message, &frames), Err(SinkMiss::Refused));
    assert!(create());
    until(CanEvent::Opened);
    let sent = devices.watch.counts().sent;
    wait_for("taking", || sink.publish(&message, &frames).is_ok());
    wait_for("sending", || devices.watch.counts().sent >= sent + 12);
    drop(sink);
    let counts = devices.watch.counts();
    println!("{counts:?}");
    assert_eq!(counts.allocations, 0);
    let _ = ip(&format!("link del {name}"));
}

/// Processor time of this process's CAN thread, nanoseconds.
fn can_thread_ns() -> u64 {
    let threads = std::fs::read_dir("/proc/self/task").unwrap();
    (threads.flatten())
        .filter(|thread| {
            std::fs::read_to_string(thread.path().join("comm")).is_ok_and(|name| name.trim() == "can")
        })
        .filter_map(|thread| {
            let times = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
            times.split(' ').next()?.parse::<u64>().ok()
        })
        .sum()
}

#[test]
fn a_full_bus_costs_no_more_than_its_wheel_messages() {
    let Some(name) = interface("a_full_bus_costs_no_more") else {
        return;
    };
    let devices = can::open(plan(&name)).unwrap();
    wait_for("opening", || devices.watch.counts().opened > 0);
    let socket = CanSocket::open(&name).unwrap();
    let frame = |id, data: &[u8]| CanDataFrame::new(StandardId::new(id).unwrap(), data).unwrap();
    let mut cost_ns = [0; 2];
    // The second time among 40 others for each wheel message: 4,100 frames in the second that a bus of 500 kbit/s takes for them.
    for ((cost_ns, others), wanted) in cost_ns.iter_mut().zip([0, 40]).zip([100, 200]) {
        let begin = can_thread_ns();
        for number in 0..100_u64 {
            for _ in 0..others {
                socket.write_frame(&frame(0x100, &[0; 8])).unwrap();
            }
            socket.write_frame(&frame(0x387, &wheel_bytes(number))).unwrap();
            std::thread::sleep(Duration::from_millis(1));
        }
        wait_for("receipt", || devices.watch.counts().received >= wanted);
        *cost_ns = can_thread_ns() - begin;
    }
    let counts = devices.watch.counts();
    println!(
        "CAN thread: {} ns a wheel message alone, {} ns among 40 others; {counts:?}",
        cost_ns[0] / 100,
        cost_ns[1] / 100
    );
    assert_eq!((counts.received, counts.queue_overflow), (200, 0), "{counts:?}");
}

#[test]
fn a_step_of_the_wall_clock_moves_no_reading() {
    let test = "a_step_of_the_wall_clock_moves_no_reading";
    let Some(name) = interface(test) else {
        return;
    };
    if std::env::var_os("FREESPACE_TEST_CLOCK").is_none() {
        eprintln!("SKIPPED: {test}: sets the wall clock; set FREESPACE_TEST_CLOCK=1 on a machine of its own");
        return;
    }
    let mut devices = can::open(plan(&name)).unwrap();
    let mut port = devices.wheels.take().unwrap();
    wait_for("opening", || devices.watch.counts().opened > 0);
    let clock = MonotonicClock::of_devices();
    let socket = CanSocket::open(&name).unwrap();
    let id = StandardId::new(0x387).unwrap();
    let mut sent = Vec::new();
    for number in 0..200_u64 {
        let steps = ["+1 hour", "-2 hours", "+1 day", "-30 seconds"];
        if let Some(step) = (number % 40 == 20).then(|| steps[usize::try_from(number / 40).unwrap() % 4]) {
            let date = Command::new("date").args(["-s", step]).output().unwrap();
            assert!(date.status.success(), "{date:?}");
        }
        let begin = clock.now();
        let frame = CanDataFrame::new(id, &wheel_bytes(number)).unwrap();
        socket.write_frame(&frame).unwrap();
        sent.push((begin, clock.now()));
        std::thread::sleep(Duration::from_millis(2));
    }
    wait_for("receipt", || devices.watch.counts().readings == 200);
    let mut stamps = Vec::new();
    port.readings_until(clock.now(), &mut |reading| stamps.push(reading.stamp()));
    let off =
        |(stamp, (begin, end)): (&Micros, &(Micros, Micros))| begin.since(*stamp).max(stamp.since(*end));
    let worst = stamps.iter().zip(&sent).map(off).max().unwrap();
    let counts = devices.watch.counts();
    println!("worst stamp {worst} us outside of its sending; {counts:?}");
    // On a virtual bus a frame is stamped while it is sent. What is stamped at its receipt may be as late as the thread.
    assert!(worst < 5_000, "{worst} us");
    assert!(counts.clock_steps >= 4, "{counts:?}");
}
