//! Wheel readings of a live CAN interface.
//!
//! In: readings that the CAN thread decoded, through a bounded ring. Out: each once, in the order of its stamps, up to the asked
//! stamp. Invariant: never waits. Cost: constant for a reading. Full: the CAN thread drops the newest and counts it.

use freespace::port::WheelPort;
use freespace::space::Micros;
use freespace::track::WheelReading;
use rtrb::Consumer;

use crate::can::Ends;

/// The reader's end.
pub struct SocketcanWheels {
    readings: Consumer<WheelReading>,
    _ends: Ends,
}

impl SocketcanWheels {
    pub(crate) const fn new(readings: Consumer<WheelReading>, ends: Ends) -> Self {
        Self {
            readings,
            _ends: ends,
        }
    }
}

impl WheelPort for SocketcanWheels {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        // No more than waited at the call: the CAN thread goes on meanwhile.
        for _ in 0..self.readings.slots() {
            let is_due = self.readings.peek().is_ok_and(|reading| reading.stamp() <= until);
            match is_due.then(|| self.readings.pop()) {
                Some(Ok(reading)) => take(reading),
                _ => return,
            }
        }
    }
}
