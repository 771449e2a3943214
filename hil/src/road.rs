//! The simulated road as a camera and a car's brake controller would give it: YUYV pictures and wheel counters.
//!
//! In: the configuration that the module runs with, and a seed. Out: picture `n` at `n / rate` seconds and reading `n`, both
//! depending on their number alone. Pictures are rendered ahead on a thread of normal priority and wait in a short queue. A road
//! that was painted before is driven round and round: where its pictures end, the car is at its start again.

use std::fs::File;
use std::io::{Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use crate::feed::{Show, spawn};
use freespace::frame::{Camera, RgbImage};
use freespace::track::{WheelConfig, WheelReading};
use freespace_platform::world::{Encoders, Sensor, SimCamera, SimWheels, Slip, Textures, World, WorldConfig};

/// Pictures rendered ahead: a second and a half, while the module starts and wants the processor.
const AHEAD: usize = 45;
/// Above all normal work, under the module's own threads: a road that is late would be another road.
const PRIORITY: u8 = 5;

/// How long the map and the plane take after a new lap.
const NEW_LAP_S: f64 = 6.0;

/// What drives where.
#[derive(Clone)]
pub(crate) struct Road {
    pub(crate) world: Arc<World>,
    pub(crate) camera: Camera,
    pub(crate) rate_hz: f64,
    /// Its pictures, painted before the drive; painted while it goes on where there is no such file.
    pub(crate) tape: Option<PathBuf>,
    pub(crate) wheels: Arc<SimWheels>,
    /// Of a wheel's counter.
    modulus: u32,
    pub(crate) wheel_period_micros: u64,
}

impl Road {
    pub(crate) fn new(
        seed: u64,
        camera: &Camera,
        rate_hz: f64,
        odometer: &WheelConfig,
        slips: &[Slip],
    ) -> Self {
        let config = WorldConfig {
            seed,
            track_m: odometer.track_m,
            ..WorldConfig::default()
        };
        let encoders = Encoders {
            seed,
            metres_per_count: odometer.metres_per_count,
            modulus: odometer.modulus,
            jitter_micros: 0,
            slips: slips.to_vec(),
            ..Encoders::default()
        };
        Self {
            tape: None,
            world: Arc::new(World::new(&config, &Arc::new(Textures::new()))),
            camera: *camera,
            rate_hz,
            modulus: odometer.modulus,
            wheel_period_micros: encoders.period_micros,
            wheels: Arc::new(SimWheels::new(&encoders)),
        }
    }

    /// What is fed of it: rendered ahead, on a thread that ends when the show is dropped.
    pub(crate) fn show(&self) -> std::io::Result<Show> {
        // Pictures go round: to map and fault in half a megabyte for each of them costs more than to paint it.
        let (send, receive) = sync_channel::<Vec<u8>>(AHEAD);
        let (give_back, given_back) = sync_channel(AHEAD);
        let road = self.clone();
        spawn("road", PRIORITY, move || road.render(&send, &given_back))?;
        let road = self.clone();
        Ok(Show {
            width: self.camera.width,
            height: self.camera.height,
            rate_hz: self.rate_hz,
            wheel_period_micros: self.wheel_period_micros,
            picture: Box::new(move |picture| {
                let Ok(next) = receive.recv() else { return false };
                // One that finds no room is made anew.
                let _ = give_back.try_send(std::mem::replace(picture, next));
                true
            }),
            counts: Box::new(move |number| road.counts(number)),
        })
    }

    /// Wheel counts of reading `number`.
    pub(crate) fn counts(&self, number: u64) -> Option<[u32; 4]> {
        let Some(lap) = self.lap_micros().map(|micros| micros / self.wheel_period_micros) else {
            return self.first_lap(number);
        };
        let (of_lap, of_rest) = (self.first_lap(lap)?, self.first_lap(number % lap)?);
        let start = self.first_lap(0)?;
        let laps = u32::try_from(number / lap).ok()?;
        Some(core::array::from_fn(|wheel| {
            let of_lap = of_lap[wheel] + self.modulus - start[wheel];
            (of_rest[wheel] + of_lap % self.modulus * laps) % self.modulus
        }))
    }

    fn first_lap(&self, number: u64) -> Option<[u32; 4]> {
        match self.wheels.reading(&self.world, number) {
            WheelReading::Counts { counts, .. } => Some(counts),
            WheelReading::Speeds { .. } => None,
        }
    }

    /// Length of a lap; none where the road has no end.
    fn lap_micros(&self) -> Option<u64> {
        let picture_bytes = 2 * self.camera.width as u64 * self.camera.height as u64;
        let bytes = std::fs::metadata(self.tape.as_ref()?).ok()?.len();
        Some(picture_micros(bytes / picture_bytes, self.rate_hz))
    }

    /// Whether the car was put to the start of the road a moment ago: what was mapped before is elsewhere.
    pub(crate) fn is_lap_new(&self, drive_s: f64) -> bool {
        drive_s > NEW_LAP_S && self.world_seconds(drive_s) < NEW_LAP_S
    }

    /// Seconds of the world at this instant of the drive.
    #[expect(clippy::cast_precision_loss, reason = "a drive of minutes")]
    pub(crate) fn world_seconds(&self, drive_s: f64) -> f64 {
        self.lap_micros()
            .map_or(drive_s, |lap| drive_s % (lap as f64 * 1e-6))
    }

    /// Seconds of the world at picture `number`.
    #[expect(clippy::cast_precision_loss, reason = "a drive of minutes")]
    pub(crate) fn picture_seconds(&self, number: u64) -> f64 {
        picture_micros(number, self.rate_hz) as f64 * 1e-6
    }

    /// Paints the pictures of a drive into a file.
    pub(crate) fn paint(&self, seconds: f64, path: &Path) -> std::io::Result<()> {
        let mut camera = SimCamera::new(&self.camera, &Sensor::default());
        let mut picture = RgbImage::new(self.camera.width, self.camera.height);
        let mut bytes = Vec::new();
        let unfinished = path.with_extension("unfinished");
        let mut file = File::create(&unfinished)?;
        let mut number = 0;
        while self.picture_seconds(number) < seconds {
            camera.render(&self.world, self.picture_seconds(number), &mut picture);
            yuyv(picture.pixels(), &mut bytes);
            file.write_all(&bytes)?;
            number += 1;
        }
        // Or the disk would be busy with it while guests read it.
        file.sync_all()?;
        std::fs::rename(unfinished, path)
    }

    fn render(&self, send: &SyncSender<Vec<u8>>, given_back: &Receiver<Vec<u8>>) {
        let mut camera = SimCamera::new(&self.camera, &Sensor::default());
        let mut picture = RgbImage::new(self.camera.width, self.camera.height);
        let mut tape = self.tape.as_ref().and_then(|path| File::open(path).ok());
        for number in 0.. {
            let mut bytes = given_back.try_recv().unwrap_or_default();
            bytes.resize(2 * self.camera.width * self.camera.height, 0);
            let is_read = (tape.as_mut()).is_some_and(|tape| {
                next_of(tape, &mut bytes) || (tape.rewind().is_ok() && next_of(tape, &mut bytes))
            });
            if !is_read {
                tape = None;
                camera.render(&self.world, self.picture_seconds(number), &mut picture);
                yuyv(picture.pixels(), &mut bytes);
            }
            if send.send(bytes).is_err() {
                return;
            }
        }
    }
}

/// When picture `number` is taken, microseconds after the start of the drive.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a drive of minutes"
)]
pub(crate) fn picture_micros(number: u64, rate_hz: f64) -> u64 {
    (number as f64 / rate_hz * 1e6).round() as u64
}

/// Reads the next picture, and lets the kernel forget it: a drive would fill the memory of a small guest.
fn next_of(tape: &mut File, bytes: &mut [u8]) -> bool {
    if tape.read_exact(bytes).is_err() {
        return false;
    }
    // What is not forgotten is reclaimed later, at a worse time.
    let _ = rustix::fs::fadvise(&*tape, 0, None, rustix::fs::Advice::DontNeed);
    true
}

/// A black picture.
pub(crate) fn black(width: usize, height: usize) -> Vec<u8> {
    [16, 128].repeat(width * height)
}

/// RGB to YUYV, ITU-R BT.601 in limited range; two pixels share the mean of their chroma.
pub(crate) fn yuyv(rgb: &[u8], out: &mut Vec<u8>) {
    out.resize(rgb.len() / 3 * 2, 0);
    for (four, pair) in out.chunks_exact_mut(4).zip(rgb.chunks_exact(6)) {
        let [a, b] = [&pair[..3], &pair[3..]].map(|p| [p[0], p[1], p[2]].map(i32::from));
        let mean = [0, 1, 2].map(|c| (a[c] + b[c] + 1) / 2);
        four.copy_from_slice(&[luma(a), chroma_blue(mean), luma(b), chroma_red(mean)]);
    }
}

fn luma([r, g, b]: [i32; 3]) -> u8 {
    byte(((66 * r + 129 * g + 25 * b + 128) >> 8) + 16)
}

fn chroma_blue([r, g, b]: [i32; 3]) -> u8 {
    byte(((-38 * r - 74 * g + 112 * b + 128) >> 8) + 128)
}

fn chroma_red([r, g, b]: [i32; 3]) -> u8 {
    byte(((112 * r - 94 * g - 18 * b + 128) >> 8) + 128)
}

fn byte(value: i32) -> u8 {
    u8::try_from(value.clamp(0, 255)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use freespace::frame::{PixelFormat, RawFrame, RgbImage};
    use freespace::space::Micros;

    use super::yuyv;

    /// The module must see the colours that were rendered: within rounding and the chroma of two pixels.
    #[test]
    fn a_picture_survives_its_way_through_yuyv() {
        let rgb: Vec<u8> = (0..64_u8)
            .flat_map(|i| [i * 3, 255 - i * 2, 60 + i, i * 3, 255 - i * 2, 60 + i])
            .collect();
        let mut bytes = Vec::new();
        yuyv(&rgb, &mut bytes);
        let mut back = RgbImage::new(128, 1);
        let raw = RawFrame {
            stamp: Micros(0),
            format: PixelFormat::Yuyv,
            width: 128,
            height: 1,
            bytes: &bytes,
        };
        raw.rgb_into(&mut back).unwrap();
        for (sent, seen) in rgb.iter().zip(back.pixels()) {
            assert!(sent.abs_diff(*seen) <= 4, "{sent} became {seen}");
        }
    }
}
