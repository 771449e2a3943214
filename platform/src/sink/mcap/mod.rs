//! A drive in MCAP: every frame, wheel reading and answer, for a replay and for Foxglove's viewer.
//!
//! In: taps on the camera's and the encoders' ports, and an observer. Out: [`parts`](self)-wise files, see [`part_path`].
//! Invariant: recording never holds up the drive. Real-time threads copy into buffers made before the start; all that encodes,
//! compresses and writes is a thread of its own, without priority. Full queues lose the newest, counted; a full disk is told, and
//! the drive goes on. Cost: `FRAMES_WAITING` frame buffers, one copy a frame on the camera's thread, and about a tenth of a
//! core for 28 MB/s.

mod cloud;
mod format;
mod losses;
mod note;
mod observer;
mod parts;
pub(crate) mod picture;
mod preamble;
mod tap;
mod thread;

pub use format::{
    CanFrameNote, CanNote, FrameNote, KeyFrameNote, LateWorkNote, Topic, WantedNote, WheelNote,
};
pub use losses::Losses;
pub use observer::Noted;
pub use parts::{FLUSH_EVERY, Medium, OpenPart, RETRY_EVERY, Split, later_part_of, later_parts, part_path};
pub use preamble::{CONFIG, DRIVE, DriveNote, VERSION};
pub use tap::{CameraTap, WheelTap};

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, sync_channel};
use std::thread::JoinHandle;

use freespace::pipeline::PipelineConfig;
use freespace::port::{CameraPort, FrameBuffer, WheelPort};
use rtrb::{Consumer, Producer, RingBuffer};

use crate::bad_input::BadInput;
use crate::eval::grid::GridLayout;
use crate::runtime::Observer;
use observer::NoteTaker;
use parts::{Counters, Head, Parts};
use tap::TakenReading;
use thread::RecorderThread;

/// Frames that wait for the recorder: half a second's, for a disk that takes its time.
const FRAMES_WAITING: usize = 16;
/// Wheel readings that wait: some seconds' at any usual rate.
const READINGS_WAITING: usize = 1024;
/// Messages of the observer that wait: a few seconds' at 30 frames a second.
const NOTES_WAITING: usize = 512;

/// What is to be recorded, and where.
pub struct RecordingPlan<'a> {
    /// File, ending in `.mcap`, or folder; then `drive.mcap` in it.
    pub path: &'a Path,
    /// When the next part begins.
    pub split: Split,
    /// The pipeline of the drive.
    pub pipeline: &'a PipelineConfig,
    /// Where the cells of its grid lie.
    pub layout: GridLayout,
    /// Where its configuration lies.
    pub config_path: &'a Path,
    /// The configuration as it was written.
    pub config_text: String,
}

/// What a recording came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecordingCounts {
    /// Frames written.
    pub frames: u64,
    /// Bytes written, all parts together.
    pub written_bytes: u64,
    /// Frames that found no buffer free: the disk was too slow.
    pub dropped_frames: u64,
    /// Other messages that found a queue full, on their way to the observer or from it.
    pub dropped_messages: u64,
    /// Messages that the disk refused.
    pub lost_messages: u64,
}

impl RecordingCounts {
    /// What is not in it.
    #[must_use]
    pub const fn losses(&self) -> Losses {
        Losses {
            dropped_frames: self.dropped_frames,
            dropped_messages: self.dropped_messages,
            lost_messages: self.lost_messages,
        }
    }
}

/// The counts of a recording, as they grow.
#[derive(Clone, Debug)]
pub struct RecordingMeter(Arc<Counters>);

impl RecordingMeter {
    /// Counts so far.
    #[must_use]
    pub fn counts(&self) -> RecordingCounts {
        let counters = &self.0;
        RecordingCounts {
            frames: counters.frames.load(Ordering::Relaxed),
            written_bytes: counters.written_bytes.load(Ordering::Relaxed),
            dropped_frames: counters.dropped_frames.load(Ordering::Relaxed),
            dropped_messages: counters.dropped_messages.load(Ordering::Relaxed),
            lost_messages: counters.lost_messages.load(Ordering::Relaxed),
        }
    }
}

/// The first file of a recording at `path`: itself, or `drive.mcap` where it is a folder.
#[must_use]
pub fn first_part(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|extension| extension == "mcap") {
        path.to_owned()
    } else {
        path.join("drive.mcap")
    }
}

/// Where a tap takes free buffers from, and where it puts frames.
type FrameRings = (Consumer<Box<FrameBuffer>>, Producer<Box<FrameBuffer>>);

/// A drive being recorded.
pub struct DriveRecorder {
    first: PathBuf,
    taker: NoteTaker,
    lines: Option<Receiver<String>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    frames: Option<FrameRings>,
    wheels: Option<Producer<TakenReading>>,
}

impl DriveRecorder {
    /// Makes the file, the buffers and the thread.
    ///
    /// # Errors
    /// A file that is there already or cannot be written, or a thread that could not be started.
    pub fn open(plan: RecordingPlan<'_>) -> Result<Self, BadInput> {
        let first = first_part(plan.path);
        if let Some(folder) = first.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(|error| cannot_be_written(folder, &error))?;
        }
        // Any part: the parts of two drives under one name would be read as one.
        if let Some(path) = parts::earlier_part(&first) {
            return Err(BadInput::of_file(
                &path,
                "holds an earlier recording, which is not written over",
                "give another file or folder with --mcap, or move that one away",
            ));
        }
        Self::open_with(plan, parts::open_file())
    }

    /// The same on other media than files.
    ///
    /// # Errors
    /// See [`DriveRecorder::open`].
    pub fn open_with(plan: RecordingPlan<'_>, open: OpenPart) -> Result<Self, BadInput> {
        let first = first_part(plan.path);
        let counters = Arc::new(Counters::default());
        let head = Head {
            // A plain structure cannot fail.
            drive: serde_json::to_vec(&DriveNote::new(plan.pipeline, plan.config_path)).unwrap_or_default(),
            config: plan.config_text,
            standing: preamble::standing_notes(&plan.pipeline.camera),
        };
        let (lines_to, lines) = mpsc::channel();
        // Nobody listens any more at the very end.
        let tell = Box::new(move |line| drop(lines_to.send(line)));
        let parts = Parts::begin(&first, plan.split, head, open, &counters, tell)
            .map_err(|error| cannot_be_written(&first, &error))?;
        let camera = plan.pipeline.camera;
        let largest = camera.width * camera.height * 3;
        let (taken_to, taken) = RingBuffer::new(FRAMES_WAITING);
        let (mut returned, free) = RingBuffer::new(FRAMES_WAITING);
        for _ in 0..FRAMES_WAITING {
            // There is room for all of them.
            let _ = returned.push(Box::new(FrameBuffer {
                // Written to, so that the memory is there before the drive.
                bytes: vec![1; largest],
                ..FrameBuffer::default()
            }));
        }
        let (wheels_to, wheels) = RingBuffer::new(READINGS_WAITING);
        let (notes_to, notes) = sync_channel(NOTES_WAITING);
        let is_over = Arc::new(AtomicBool::new(false));
        let thread = RecorderThread {
            parts,
            frames: taken,
            returned,
            wheels,
            notes,
            is_over: Arc::clone(&is_over),
            message: Vec::with_capacity(largest + 256),
        };
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || thread.run())
            .map_err(|error| {
                BadInput::new(
                    format!("the recorder's thread could not be started: {error}"),
                    "raise the limit of threads (ulimit -u)",
                )
            })?;
        Ok(Self {
            first,
            taker: NoteTaker {
                notes: notes_to,
                counters,
                camera,
                layout: plan.layout,
            },
            lines: Some(lines),
            is_over,
            thread: Some(thread),
            frames: Some((free, taken_to)),
            wheels: Some(wheels_to),
        })
    }

    /// The first file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.first
    }

    /// Records the frames of `camera`; of one camera alone, the first.
    #[must_use]
    pub fn tap_camera(&mut self, camera: Box<dyn CameraPort + Send>) -> Box<dyn CameraPort + Send> {
        match self.frames.take() {
            Some((free, taken)) => Box::new(CameraTap {
                inner: camera,
                free,
                taken,
                counters: Arc::clone(&self.taker.counters),
            }),
            None => camera,
        }
    }

    /// Records the readings of `wheels`; of the first alone.
    #[must_use]
    pub fn tap_wheels(&mut self, wheels: Box<dyn WheelPort + Send>) -> Box<dyn WheelPort + Send> {
        match self.wheels.take() {
            Some(taken) => Box::new(WheelTap {
                inner: wheels,
                taken,
                counters: Arc::clone(&self.taker.counters),
            }),
            None => wheels,
        }
    }

    /// What it has to tell, a line at a time; for the first who asks.
    pub fn take_lines(&mut self) -> Option<Receiver<String>> {
        self.lines.take()
    }

    /// An observer that notes for the recording what `inner` sees.
    pub fn noted<'a>(&'a self, inner: &'a mut dyn Observer) -> Noted<'a> {
        Noted {
            taker: Some(&self.taker),
            inner,
            unreported: 0,
        }
    }

    /// Its counts, for whoever watches it from elsewhere.
    #[must_use]
    pub fn meter(&self) -> RecordingMeter {
        RecordingMeter(Arc::clone(&self.taker.counters))
    }

    /// Counts so far.
    #[must_use]
    pub fn counts(&self) -> RecordingCounts {
        self.meter().counts()
    }
    /// Writes what still waits, and ends the file.
    pub fn finish(mut self) -> RecordingCounts {
        self.end();
        self.counts()
    }

    fn end(&mut self) {
        self.is_over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // It does nothing that could panic.
            let _ = thread.join();
        }
    }
}

impl Drop for DriveRecorder {
    fn drop(&mut self) {
        self.end();
    }
}

impl<'a> Noted<'a> {
    /// Hands on alone.
    pub fn not(inner: &'a mut dyn Observer) -> Self {
        Self {
            taker: None,
            inner,
            unreported: 0,
        }
    }
}

fn cannot_be_written(path: &Path, error: &dyn std::fmt::Display) -> BadInput {
    BadInput::of_file(
        path,
        format!("cannot be written: {error}"),
        "give a file that ends in .mcap, or a folder, on a disk that has room and may be written to",
    )
}
