#![allow(clippy::unwrap_used, reason = "tests")]

use std::os::unix::fs::PermissionsExt as _;
use std::time::Duration;

use freespace::emit::{FreeSpaceMessage, Header, Publication};
use freespace::grid::Grid;
use freespace_reader::{Reader, ReaderError};

use super::*;

const WAIT: Duration = Duration::from_secs(20);

/// A name that no other test and no other run uses.
fn config(test: &str) -> SharingConfig {
    SharingConfig {
        name: format!("freespace/test/{test}/{}", std::process::id()),
        max_readers: 2,
    }
}

fn message(sequence: u64) -> Vec<u8> {
    let grid = Grid::new(20, 10, 0.2);
    let header = Header {
        sequence,
        ..Header::default()
    };
    let mut bytes = vec![0; FreeSpaceMessage::encoded_len(200)];
    Publication { header, grid: &grid }
        .encode_into(&mut bytes)
        .unwrap();
    bytes
}

fn open(config: &SharingConfig) -> Result<SharedMemorySink, SharingError> {
    let bytes = FreeSpaceMessage::encoded_len(200);
    SharedMemorySink::open(config, bytes, &RealTimeConfig::default()).map(|opened| opened.sink)
}

#[test]
fn a_reader_gets_the_last_message_at_once_and_then_each_new_one() {
    let config = config("each");
    assert_eq!(Reader::open(&config.name).err(), Some(ReaderError::NoModule));
    let mut sink = open(&config).unwrap();
    sink.publish(&message(7), &[]).unwrap();
    let mut reader = Reader::open(&config.name).unwrap();
    // Connected by the next message at the latest, which the last one precedes.
    for sequence in 8..12 {
        sink.publish(&message(sequence), &[]).unwrap();
        loop {
            let read = reader.next(WAIT).unwrap().unwrap();
            assert_eq!((read.rows, read.columns, read.cells()), (20, 10, 200));
            if read.sequence == sequence {
                break;
            }
            assert!(read.sequence < sequence);
        }
    }
    assert!(reader.next(Duration::ZERO).unwrap().is_none());
}

#[test]
fn a_name_has_one_module_and_as_many_readers_as_it_says() {
    let config = config("one");
    let sink = open(&config).unwrap();
    assert_eq!(open(&config).err(), Some(SharingError::Taken));
    let readers = [(); 2].map(|()| Reader::open(&config.name).unwrap());
    assert_eq!(
        Reader::open(&config.name).err(),
        Some(ReaderError::TooManyReaders)
    );
    drop(readers);
    Reader::open(&config.name).unwrap();
    drop(sink);
    open(&config).unwrap();
}

#[test]
fn a_message_that_is_too_long_or_none_is_refused_and_the_next_one_is_not() {
    let config = config("refused");
    let mut sink = open(&config).unwrap();
    let too_long = vec![0; FreeSpaceMessage::encoded_len(200) + 1];
    assert_eq!(sink.publish(&too_long, &[]), Err(SinkMiss::Refused));
    // What is wrong with the bytes is found by the sharing thread, and told with a later message.
    let refused = (0..1000).any(|_| {
        std::thread::sleep(Duration::from_millis(1));
        sink.publish(&[0; 8], &[]).is_err()
    });
    assert!(refused);
    let mut reader = Reader::open(&config.name).unwrap();
    let _ = sink.publish(&message(3), &[]);
    assert_eq!(reader.next(WAIT).unwrap().unwrap().sequence, 3);
}

#[test]
fn a_service_that_was_never_finished_is_made_anew() {
    let config = config("half_made");
    let sink = open(&config).unwrap();
    let services = std::fs::read_dir(format!("{}/services", service::FOLDER)).unwrap();
    let own: Vec<_> = services
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            let text = std::fs::read(path).unwrap_or_default();
            (text.windows(config.name.len())).any(|some| some == config.name.as_bytes())
        })
        .collect();
    // The messages, and their event.
    assert_eq!(own.len(), 2);
    drop(sink);
    for half_made in own {
        std::fs::write(&half_made, "").unwrap();
        std::fs::set_permissions(&half_made, std::fs::Permissions::from_mode(0o600)).unwrap();
    }
    let mut sink = open(&config).unwrap();
    sink.publish(&message(1), &[]).unwrap();
    Reader::open(&config.name).unwrap();
}
