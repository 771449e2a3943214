//! The tape: pictures, wheel counts and network answers of a drive, in one file.
//!
//! A line of JSON says how many of each there are; then the pictures' bytes, and the answers as `f32`, little-endian.

use std::fs::File;
use std::io::{BufRead as _, BufReader, BufWriter, Error, Read as _, Write as _};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use freespace_platform::runtime::run_in_lockstep;
use freespace_platform::segmenter::{self, EngineChoice, Manifest};
use serde::{Deserialize, Serialize};

use super::recorded::Recording;
use crate::bench::{BenchError, Rig};
use crate::direct::{Again, Nobody, setup};
use crate::feed::Show;
use crate::road::picture_micros;

/// Its first line.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Head {
    width: usize,
    height: usize,
    rate_hz: f64,
    wheel_period_micros: u64,
    counts: Vec<[u32; 4]>,
    pictures: usize,
    answers: usize,
    answer_len: usize,
}

/// A tape in memory.
pub(super) struct Tape {
    head: Head,
    pictures: Vec<Vec<u8>>,
    pub(super) answers: Arc<Vec<Vec<f32>>>,
}

/// Drives in lockstep and writes the tape.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a drive of seconds"
)]
pub(super) fn record(rig: &Rig, path: &Path, seconds: f64, rate_hz: f64) -> Result<(), BenchError> {
    let mut road = rig.road(&[])?;
    road.rate_hz = rate_hz;
    let pictures = (seconds * rate_hz).ceil() as u64;
    let (config, ..) = rig.config()?;
    let words = |error: &dyn std::error::Error| BenchError::Config(error.to_string());
    let manifest = Manifest::load(&config.network.manifest).map_err(|error| words(&error))?;
    let inner = segmenter::open(&manifest, EngineChoice::Auto, config.network.threads)
        .map_err(|error| words(&error))?;
    let answers = Arc::new(Mutex::new(Vec::new()));
    let network = Recording {
        inner,
        answers: Arc::clone(&answers),
    };
    let stamps = (0..pictures)
        .map(|number| (picture_micros(number, rate_hz), number))
        .collect();
    let camera = Again::new(&road, stamps);
    // The network sees the picture alone: no wheels are needed.
    let setup = setup(rig, Box::new(camera), None, Box::new(network))?;
    run_in_lockstep(setup, &mut Nobody);
    let answers = answers.lock().unwrap_or_else(PoisonError::into_inner);
    let readings = (seconds * 1e6) as u64 / road.wheel_period_micros;
    let head = Head {
        width: road.camera.width,
        height: road.camera.height,
        rate_hz,
        wheel_period_micros: road.wheel_period_micros,
        counts: (0..readings).filter_map(|number| road.counts(number)).collect(),
        pictures: pictures as usize,
        answers: answers.len(),
        answer_len: answers.first().map_or(0, Vec::len),
    };
    let mut file = BufWriter::new(File::create(path)?);
    serde_json::to_writer(&mut file, &head).map_err(Error::other)?;
    file.write_all(b"\n")?;
    let mut show = road.show()?;
    let mut picture = Vec::new();
    for _ in 0..pictures {
        if !(show.picture)(&mut picture) {
            return Err(Error::other("the road ended").into());
        }
        file.write_all(&picture)?;
    }
    for value in answers.iter().flatten() {
        file.write_all(&value.to_le_bytes())?;
    }
    Ok(file.flush()?)
}

impl Tape {
    pub(super) fn load(path: &Path) -> Result<Self, BenchError> {
        let mut file = BufReader::new(File::open(path)?);
        let mut line = String::new();
        file.read_line(&mut line)?;
        let head: Head = serde_json::from_str(&line).map_err(Error::other)?;
        let mut pictures = Vec::new();
        for _ in 0..head.pictures {
            let mut picture = vec![0; 2 * head.width * head.height];
            file.read_exact(&mut picture)?;
            pictures.push(picture);
        }
        let mut answers = Vec::new();
        for _ in 0..head.answers {
            let mut bytes = vec![0; 4 * head.answer_len];
            file.read_exact(&mut bytes)?;
            let values = bytes
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            answers.push(values.collect());
        }
        Ok(Self {
            head,
            pictures,
            answers: Arc::new(answers),
        })
    }

    /// Seconds of the drive.
    #[expect(clippy::cast_precision_loss, reason = "a drive of seconds")]
    pub(super) fn seconds(&self) -> f64 {
        self.head.pictures as f64 / self.head.rate_hz
    }

    pub(super) fn rate_hz(&self) -> f64 {
        self.head.rate_hz
    }

    /// What is fed of it; ends with the tape.
    pub(super) fn show(self) -> Show {
        let mut pictures = self.pictures.into_iter();
        let mut counts = self.head.counts.into_iter();
        Show {
            width: self.head.width,
            height: self.head.height,
            rate_hz: self.head.rate_hz,
            wheel_period_micros: self.head.wheel_period_micros,
            picture: Box::new(move |picture| match pictures.next() {
                Some(next) => {
                    *picture = next;
                    true
                }
                None => false,
            }),
            counts: Box::new(move |_| counts.next()),
        }
    }
}
