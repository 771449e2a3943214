//! The wheel encoders behind one small port: readings in the order of their stamps.
//!
//! In: CAN frames, from a log or an interface. Out: [`WheelReading`](freespace::track::WheelReading)s, front left, front right, rear left, rear right.
//! Which message and signals they come from is a [`WheelMapping`] over a DBC file; [`dbc`] makes a decoder of it.

pub mod candump;
pub mod candump_line;
pub mod dbc;
pub mod integrity;
mod recorded;
pub(crate) mod signal;
mod sim;
mod socketcan;

pub use candump::{CandumpError, CandumpOptions, CandumpWheels};
pub use dbc::{DecodeFault, MappingError, WheelDecoder, WheelMapping};
pub use integrity::{ChecksumAlgorithm, ChecksumMapping};
pub use recorded::{RecordedReading, RecordedWheels};
pub use sim::SimEncoders;
pub use socketcan::SocketcanWheels;
