//! A drive recorded in MCAP, checked and read.
//!
//! In: `NAME.mcap` with the parts that follow it, or a folder that holds `drive.mcap`. Out: frames ([`DriveFrames`]), wheel
//! readings ([`RecordedDrive::wheels`]), configuration, camera, and what each frame and key frame took. Invariant: opening reads
//! all of it once, by its checksums, so that a file of no use is refused before a run writes anything; a part that is cut off is
//! read up to its last whole chunk, and named. Cost: one pass over the files to open, one more to replay; memory for one frame,
//! and some 100 bytes a frame and reading.

mod port;
mod stream;
mod times;

pub use port::DriveFrames;
pub use stream::CutPart;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use freespace::frame::Camera;
use freespace::port::FrameBuffer;
use freespace::space::Micros;
use serde::de::DeserializeOwned;

use crate::bad_input::BadInput;
use crate::sink::mcap::{
    CONFIG, DRIVE, DriveNote, FrameNote, KeyFrameNote, LateWorkNote, Losses, Topic, VERSION, WantedNote,
    WheelNote, first_part, later_parts, part_path, picture,
};
use crate::wheels::RecordedReading;
use stream::{Found, Stream};

/// A frame's place in the drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FramePlace {
    /// Index in its source.
    pub index: u64,
    /// Capture stamp.
    pub stamp: Micros,
}

/// A recorded drive, all of it but the pixels.
#[derive(Debug)]
pub struct RecordedDrive {
    parts: Vec<PathBuf>,
    drive: DriveNote,
    camera: Camera,
    /// The configuration as it was written.
    pub config_text: String,
    /// Every frame, in the order in which the pipeline got them.
    pub frames: Vec<FramePlace>,
    wanted: BTreeSet<u64>,
    /// Wheel readings, in that order too.
    pub wheels: Vec<RecordedReading>,
    /// What *frame* and *track* made of each frame, by its index.
    pub frame_notes: BTreeMap<u64, FrameNote>,
    /// What left for each key frame that had a frame, by its index.
    pub key_frame_notes: BTreeMap<u64, KeyFrameNote>,
    /// Work on key frames that a fallback answered, by the index of the frame.
    pub late_work_notes: BTreeMap<u64, LateWorkNote>,
    /// What left for instants at which no frame came.
    pub frameless_notes: Vec<KeyFrameNote>,
    /// Parts that end before their end.
    pub cut: Vec<CutPart>,
    /// What it lacks; none of a recording that does not say.
    pub losses: Option<Losses>,
}

/// Whether a replay's source is a recorded drive.
#[must_use]
pub fn is_drive(source: &Path) -> bool {
    let first = first_part(source);
    first.is_file() || first == source
}

/// What a scan gathers.
#[derive(Default)]
struct Gathered {
    drive: Option<DriveNote>,
    config_text: Option<String>,
    frames: Vec<FramePlace>,
    wanted: BTreeSet<u64>,
    wheels: Vec<RecordedReading>,
    frame_notes: BTreeMap<u64, FrameNote>,
    key_frame_notes: BTreeMap<u64, KeyFrameNote>,
    late_work_notes: BTreeMap<u64, LateWorkNote>,
    frameless_notes: Vec<KeyFrameNote>,
    /// The first record, and the last.
    losses: Option<(Losses, Losses)>,
}

const AGAIN: &str = "give a file that freespace recorded with --mcap, or copy it again from its source";

impl RecordedDrive {
    /// Reads a recording through.
    ///
    /// # Errors
    /// No recording of this program, one without a whole frame, or frames of another size than its camera.
    pub fn open(source: &Path) -> Result<Self, BadInput> {
        let first = first_part(source);
        let parts = parts_from(&first)?;
        let mut stream = Stream::new(parts.clone());
        let mut gathered = Gathered::default();
        let mut frame = FrameBuffer::default();
        let mut size = None;
        while let Some(found) = stream.next() {
            gathered
                .take(&found, stream.data(), &mut frame)
                .map_err(|fault| BadInput::of_file(stream.path(), fault.what, fault.fix))?;
            if !frame.bytes.is_empty() {
                let this = (frame.width, frame.height);
                if *size.get_or_insert(this) != this {
                    return Err(BadInput::of_file(&first, "holds frames of several sizes", AGAIN));
                }
            }
        }
        let cut = stream.cut().to_vec();
        let fault = |what: &str| {
            let cause = cut
                .first()
                .map(|cut| format!(" ({})", cut.cause))
                .unwrap_or_default();
            BadInput::of_file(&first, format!("{what}{cause}"), AGAIN)
        };
        let drive = gathered.drive.ok_or_else(|| fault("is no recorded drive"))?;
        if drive.version != VERSION {
            return Err(fault(&format!(
                "was recorded in layout {}, not {VERSION}",
                drive.version
            )));
        }
        let camera = drive
            .camera()
            .ok_or_else(|| fault("does not say what its camera was"))?;
        let Some(size) = size else {
            return Err(fault("holds no whole frame"));
        };
        if size != (camera.width, camera.height) {
            return Err(fault("holds frames of another size than its camera's"));
        }
        Ok(Self {
            parts,
            drive,
            camera,
            config_text: gathered.config_text.unwrap_or_default(),
            frames: gathered.frames,
            wanted: gathered.wanted,
            wheels: gathered.wheels,
            frame_notes: gathered.frame_notes,
            key_frame_notes: gathered.key_frame_notes,
            late_work_notes: gathered.late_work_notes,
            frameless_notes: gathered.frameless_notes,
            cut,
            losses: gathered.losses.map(|(first, last)| last.since(&first)),
        })
    }

    /// Whether it holds all that its own times and answers are taken from.
    ///
    /// # Errors
    /// Notes that were dropped while it was recorded, or a part before the last that is cut off: what is left would be taken for
    /// the drive.
    pub fn check_notes(&self) -> Result<(), BadInput> {
        let last = self.parts.last();
        if let Some(hole) = self.cut.iter().find(|cut| Some(&cut.path) != last) {
            return Err(BadInput::of_file(
                &hole.path,
                format!(
                    "is cut off, and is not the last part ({}): the drive has a hole there",
                    hole.cause
                ),
                "replay it with --timing own, copy the part again, or move the parts after it elsewhere",
            ));
        }
        match (self.losses, self.parts.first()) {
            (Some(losses), Some(first)) if losses.has_lost_notes() => Err(BadInput::of_file(
                first,
                format!("while it was recorded {losses}, so its times and answers are not whole"),
                "replay it with --timing own, or record again to a disk that is faster and has room",
            )),
            _ => Ok(()),
        }
    }

    /// What was said of the drive when it began.
    #[must_use]
    pub const fn drive(&self) -> &DriveNote {
        &self.drive
    }

    /// The camera as it was calibrated then.
    #[must_use]
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Whether a frame of that index was left out by the drive: recorded, but displaced by a newer one before the pipeline took
    /// it. Of the last frames nobody knows.
    #[must_use]
    pub fn was_left_out(&self, index: u64) -> bool {
        let is_last = self
            .frame_notes
            .last_key_value()
            .is_none_or(|(last, _)| index > *last);
        !is_last && !self.frame_notes.contains_key(&index)
    }
}

fn parts_from(first: &Path) -> Result<Vec<PathBuf>, BadInput> {
    if !first.is_file() {
        return Err(BadInput::of_file(first, "is no file", AGAIN));
    }
    let later = later_parts(first);
    let last = later.last().copied().unwrap_or(0);
    if let Some(missing) = (1..last).find(|part| !later.contains(part)) {
        return Err(BadInput::of_file(
            &part_path(first, missing),
            format!("is missing, but part {last} of the drive is there"),
            "put it back; or move the parts after it elsewhere, to do without them",
        ));
    }
    Ok((0..=last).map(|part| part_path(first, part)).collect())
}

/// What is wrong with a part, and what to do.
struct PartFault {
    what: String,
    fix: &'static str,
}

impl From<String> for PartFault {
    fn from(what: String) -> Self {
        Self { what, fix: AGAIN }
    }
}

fn note<T: DeserializeOwned>(topic: Topic, data: &[u8]) -> Result<T, String> {
    serde_json::from_slice(data)
        .map_err(|error| format!("holds a damaged message of {}: {error}", topic.name()))
}

impl Gathered {
    /// Takes one thing found; of a picture the frame is left with its pixels.
    fn take(&mut self, found: &Found, data: &[u8], frame: &mut FrameBuffer) -> Result<(), PartFault> {
        match found {
            Found::Attachment(name) if name == DRIVE => {
                let drive: DriveNote = serde_json::from_slice(data)
                    .map_err(|error| format!("holds a damaged {DRIVE}: {error}"))?;
                // Every part says the same.
                if self.drive.get_or_insert(drive.clone()).id != drive.id {
                    return Err(PartFault {
                        what: "is a part of another drive than the files before it".to_owned(),
                        fix: "move it, and what follows it, to another folder or name",
                    });
                }
            }
            Found::Attachment(name) if name == CONFIG => {
                let text =
                    String::from_utf8(data.to_vec()).map_err(|_| format!("holds a damaged {CONFIG}"))?;
                self.config_text.get_or_insert(text);
            }
            Found::Attachment(_) => {}
            Found::Losses(losses) => {
                let first = self.losses.map_or(*losses, |(first, _)| first);
                self.losses = Some((first, *losses));
            }
            Found::Message {
                topic,
                sequence,
                at_micros,
            } => {
                let stamp = Micros(*at_micros);
                self.take_message(*topic, u64::from(*sequence), stamp, data, frame)?;
            }
        }
        Ok(())
    }

    fn take_message(
        &mut self,
        topic: Topic,
        index: u64,
        stamp: Micros,
        data: &[u8],
        frame: &mut FrameBuffer,
    ) -> Result<(), String> {
        match topic {
            Topic::Image => {
                picture::decode(data, index, stamp, frame)
                    .map_err(|fault| format!("frame {index} {fault}"))?;
                self.frames.push(FramePlace { index, stamp });
            }
            Topic::KeyFrameWanted => {
                let wanted: WantedNote = note(topic, data)?;
                self.wanted.insert(wanted.frame);
            }
            Topic::Wheels => {
                let wheel: WheelNote = note(topic, data)?;
                let reading = wheel.reading().ok_or("holds a wheel reading without a value")?;
                let until = Micros(wheel.until_micros);
                self.wheels.push(RecordedReading { until, reading });
            }
            Topic::Frame => {
                let frame: FrameNote = note(topic, data)?;
                self.frame_notes.insert(frame.frame, frame);
            }
            Topic::KeyFrame => {
                let key_frame: KeyFrameNote = note(topic, data)?;
                match key_frame.frame {
                    Some(frame) => drop(self.key_frame_notes.insert(frame, key_frame)),
                    None => self.frameless_notes.push(key_frame),
                }
            }
            Topic::LateWork => {
                let late: LateWorkNote = note(topic, data)?;
                self.late_work_notes.insert(late.frame, late);
            }
            Topic::Calibration
            | Topic::Transform
            | Topic::Grid
            | Topic::Landmarks
            | Topic::CanOut
            | Topic::Log => {}
        }
        Ok(())
    }
}
