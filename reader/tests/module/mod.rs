//! A module that publishes, without the camera and the road.

#![allow(dead_code, reason = "each test uses its part")]

use freespace::emit::{FreeSpaceMessage, Header, Publication};
use freespace::grid::Grid;
use freespace::health::QualityLevel;
use freespace::port::{SinkMiss, SinkPort as _};
use freespace_platform::runtime::rights::RealTimeConfig;
use freespace_platform::sink::shared_memory::{SharedMemorySink, SharingConfig, SharingError};
use freespace_reader::monotonic_now;

pub(crate) const ROWS: usize = 200;
pub(crate) const COLUMNS: usize = 100;

/// Where a message's publish stamp stands.
const PUBLISH: std::ops::Range<usize> = 32..40;
/// Where its sequence stands.
const SEQUENCE: std::ops::Range<usize> = 16..24;

pub(crate) struct Module {
    sink: SharedMemorySink,
    message: Vec<u8>,
    pub(crate) sequence: u64,
    /// Messages that the sink refused.
    pub(crate) refused: u64,
}

/// A name that no other test and no other run uses.
pub(crate) fn name(test: &str) -> String {
    format!("freespace/test/{test}/{}", std::process::id())
}

impl Module {
    pub(crate) fn open(name: &str, max_readers: usize) -> Result<Self, SharingError> {
        let config = SharingConfig {
            name: name.to_owned(),
            max_readers,
        };
        let bytes = FreeSpaceMessage::encoded_len(ROWS * COLUMNS);
        let opened = SharedMemorySink::open(&config, bytes, &RealTimeConfig::default())?;
        let mut grid = Grid::new(ROWS, COLUMNS, 0.2);
        grid.occupancy[..ROWS * COLUMNS / 2].fill(0);
        let header = Header {
            level: QualityLevel::Full,
            sector_first_rad: -0.8,
            sector_rad: 0.05,
            free_m: [17.5; 32],
            used_micros: 40_000,
            ..Header::default()
        };
        let mut message = vec![0; bytes];
        let encoded = Publication { header, grid: &grid }.encode_into(&mut message);
        assert_eq!(encoded, Ok(bytes));
        Ok(Self {
            sink: opened.sink,
            message,
            sequence: 0,
            refused: 0,
        })
    }

    /// What the publisher says before it makes a message.
    pub(crate) fn prepare(&mut self) {
        self.sink.prepare();
    }

    /// Publishes, stamped with this instant; the check sum is of no use in shared memory, and left as it is.
    pub(crate) fn publish(&mut self) -> Result<(), SinkMiss> {
        self.message[SEQUENCE].copy_from_slice(&self.sequence.to_le_bytes());
        self.message[PUBLISH].copy_from_slice(&monotonic_now().0.to_le_bytes());
        self.sequence += 1;
        let published = self.sink.publish(&self.message, &[]);
        self.refused += u64::from(published.is_err());
        published
    }
}
