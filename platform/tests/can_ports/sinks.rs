//! What every sink on CAN keeps to.

use std::time::{Duration, Instant};

use freespace::emit::{CanEncoder, CanFrame, GridReader, can as frames, grid_frames};
use freespace::port::{SinkMiss, SinkPort as _};
use freespace_platform::can::{self, CanMonitor};

use super::rig::{COLUMNS, ROWS, interface, plan, publication, wait_for};

#[test]
fn an_absent_interface_refuses_and_is_told_once() {
    if let Err(error) = can::open(plan("freespace-none")) {
        eprintln!("SKIPPED: an_absent_interface_refuses: {error}");
        return;
    }
    let mut devices = can::open(plan("freespace-none")).unwrap();
    let mut sink = devices.sink.take().unwrap();
    let (message, sent) = publication(&mut CanEncoder::default(), 1);
    assert_eq!(sink.publish(&message, &sent), Err(SinkMiss::Refused));
    wait_for("an event", || devices.listener.next_event().is_some());
    assert_eq!(devices.watch.counts().publications_refused, 1);
    drop(sink);
}

#[test]
fn publications_decode_back_and_the_last_one_leaves() {
    let Some(name) = interface("publications_decode_back") else {
        return;
    };
    let mut devices = can::open(plan(&name)).unwrap();
    let mut sink = devices.sink.take().unwrap();
    wait_for("opening", || devices.watch.counts().opened > 0);
    std::thread::sleep(Duration::from_millis(20));
    let mut monitor = CanMonitor::open(&name).unwrap();
    let mut encoder = CanEncoder::default();
    let needed = frames::FRAMES + grid_frames::frames_of(ROWS * COLUMNS);
    for round in 0..3_u64 {
        let (message, sent) = publication(&mut encoder, round);
        sink.publish(&message, &sent).unwrap();
        let mut reader = GridReader::new(ROWS * COLUMNS);
        let mut classic = Vec::new();
        for _ in 0..needed {
            let frame = next(&mut monitor).unwrap();
            if frame.is_fd() {
                reader.take(&frame).unwrap();
            } else {
                assert!(frames::check(&frame).is_ok());
                classic.push(frame);
            }
        }
        assert_eq!(classic, sent, "as they were sent, in their order");
        let grid = reader.grid().unwrap();
        assert_eq!(u64::from(grid.sequence), round);
        assert!(grid.occupancy.iter().all(|cell| *cell == -1));
    }
    // What is taken right before the end leaves: the classic frames go first, the grid is cut where 0.2 s are over.
    let (message, sent) = publication(&mut encoder, 9);
    sink.publish(&message, &sent).unwrap();
    drop(sink);
    for wanted in &sent {
        assert_eq!(next(&mut monitor).as_ref(), Some(wanted));
    }
    let counts = devices.watch.counts();
    assert_eq!((counts.dropped_late, counts.allocations), (0, 0), "{counts:?}");
}

#[test]
fn a_sink_that_is_full_refuses_and_the_newest_wins() {
    let Some(name) = interface("a_sink_that_is_full_refuses") else {
        return;
    };
    let mut devices = can::open(plan(&name)).unwrap();
    let mut sink = devices.sink.take().unwrap();
    wait_for("opening", || devices.watch.counts().opened > 0);
    std::thread::sleep(Duration::from_millis(20));
    let mut encoder = CanEncoder::default();
    let (message, sent) = publication(&mut encoder, 1);
    let mut longest = Duration::ZERO;
    let mut taken = 0;
    for _ in 0..50 {
        let begin = Instant::now();
        taken += u64::from(sink.publish(&message, &sent).is_ok());
        longest = longest.max(begin.elapsed());
    }
    println!("longest publish {longest:?}, {taken} taken");
    let counts = devices.watch.counts();
    assert_eq!(counts.publications_refused, 50 - taken);
    drop(sink);
    let counts = devices.watch.counts();
    println!("{counts:?}");
    assert!(counts.dropped_for_newer > 0, "{counts:?}");
}

fn next(monitor: &mut CanMonitor) -> Option<CanFrame> {
    for _ in 0..100 {
        let Some(seen) = monitor.next_frame(Duration::from_millis(20)).unwrap() else {
            continue;
        };
        let mut frame = CanFrame {
            id: seen.id,
            extended: seen.is_extended,
            ..CanFrame::default()
        };
        frame.data.extend_from_slice(seen.data()).unwrap();
        return Some(frame);
    }
    None
}
