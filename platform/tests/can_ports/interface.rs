//! An interface that goes down and up, is removed and created again; needs the rights to do that, else it is skipped by name.

use std::process::Command;
use std::time::Duration;

use freespace::port::{SinkMiss, SinkPort as _};
use freespace_platform::can::{self, CanEvent};

use super::rig::{interface, plan, publication, wait_for};

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
