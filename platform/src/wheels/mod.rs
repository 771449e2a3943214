//! The wheel encoders behind one small port: readings in the order of their stamps.
//!
//! In: CAN frames, from a log here. Out: [`WheelReading`]s, front left, front right, rear left, rear right.
//! Which message and signals they come from is a [`WheelMapping`] over a DBC file; [`dbc`] makes a decoder of it.

pub mod candump;
pub mod candump_line;
pub mod dbc;

pub use candump::{CandumpError, CandumpOptions, CandumpWheels};
pub use dbc::{DecodeFault, MappingError, WheelDecoder, WheelMapping};

use freespace::space::Micros;
use freespace::track::WheelReading;

/// A source of wheel readings.
pub trait WheelSource: Send {
    /// Hands over every reading not yet handed over whose stamp is at most `until`, stamps never falling.
    fn readings_until(&mut self, until: Micros, out: &mut dyn FnMut(WheelReading));
}
