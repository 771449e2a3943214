//! The wheel encoders of the simulated car.

use std::sync::Arc;

use freespace::port::WheelPort;
use freespace::space::Micros;
use freespace::track::WheelReading;

use crate::world::{Encoders, SimWheels, World};

/// Readings made when they are asked for; nothing is allocated then.
pub struct SimEncoders {
    world: Arc<World>,
    wheels: SimWheels,
    next: u64,
    waiting: WheelReading,
}

impl SimEncoders {
    /// The encoders of the car that drives through `world`.
    #[must_use]
    pub fn new(world: Arc<World>, encoders: &Encoders) -> Self {
        let wheels = SimWheels::new(encoders);
        let waiting = wheels.reading(&world, 0);
        Self {
            world,
            wheels,
            next: 1,
            waiting,
        }
    }
}

impl WheelPort for SimEncoders {
    fn readings_until(&mut self, until: Micros, take: &mut dyn FnMut(WheelReading)) {
        while self.waiting.stamp() <= until {
            take(self.waiting);
            self.waiting = self.wheels.reading(&self.world, self.next);
            self.next += 1;
        }
    }
}
