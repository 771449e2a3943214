//! Frames from a folder: a KITTI odometry sequence or plain images; and from a recorded [`drive`].
//!
//! In: `SOURCE/image_0/` or `SOURCE/images/` with an optional `SOURCE/times.txt`, or a folder of PNG or JPEG files, which
//! are taken in the order of their names. Out: [`ReplayFrame`]s, one byte a pixel for gray files and three for colour,
//! decoded into one reused buffer.
//! Invariant: everything that can be known without decoding is checked by [`ReplayCamera::open`] (headers, sizes, ends of
//! files, times), and the first frame is decoded there, so that a bad folder is refused before a run has written anything.
//! A frame missing in mid-sequence keeps its place: the others keep index and stamp, and [`ReplayCamera::missing`] counts it.

pub mod drive;
mod file;
mod key_frames;
mod port;
mod sequence;
#[cfg(test)]
mod tests;

pub use key_frames::{KeyFrameRule, KeyFrameSchedule};
pub use port::ReplayFrames;

use std::path::{Path, PathBuf};

use freespace::frame::PixelFormat;
use freespace::space::Micros;

use crate::bad_input::BadInput;
use crate::config::ImageSize;

/// A decoded frame; borrows the camera's buffer.
#[derive(Clone, Copy, Debug)]
pub struct ReplayFrame<'a> {
    /// Place in the sequence, missing frames counted.
    pub index: usize,
    /// File name without its ending.
    pub name: &'a str,
    /// Capture stamp.
    pub stamp: Micros,
    /// Gray or RGB.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `[height, width, channels] u8`, row-major.
    pub bytes: &'a [u8],
}

/// A file of the sequence.
#[derive(Clone, Debug)]
struct Entry {
    index: usize,
    name: String,
    stamp: Micros,
    path: PathBuf,
}

/// A folder of frames, checked.
#[derive(Debug)]
pub struct ReplayCamera {
    entries: Vec<Entry>,
    missing: Vec<usize>,
    size: ImageSize,
    format: PixelFormat,
    next: usize,
    dropped: u64,
    bytes: Vec<u8>,
}

impl ReplayCamera {
    /// Checks a folder. `frame_rate_hz` stamps frames that have no `times.txt`; `expected` is the size the config names.
    ///
    /// # Errors
    /// An empty folder; an image that cannot be read, is cut off, or has another size; times that go backwards, are no
    /// numbers, or belong to another sequence.
    pub fn open(source: &Path, frame_rate_hz: f64, expected: Option<ImageSize>) -> Result<Self, BadInput> {
        let sequence::Sequence { entries, missing } = sequence::read(source, frame_rate_hz)?;
        let mut camera = Self {
            entries,
            missing,
            size: ImageSize { width: 0, height: 0 },
            format: PixelFormat::Grey,
            next: 0,
            dropped: 0,
            bytes: Vec::new(),
        };
        camera.check_headers(expected)?;
        let first = &camera.entries[0];
        let size = camera.size.width * camera.size.height * camera.format.byte_len(1, 1);
        camera.bytes = vec![0; size];
        file::decode(&first.path, camera.size, camera.format, &mut camera.bytes).map_err(|reason| {
            BadInput::of_file(
                &first.path,
                format!("cannot be decoded: {reason}"),
                "copy the file again from its source",
            )
        })?;
        Ok(camera)
    }

    fn check_headers(&mut self, expected: Option<ImageSize>) -> Result<(), BadInput> {
        for (i, entry) in self.entries.iter().enumerate() {
            let header = file::header(&entry.path)?;
            if i == 0 {
                self.size = header.size;
                self.format = header.format;
            }
            let (wanted, origin) = match expected {
                Some(size) => (size, "the config's [camera]".to_owned()),
                None => (self.size, self.entries[0].path.display().to_string()),
            };
            if header.size != wanted {
                return Err(BadInput::of_file(
                    &entry.path,
                    format!(
                        "is {}x{}, but {origin} has {}x{}",
                        header.size.width, header.size.height, wanted.width, wanted.height
                    ),
                    "replay frames of one size, the size of the config's width and height and lens",
                ));
            }
        }
        Ok(())
    }

    /// Image size.
    #[must_use]
    pub const fn size(&self) -> ImageSize {
        self.size
    }

    /// Pixel format of all frames: that of the first.
    #[must_use]
    pub const fn format(&self) -> PixelFormat {
        self.format
    }

    /// Files in the sequence.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there is no file; never so after [`ReplayCamera::open`].
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Indices that have no file between the first and the last one.
    #[must_use]
    pub fn missing(&self) -> &[usize] {
        &self.missing
    }

    /// Files that could not be decoded so far.
    #[must_use]
    pub const fn undecodable(&self) -> u64 {
        self.dropped
    }

    /// Index, name and stamp of every file, in order.
    pub fn listing(&self) -> impl Iterator<Item = (usize, &str, Micros)> {
        self.entries.iter().map(|e| (e.index, e.name.as_str(), e.stamp))
    }

    /// Stamp of the frame that [`ReplayCamera::next_frame`] would decode.
    #[must_use]
    pub fn next_stamp(&self) -> Option<Micros> {
        self.entries.get(self.next).map(|entry| entry.stamp)
    }

    /// Index of the frame that [`ReplayCamera::next_frame`] would decode.
    #[must_use]
    pub fn next_index(&self) -> Option<usize> {
        self.entries.get(self.next).map(|entry| entry.index)
    }

    /// Stamp of the frame after that.
    #[must_use]
    pub fn stamp_after_next(&self) -> Option<Micros> {
        self.entries.get(self.next + 1).map(|entry| entry.stamp)
    }

    /// Passes the next frame over.
    pub fn skip(&mut self) {
        self.next += 1;
    }

    /// Decodes the next frame; none at the end.
    ///
    /// # Errors
    /// A file that cannot be decoded: it is counted and passed over, and the text names it.
    pub fn next_frame(&mut self) -> Option<Result<ReplayFrame<'_>, String>> {
        let entry = self.entries.get(self.next)?;
        self.next += 1;
        if let Err(reason) = file::decode(&entry.path, self.size, self.format, &mut self.bytes) {
            self.dropped += 1;
            return Some(Err(format!(
                "{}: dropped, cannot be decoded: {reason}",
                entry.path.display()
            )));
        }
        let entry = &self.entries[self.next - 1];
        Some(Ok(ReplayFrame {
            index: entry.index,
            name: &entry.name,
            stamp: entry.stamp,
            format: self.format,
            width: self.size.width,
            height: self.size.height,
            bytes: &self.bytes,
        }))
    }
}
