//! A wheel message, and another socket on the bus.

use std::path::Path;
use std::time::Duration;

use freespace::emit::{BitRates, CanEncoder, CanFrame, FreeSpaceMessage, Header, Publication};
use freespace::grid::Grid;
use freespace_platform::can::{CanPlan, CanWheelsPlan};
use freespace_platform::config::CanOut;
use freespace_platform::runtime::rights::RealTimeConfig;
use freespace_platform::wheels::{WheelDecoder, WheelMapping};

pub(crate) const ROWS: usize = 200;
pub(crate) const COLUMNS: usize = 120;

const DBC: &str = "VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: ABS\n\nBO_ 903 PULSES: 6 ABS\n \
    SG_ FL : 0|8@1+ (1,0) [0|0] \"\" ABS\n SG_ FR : 8|8@1+ (1,0) [0|0] \"\" ABS\n \
    SG_ RL : 16|8@1+ (1,0) [0|0] \"\" ABS\n SG_ RR : 24|8@1+ (1,0) [0|0] \"\" ABS\n \
    SG_ ALIVE : 32|4@1+ (1,0) [0|14] \"\" ABS\n SG_ SUM : 40|8@1+ (1,0) [0|0] \"\" ABS\n";

pub(crate) fn decoder() -> WheelDecoder {
    let text = "message = \"PULSES\"\nkind = \"counts\"\nsignals = [\"FL\", \"FR\", \"RL\", \"RR\"]\n\
        counter = \"ALIVE\"\nchecksum = { signal = \"SUM\", algorithm = \"crc8_sae_j1850\" }";
    let mapping: WheelMapping = toml::from_str(text).unwrap();
    WheelDecoder::new(Path::new("car.dbc"), DBC, &mapping).unwrap()
}

/// The bytes of wheel message `number`.
pub(crate) fn wheel_bytes(number: u64) -> [u8; 6] {
    let [count, ..] = number.to_le_bytes();
    let [alive, ..] = (number % 15).to_le_bytes();
    let mut bytes = [count, count, count, count, alive, 0];
    bytes[5] = freespace::emit::crc::crc8(0xFF, &bytes[..5]) ^ 0xFF;
    bytes
}

/// A message and its classic frames.
pub(crate) fn publication(encoder: &mut CanEncoder, sequence: u64) -> (Vec<u8>, Vec<CanFrame>) {
    let grid = Grid::new(ROWS, COLUMNS, 0.2);
    let header = Header {
        sequence,
        ..Header::default()
    };
    let mut bytes = vec![0; FreeSpaceMessage::encoded_len(ROWS * COLUMNS)];
    Publication { header, grid: &grid }
        .encode_into(&mut bytes)
        .unwrap();
    (bytes, encoder.encode(&header).to_vec())
}

/// The interface to test on; skips by name without one.
pub(crate) fn interface(test: &str) -> Option<String> {
    let name = std::env::var("FREESPACE_TEST_CAN").ok();
    if name.is_none() {
        eprintln!("SKIPPED: {test}: no CAN interface; set FREESPACE_TEST_CAN=vcan0");
    }
    name
}

/// Both sides on one interface, the grid too.
pub(crate) fn plan(interface: &str) -> CanPlan {
    CanPlan {
        wheels: Some(CanWheelsPlan {
            interface: interface.to_owned(),
            decoder: decoder(),
            offset_micros: 0,
        }),
        out: Some(CanOut {
            interface: Some(interface.to_owned()),
            fd: true,
            grid_frames: freespace::emit::grid_frames::frames_of(ROWS * COLUMNS),
            rates: BitRates {
                nominal: 500_000,
                data: 2_000_000,
            },
            share: 0.5,
            period_micros: 500_000,
        }),
        fd: true,
        real_time: RealTimeConfig::default(),
    }
}

/// Waits, bounded, for something to become true.
pub(crate) fn wait_for(what: &str, mut is_true: impl FnMut() -> bool) {
    for _ in 0..2_000 {
        if is_true() {
            return;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("{what} did not happen in 10 s");
}
