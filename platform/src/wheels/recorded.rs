//! The wheel readings of a recorded drive.
//!
//! Invariant: the pipeline gets each reading when the drive's did: when it asks for readings as late as it asked then.

use freespace::port::WheelPort;
use freespace::space::Micros;
use freespace::track::WheelReading;

/// A reading, and when it was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedReading {
    /// Readings until then were asked for when this one was given.
    pub until: Micros,
    /// The reading.
    pub reading: WheelReading,
}

/// Readings in the order in which they were taken.
#[derive(Clone, Debug)]
pub struct RecordedWheels {
    readings: Vec<RecordedReading>,
    next: usize,
}

impl RecordedWheels {
    /// All of `readings`.
    #[must_use]
    pub const fn new(readings: Vec<RecordedReading>) -> Self {
        Self { readings, next: 0 }
    }
}

impl WheelPort for RecordedWheels {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        while let Some(recorded) = self.readings.get(self.next).filter(|next| next.until <= until) {
            take(recorded.reading);
            self.next += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reading_that_came_late_comes_late_again() {
        let reading = |stamp| WheelReading::Speeds {
            stamp: Micros(stamp),
            mps: [1.0; 4],
        };
        // The second one arrived only when readings until 60 were asked for.
        let recorded = [(40, 10), (60, 20), (60, 50)].map(|(until, stamp)| RecordedReading {
            until: Micros(until),
            reading: reading(stamp),
        });
        let mut wheels = RecordedWheels::new(recorded.to_vec());
        let mut taken = |until| {
            let mut stamps = Vec::new();
            wheels.readings_until(Micros(until), &mut |reading| stamps.push(reading.stamp().0));
            stamps
        };
        assert_eq!(taken(40), [10]);
        assert_eq!(taken(59), [0; 0]);
        assert_eq!(taken(80), [20, 50]);
    }
}
