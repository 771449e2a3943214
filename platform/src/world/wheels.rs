//! The simulated wheel encoders: counters as a car's brake controller sends them.
//!
//! In: a [`World`] and a time. Out: [`WheelReading::Counts`] at a fixed rate: quantised, wrapping, with an error of each
//! wheel's radius and, where asked for, slip. Invariant: a reading depends on its number only, never on earlier calls.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "counts are small and non-negative"
)]

use freespace::space::Micros;
use freespace::track::WheelReading;

use super::World;
use super::noise::Seeded;

/// A time during which all wheels turn faster than the car moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Start in seconds.
    pub from_s: f64,
    /// End in seconds.
    pub to_s: f64,
    /// Extra turning as a share of the speed; negative while locked in braking.
    pub share: f64,
}

/// How the encoders count.
#[derive(Clone, Debug, PartialEq)]
pub struct Encoders {
    /// Seed of the radius errors and the stamps' jitter.
    pub seed: u64,
    /// Metres a raw count.
    pub metres_per_count: f64,
    /// Counter modulus.
    pub modulus: u32,
    /// Time between readings.
    pub period_micros: u64,
    /// Largest jitter of a stamp.
    pub jitter_micros: u64,
    /// Largest error of a wheel's radius, as a share.
    pub radius_error: f64,
    /// Slips, in order of time and apart from each other.
    pub slips: Vec<Slip>,
}

impl Default for Encoders {
    fn default() -> Self {
        Self {
            seed: 1,
            metres_per_count: 0.020_312_5,
            modulus: 256,
            period_micros: 20_000,
            jitter_micros: 300,
            radius_error: 0.002,
            slips: Vec::new(),
        }
    }
}

/// The encoders of a car that drives through a world.
#[derive(Clone, Debug)]
pub struct SimWheels {
    encoders: Encoders,
    radius: [f64; 4],
    start: [f64; 4],
    next: u64,
}

impl SimWheels {
    /// Draws the radius errors and where the counters start.
    #[must_use]
    pub fn new(encoders: &Encoders) -> Self {
        let mut random = Seeded::new(encoders.seed, 8);
        let radius = [0; 4].map(|_| 1.0 + encoders.radius_error * f64::from(random.range(-1.0, 1.0)));
        let start = [0; 4].map(|_| f64::from(random.range(0.0, encoders.modulus as f32)));
        Self {
            encoders: encoders.clone(),
            radius,
            start,
            next: 0,
        }
    }

    /// The readings not taken yet with stamps up to `seconds`, oldest first.
    pub fn readings(&mut self, world: &World, seconds: f64) -> impl Iterator<Item = WheelReading> {
        let mut readings = Vec::new();
        while self.next as f64 * self.encoders.period_micros as f64 * 1e-6 <= seconds {
            readings.push(self.reading(world, self.next));
            self.next += 1;
        }
        readings.into_iter()
    }

    /// Reading number `number`.
    #[must_use]
    pub fn reading(&self, world: &World, number: u64) -> WheelReading {
        let micros = number * self.encoders.period_micros;
        let seconds = micros as f64 * 1e-6;
        let ego = world.ego(seconds);
        let slipped = self.slipped_m(world, seconds);
        let mut counts = [0; 4];
        for (k, count) in counts.iter_mut().enumerate() {
            let rolled = (ego.wheel_m[k] + slipped) * self.radius[k];
            let total = (self.start[k] + rolled / self.encoders.metres_per_count).floor();
            *count = total.rem_euclid(f64::from(self.encoders.modulus)) as u32;
        }
        let jitter = Seeded::new(self.encoders.seed ^ number, 9).range(0.0, 1.0);
        WheelReading::Counts {
            stamp: Micros(micros + (f64::from(jitter) * self.encoders.jitter_micros as f64) as u64),
            counts,
            direction: [i8::from(ego.speed_mps > 1e-3); 4],
        }
    }

    /// How much farther than the car the wheels have turned.
    fn slipped_m(&self, world: &World, seconds: f64) -> f64 {
        let during = |slip: &Slip| {
            let to = seconds.min(slip.to_s);
            let run = world.ego(to).distance_m - world.ego(slip.from_s).distance_m;
            if to > slip.from_s { slip.share * run } else { 0.0 }
        };
        self.encoders.slips.iter().map(during).sum()
    }
}
