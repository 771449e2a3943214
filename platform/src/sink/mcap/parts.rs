//! The files of a recorded drive, one after the other.
//!
//! In: messages. Out: `NAME.mcap`, `NAME.001.mcap`, and so on, each whole by itself. Invariant: what is older than
//! [`FLUSH_EVERY`] is in the kernel's hands, as whole chunks, so that a killed process loses at most the last one. A chunk leaves
//! in one piece from memory. When the disk is full the part ends where it is, readable up to its last chunk; it is told once, the
//! messages, those of the chunk that did not leave among them, are counted as lost, and a new part is tried every [`RETRY_EVERY`].
//! What is lost stands in the parts, too. Cost: lz4, and a checksum, over every byte.

use std::collections::BTreeSet;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use mcap::records::MessageHeader;
use mcap::{Attachment, Compression, McapError, WriteOptions};

use super::format::Topic;
use super::losses::Losses;
use super::note::Note;
use super::preamble;

/// Uncompressed bytes of a chunk: four frames of 640x480 in colour.
const CHUNK_BYTES: u64 = 4 << 20;
/// The longest that a message waits for its chunk to be written.
pub const FLUSH_EVERY: Duration = Duration::from_millis(500);
/// Between two records of what was lost.
const TELL_LOSSES_EVERY: Duration = Duration::from_secs(1);
/// How long a disk that refused is left alone.
pub const RETRY_EVERY: Duration = Duration::from_secs(10);

/// What a part is written to.
pub trait Medium: Write + Seek + Send {}

impl<T: Write + Seek + Send> Medium for T {}

/// Makes the file of a part; it must not be there yet.
pub type OpenPart = Box<dyn FnMut(&Path) -> io::Result<Box<dyn Medium>> + Send>;

/// Makes files.
pub(super) fn open_file() -> OpenPart {
    Box::new(|path| {
        let file = std::fs::OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(path)?;
        Ok(Box::new(file))
    })
}

/// When the next part begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// After so many bytes.
    pub bytes: Option<u64>,
    /// After this long.
    pub after: Option<Duration>,
}

/// Path of a part, counted from 0, of the recording that begins at `first`.
#[must_use]
pub fn part_path(first: &Path, part: u32) -> PathBuf {
    if part == 0 {
        first.to_owned()
    } else {
        first.with_extension(format!("{part:03}.mcap"))
    }
}

/// The parts after the first that are there of the recording that begins at `first`, by number, whether or not any is missing.
#[must_use]
pub fn later_parts(first: &Path) -> BTreeSet<u32> {
    let folder = first.parent().filter(|folder| *folder != Path::new(""));
    let (Some(stem), Ok(entries)) = (
        first.file_stem().and_then(|stem| stem.to_str()),
        std::fs::read_dir(folder.unwrap_or(Path::new("."))),
    ) else {
        return BTreeSet::new();
    };
    let number = |name: &str| {
        let text = name
            .strip_prefix(stem)?
            .strip_prefix('.')?
            .strip_suffix(".mcap")?;
        part_number(text)
    };
    entries
        .filter_map(|entry| number(entry.ok()?.file_name().to_str()?))
        .collect()
}

/// Which part of which recording a file is by its name, where it is not the first: the number, and the first one's path.
#[must_use]
pub fn later_part_of(path: &Path) -> Option<(u32, PathBuf)> {
    let (stem, text) = path
        .file_name()?
        .to_str()?
        .strip_suffix(".mcap")?
        .rsplit_once('.')?;
    let part = part_number(text)?;
    Some((part, path.with_file_name(format!("{stem}.mcap"))))
}

fn part_number(text: &str) -> Option<u32> {
    let number: u32 = text.parse().ok()?;
    (number > 0 && text == format!("{number:03}")).then_some(number)
}

/// A part that is there already of the recording that would begin at `first`, whatever its number.
pub(super) fn earlier_part(first: &Path) -> Option<PathBuf> {
    if first.exists() {
        return Some(first.to_owned());
    }
    let earliest = later_parts(first).into_iter().next();
    earliest.map(|part| part_path(first, part))
}

/// What stands at the head of each part.
pub(super) struct Head {
    pub(super) drive: Vec<u8>,
    pub(super) config: String,
    pub(super) standing: Vec<Note>,
}

/// Counts, for whoever asks while the recording goes on.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) written_bytes: AtomicU64,
    pub(super) frames: AtomicU64,
    /// Messages that a full disk lost.
    pub(super) lost_messages: AtomicU64,
    /// Frames that found no buffer free.
    pub(super) dropped_frames: AtomicU64,
    /// Other messages that found a queue full, on their way to the observer or from it.
    pub(super) dropped_messages: AtomicU64,
}

impl Counters {
    fn written(&self) -> u64 {
        self.written_bytes.load(Ordering::Relaxed)
    }

    pub(super) fn losses(&self) -> Losses {
        Losses {
            dropped_frames: self.dropped_frames.load(Ordering::Relaxed),
            dropped_messages: self.dropped_messages.load(Ordering::Relaxed),
            lost_messages: self.lost_messages.load(Ordering::Relaxed),
        }
    }
}

pub(super) fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Ordering::Relaxed);
}

/// Messages of a chunk that is still in memory.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    messages: u64,
    frames: u64,
}

/// A medium whose bytes are counted.
struct Counted {
    inner: Box<dyn Medium>,
    written: u64,
    counters: Arc<Counters>,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.inner.write(bytes)?;
        self.written += count as u64;
        add(&self.counters.written_bytes, count as u64);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl Seek for Counted {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.inner.seek(position)
    }

    fn stream_position(&mut self) -> io::Result<u64> {
        // Nothing is ever written twice.
        Ok(self.written)
    }
}

/// A part under way.
struct Part {
    writer: mcap::Writer<Counted>,
    channels: [u16; Topic::ALL.len()],
    begun: Instant,
    began_bytes: u64,
    counters: Arc<Counters>,
    held: Held,
    flushed: Instant,
    /// As written last, and when.
    losses: Losses,
    losses_told: Instant,
}

impl Part {
    fn begin(medium: Box<dyn Medium>, head: &Head, counters: &Arc<Counters>) -> Result<Self, McapError> {
        let began_bytes = counters.written();
        let counted = Counted {
            inner: medium,
            written: 0,
            counters: Arc::clone(counters),
        };
        let mut writer = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            // Every chunk has its own.
            .calculate_data_section_crc(false)
            .library(concat!("freespace ", env!("CARGO_PKG_VERSION")))
            .create(counted)?;
        // The one date in the file: all other times are the drive's own, monotonic.
        let begun_unix_nanos = preamble::unix_nanos();
        for (name, media_type, data) in [
            (preamble::DRIVE, "application/json", &head.drive[..]),
            (preamble::CONFIG, "application/toml", head.config.as_bytes()),
        ] {
            writer.attach(&Attachment {
                log_time: 0,
                create_time: begun_unix_nanos,
                name: name.to_owned(),
                media_type: media_type.to_owned(),
                data: data.into(),
            })?;
        }
        let mut channels = [0; Topic::ALL.len()];
        for topic in Topic::ALL {
            let layout = topic.layout();
            let schema = writer.add_schema(&layout.schema, &layout.schema_encoding, &layout.schema_data)?;
            channels[topic as usize] = writer.add_channel(
                schema,
                topic.name(),
                layout.message_encoding,
                &std::collections::BTreeMap::new(),
            )?;
        }
        let mut part = Self {
            writer,
            channels,
            begun: Instant::now(),
            began_bytes,
            counters: Arc::clone(counters),
            held: Held::default(),
            flushed: Instant::now(),
            losses: counters.losses(),
            losses_told: Instant::now(),
        };
        part.writer.write_metadata(&part.losses.record())?;
        for note in &head.standing {
            part.write(note.topic, 0, note.at.0, &note.data)?;
        }
        part.flush()?;
        Ok(part)
    }

    fn write(&mut self, topic: Topic, sequence: u32, at_micros: u64, data: &[u8]) -> Result<(), McapError> {
        let nanos = at_micros.saturating_mul(1_000);
        let header = MessageHeader {
            channel_id: self.channels[topic as usize],
            sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        let written = self.counters.written();
        self.writer.write_to_known_channel(&header, data)?;
        if self.counters.written() > written {
            // The chunk before was full, and left first.
            self.held = Held::default();
        }
        self.held.messages += 1;
        self.held.frames += u64::from(topic == Topic::Image);
        Ok(())
    }

    /// Lets the chunk go.
    fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()?;
        self.held = Held::default();
        Ok(())
    }

    /// Writes what was lost where that has grown, at most once a second.
    fn tell_losses_if_due(&mut self, losses: Losses, now: Instant) -> Result<(), McapError> {
        if losses != self.losses && now.duration_since(self.losses_told) >= TELL_LOSSES_EVERY {
            self.tell_losses(losses)?;
            self.losses_told = now;
        }
        Ok(())
    }

    fn tell_losses(&mut self, losses: Losses) -> Result<(), McapError> {
        self.flush()?;
        self.writer.write_metadata(&losses.record())?;
        self.losses = losses;
        Ok(())
    }

    /// Ends the part, what was lost last in it.
    fn finish(&mut self, losses: Losses) -> Result<(), McapError> {
        self.tell_losses(losses)?;
        self.writer.finish().map(drop)
    }

    fn flush_if_due(&mut self, now: Instant) -> Result<(), McapError> {
        if self.held.messages > 0 && now.duration_since(self.flushed) >= FLUSH_EVERY {
            self.flush()?;
            self.flushed = now;
        }
        Ok(())
    }

    fn is_full(&self, split: &Split, now: Instant) -> bool {
        let bytes = self.counters.written() - self.began_bytes;
        split.bytes.is_some_and(|most| bytes >= most)
            || split
                .after
                .is_some_and(|after| now.duration_since(self.begun) >= after)
    }
}

/// All parts of a recording, the last of them open.
pub(super) struct Parts {
    first: PathBuf,
    split: Split,
    head: Head,
    open: OpenPart,
    counters: Arc<Counters>,
    part: Option<Part>,
    /// Number of the next part.
    next: u32,
    /// A file of that part, without its head, could not be removed.
    has_remains: bool,
    retry_at: Option<Instant>,
    tell: Box<dyn FnMut(String) + Send>,
}

impl Parts {
    /// Begins the first part.
    ///
    /// # Errors
    /// It cannot be written.
    pub(super) fn begin(
        first: &Path,
        split: Split,
        head: Head,
        open: OpenPart,
        counters: &Arc<Counters>,
        tell: Box<dyn FnMut(String) + Send>,
    ) -> Result<Self, McapError> {
        let mut parts = Self {
            first: first.to_owned(),
            split,
            head,
            open,
            counters: Arc::clone(counters),
            part: None,
            next: 0,
            has_remains: false,
            retry_at: None,
            tell,
        };
        parts.begin_part()?;
        Ok(parts)
    }

    fn begin_part(&mut self) -> Result<(), McapError> {
        let path = part_path(&self.first, self.next);
        if self.has_remains {
            let _ = std::fs::remove_file(&path);
        }
        let medium = (self.open)(&path)?;
        match Part::begin(medium, &self.head, &self.counters) {
            Ok(part) => {
                self.next += 1;
                self.has_remains = false;
                self.part = Some(part);
                Ok(())
            }
            Err(error) => {
                // A part without its head is of no use, and its name is wanted for the next try.
                self.has_remains = std::fs::remove_file(&path).is_err();
                Err(error)
            }
        }
    }

    /// Path of the part that was begun last.
    fn path(&self) -> PathBuf {
        part_path(&self.first, self.next.saturating_sub(1))
    }

    /// Writes a message, or counts it as lost.
    pub(super) fn write(&mut self, topic: Topic, sequence: u32, at_micros: u64, data: &[u8]) {
        let Some(part) = &mut self.part else {
            add(&self.counters.lost_messages, 1);
            return;
        };
        match part.write(topic, sequence, at_micros, data) {
            Ok(()) => add(&self.counters.frames, u64::from(topic == Topic::Image)),
            Err(error) => {
                add(&self.counters.lost_messages, 1);
                self.fail(&error);
            }
        }
    }

    /// Writes what has waited long enough, begins the next part where one is due, tries again where the disk refused.
    pub(super) fn tend(&mut self, now: Instant) {
        let losses = self.counters.losses();
        if let Some(part) = &mut self.part {
            let tended = if part.is_full(&self.split, now) {
                part.finish(losses).and_then(|()| self.begin_part())
            } else {
                part.tell_losses_if_due(losses, now)
                    .and_then(|()| part.flush_if_due(now))
            };
            if let Err(error) = tended {
                self.fail(&error);
            }
        } else if self.retry_at.is_some_and(|at| now >= at) {
            match self.begin_part() {
                Ok(()) => {
                    let line = format!("{}: the recording goes on here", self.path().display());
                    (self.tell)(line);
                }
                Err(_) => self.retry_at = Some(now + RETRY_EVERY),
            }
        }
    }

    fn fail(&mut self, error: &McapError) {
        let cause = match error {
            McapError::Io(cause) => cause.to_string(),
            other => other.to_string(),
        };
        let line = format!(
            "{}: cannot be written: {cause}; the drive goes on, and is recorded again once there is room: give the disk room, \
             or another one with --mcap",
            self.path().display()
        );
        (self.tell)(line);
        if let Some(Part { held, .. }) = self.part.take() {
            // The disk had not got them.
            add(&self.counters.lost_messages, held.messages);
            self.counters.frames.fetch_sub(held.frames, Ordering::Relaxed);
        }
        self.retry_at = Some(Instant::now() + RETRY_EVERY);
    }

    /// Ends the last part.
    pub(super) fn finish(&mut self) {
        let losses = self.counters.losses();
        let Some(part) = &mut self.part else { return };
        match part.finish(losses) {
            Ok(()) => self.part = None,
            Err(error) => self.fail(&error),
        }
    }
}
