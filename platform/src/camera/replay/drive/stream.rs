//! The messages of a recorded drive in the order of its files.
//!
//! In: the parts of a recording. Out: attachments and messages of known topics, one at a time, in one reused buffer. Invariant: a
//! chunk is read whole or not at all, by its checksum; where a part is cut off or damaged, what follows in it is left out, and
//! the part is named. Cost: one pass; memory for one chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::sink::mcap::{Losses, Topic};

/// No chunk and no message of a drive is larger; a length that is, is damage.
const LARGEST_RECORD: usize = 256 << 20;

/// What was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// An attachment of this name; its bytes are in [`Stream::data`].
    Attachment(String),
    /// What the recording lacks until here.
    Losses(Losses),
    /// A message; its bytes are in [`Stream::data`].
    Message {
        topic: Topic,
        sequence: u32,
        /// Capture stamp, microseconds.
        at_micros: u64,
    },
}

/// A part that ends before its end.
#[derive(Clone, Debug)]
pub struct CutPart {
    /// The part.
    pub path: PathBuf,
    /// What was found at its end.
    pub cause: String,
}

struct OpenPart {
    file: File,
    reader: LinearReader,
    topics: BTreeMap<u16, Topic>,
}

/// The messages of all parts.
pub(super) struct Stream {
    parts: Vec<PathBuf>,
    next_part: usize,
    part: Option<OpenPart>,
    cut: Vec<CutPart>,
    data: Vec<u8>,
}

impl Stream {
    pub(super) const fn new(parts: Vec<PathBuf>) -> Self {
        Self {
            parts,
            next_part: 0,
            part: None,
            cut: Vec::new(),
            data: Vec::new(),
        }
    }

    /// Bytes of what was found last.
    pub(super) fn data(&self) -> &[u8] {
        &self.data
    }

    /// The part that is read; the first before any is.
    pub(super) fn path(&self) -> &Path {
        let part = self.next_part.saturating_sub(1);
        self.parts.get(part).map_or(Path::new(""), PathBuf::as_path)
    }

    /// Parts that were cut off, so far.
    pub(super) fn cut(&self) -> &[CutPart] {
        &self.cut
    }

    /// What comes next; none at the end of the last part.
    pub(super) fn next(&mut self) -> Option<Found> {
        loop {
            let found = match &mut self.part {
                Some(part) => part.next(&mut self.data),
                None => {
                    let path = self.parts.get(self.next_part)?;
                    self.next_part += 1;
                    match File::open(path) {
                        Ok(file) => {
                            self.part = Some(OpenPart::new(file));
                            continue;
                        }
                        Err(error) => Err(McapError::Io(error)),
                    }
                }
            };
            match found {
                Ok(Some(found)) => return Some(found),
                Ok(None) => self.part = None,
                Err(error) => {
                    let path = self.parts[self.next_part - 1].clone();
                    let cause = error.to_string();
                    self.cut.push(CutPart { path, cause });
                    self.part = None;
                }
            }
        }
    }
}

impl OpenPart {
    fn new(file: File) -> Self {
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(LARGEST_RECORD);
        Self {
            file,
            reader: LinearReader::new_with_options(options),
            topics: BTreeMap::new(),
        }
    }

    /// What comes next, its bytes in `data`; none at the end.
    fn next(&mut self, data: &mut Vec<u8>) -> Result<Option<Found>, McapError> {
        while let Some(event) = self.reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let count = self.file.read(self.reader.insert(wanted))?;
                    self.reader.notify_read(count);
                }
                LinearReadEvent::Record { opcode, data: body } => {
                    // Indexes and the like are for viewers.
                    if !matches!(opcode, op::CHANNEL | op::MESSAGE | op::ATTACHMENT | op::METADATA) {
                        continue;
                    }
                    let record = mcap::parse_record(opcode, body)?;
                    if let Some(found) = take(&mut self.topics, record, data) {
                        return Ok(Some(found));
                    }
                }
            }
        }
        Ok(None)
    }
}

fn take(topics: &mut BTreeMap<u16, Topic>, record: Record<'_>, out: &mut Vec<u8>) -> Option<Found> {
    match record {
        Record::Channel(channel) => {
            if let Some(topic) = Topic::named(&channel.topic) {
                topics.insert(channel.id, topic);
            }
            None
        }
        Record::Message { header, data } => {
            let topic = *topics.get(&header.channel_id)?;
            out.clear();
            out.extend_from_slice(&data);
            Some(Found::Message {
                topic,
                sequence: header.sequence,
                at_micros: header.log_time / 1_000,
            })
        }
        Record::Attachment { header, data, .. } => {
            out.clear();
            out.extend_from_slice(&data);
            Some(Found::Attachment(header.name))
        }
        Record::Metadata(record) => Losses::of_record(&record).map(Found::Losses),
        _ => None,
    }
}
