//! Road masks against truth: precision, recall and F, pooled over all pixels of all frames.
//!
//! In: `NAME.png` masks, 0 not road, anything else road, and truth files of the same stems in one of three conventions.
//! Pixels that the truth leaves open are not counted.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::bad_input::BadInput;

/// What the values of a truth file mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TruthKind {
    /// CamVid ids: 3 road, 11 void.
    Camvid,
    /// 0 not road, 1 road, 255 open.
    #[default]
    Kitti,
    /// The simulated road's own, in the values of [`TruthKind::Kitti`].
    World,
}

impl FromStr for TruthKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "camvid" => Ok(Self::Camvid),
            "kitti" => Ok(Self::Kitti),
            "world" => Ok(Self::World),
            _ => Err(format!(
                "`{text}` is no kind of truth; use camvid, kitti or world"
            )),
        }
    }
}

impl TruthKind {
    /// Whether a truth value is road; none where the truth leaves it open.
    ///
    /// # Errors
    /// A value that this kind does not have.
    pub const fn road(self, value: u8) -> Result<Option<bool>, u8> {
        match (self, value) {
            (Self::Camvid, 3) | (Self::Kitti | Self::World, 1) => Ok(Some(true)),
            (Self::Camvid, 11) | (Self::Kitti | Self::World, 255) => Ok(None),
            (Self::Camvid, 0..11) | (Self::Kitti | Self::World, 0) => Ok(Some(false)),
            _ => Err(value),
        }
    }
}

/// Counted pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelCount {
    /// Road called road.
    pub hits: u64,
    /// Not road called road.
    pub false_alarms: u64,
    /// Road called not road.
    pub misses: u64,
    /// Not road called not road.
    pub rejections: u64,
}

#[expect(clippy::cast_precision_loss, reason = "pixel counts")]
fn ratio(part: u64, whole: u64) -> f64 {
    if whole == 0 {
        0.0
    } else {
        part as f64 / whole as f64
    }
}

impl PixelCount {
    /// Counts one frame; `predicted` non-zero is road. Both have the same length.
    ///
    /// # Errors
    /// The first truth value that `kind` does not have.
    pub fn add(&mut self, predicted: &[u8], truth: &[u8], kind: TruthKind) -> Result<(), u8> {
        for (&called, &value) in predicted.iter().zip(truth) {
            match (called != 0, kind.road(value)?) {
                (_, None) => {}
                (true, Some(true)) => self.hits += 1,
                (true, Some(false)) => self.false_alarms += 1,
                (false, Some(true)) => self.misses += 1,
                (false, Some(false)) => self.rejections += 1,
            }
        }
        Ok(())
    }

    /// Adds another count.
    pub const fn merge(&mut self, other: &Self) {
        self.hits += other.hits;
        self.false_alarms += other.false_alarms;
        self.misses += other.misses;
        self.rejections += other.rejections;
    }

    /// Share of road among what was called road; zero where nothing was.
    #[must_use]
    pub fn precision(&self) -> f64 {
        ratio(self.hits, self.hits + self.false_alarms)
    }

    /// Share of what was called road among road; zero where there was none.
    #[must_use]
    pub fn recall(&self) -> f64 {
        ratio(self.hits, self.hits + self.misses)
    }

    /// Intersection over union of road; zero where there was none in either.
    #[must_use]
    pub fn iou(&self) -> f64 {
        ratio(self.hits, self.hits + self.false_alarms + self.misses)
    }

    /// Harmonic mean of precision and recall.
    #[must_use]
    pub fn f(&self) -> f64 {
        ratio(2 * self.hits, 2 * self.hits + self.false_alarms + self.misses)
    }
}

/// The comparison of two folders.
#[derive(Clone, Debug, Default)]
pub struct MaskScore {
    /// All frames together.
    pub pooled: PixelCount,
    /// Each frame, by name.
    pub frames: Vec<(String, PixelCount)>,
    /// Truth files without a mask.
    pub missing: Vec<String>,
}

/// A decoded 8-bit image of one channel.
pub(super) struct GrayFile {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) pixels: Vec<u8>,
}

pub(super) fn read_gray(path: &Path) -> Result<GrayFile, BadInput> {
    let image = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|error| error.to_string())
        .and_then(|reader| reader.decode().map_err(|error| error.to_string()))
        .map_err(|error| {
            BadInput::of_file(
                path,
                format!("cannot be read: {error}"),
                "write it again as an 8-bit gray PNG",
            )
        })?;
    match image {
        image::DynamicImage::ImageLuma8(gray) => Ok(GrayFile {
            width: gray.width(),
            height: gray.height(),
            pixels: gray.into_raw(),
        }),
        other => Err(BadInput::of_file(
            path,
            format!("is a {:?} image", other.color()),
            "masks and truth are 8-bit gray PNG files that hold one id a pixel",
        )),
    }
}

/// What a folder of one kind of file should be.
fn folder_of(ending: &str) -> String {
    format!("give a folder of NAME.{ending} files")
}

/// Files of a folder by stem; at least one.
pub(super) fn files_by_stem(folder: &Path, ending: &str) -> Result<BTreeMap<String, PathBuf>, BadInput> {
    let files = any_files_by_stem(folder, ending)?;
    if files.is_empty() {
        let what = format!("holds no .{ending} file");
        return Err(BadInput::of_file(folder, what, folder_of(ending)));
    }
    Ok(files)
}

/// The same, of which there may be none.
pub(super) fn any_files_by_stem(folder: &Path, ending: &str) -> Result<BTreeMap<String, PathBuf>, BadInput> {
    let fix = folder_of(ending);
    let listing = std::fs::read_dir(folder)
        .map_err(|error| BadInput::of_file(folder, format!("cannot be listed: {error}"), fix.as_str()))?;
    Ok(listing
        .filter_map(Result::ok)
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)))
        .filter_map(|path| Some((path.file_stem()?.to_str()?.to_owned(), path)))
        .collect())
}

/// Compares the masks of `predictions` with the truth files of the same stem, of which there may be none.
///
/// # Errors
/// A folder that cannot be listed, a truth without files, sizes that differ, or a truth value that `kind` does not have.
pub fn compare_common(predictions: &Path, truth: &Path, kind: TruthKind) -> Result<MaskScore, BadInput> {
    let predicted = any_files_by_stem(predictions, "png")?;
    let mut score = MaskScore::default();
    for (name, truth_path) in &files_by_stem(truth, "png")? {
        let Some(path) = predicted.get(name) else {
            score.missing.push(name.clone());
            continue;
        };
        let mut count = PixelCount::default();
        compare_files(path, truth_path, kind, &mut count)?;
        score.pooled.merge(&count);
        score.frames.push((name.clone(), count));
    }
    Ok(score)
}

/// The same, where at least one name must be common.
///
/// # Errors
/// As [`compare_common`], and no common name.
pub fn compare_folders(predictions: &Path, truth: &Path, kind: TruthKind) -> Result<MaskScore, BadInput> {
    let score = compare_common(predictions, truth, kind)?;
    if score.frames.is_empty() {
        return Err(BadInput::of_file(
            predictions,
            format!(
                "none of the {} truth files in {} has a mask here",
                score.missing.len(),
                truth.display()
            ),
            "masks are matched by file name; list the labelled frames after --key-frames so that they get one",
        ));
    }
    Ok(score)
}

/// Checks that every truth file of `folder` has `size` and values of `kind` only.
///
/// # Errors
/// A folder without files, or the first file at fault.
pub fn check_truth(folder: &Path, kind: TruthKind, width: usize, height: usize) -> Result<(), BadInput> {
    for path in files_by_stem(folder, "png")?.values() {
        let truth = read_gray(path)?;
        if (truth.width as usize, truth.height as usize) != (width, height) {
            return Err(BadInput::of_file(
                path,
                format!(
                    "is {}x{}, but the frames are {width}x{height}",
                    truth.width, truth.height
                ),
                "compare with truth of the frames' size",
            ));
        }
        let zeros = vec![0; truth.pixels.len()];
        PixelCount::default()
            .add(&zeros, &truth.pixels, kind)
            .map_err(|value| foreign_value(path, kind, value))?;
    }
    Ok(())
}

fn foreign_value(path: &Path, kind: TruthKind, value: u8) -> BadInput {
    BadInput::of_file(
        path,
        format!(
            "holds the value {value}, which {} truth does not have",
            kind.word()
        ),
        "say what the values mean: --truth camvid (ids 0 to 11), kitti (0, 1, 255) or world",
    )
}

fn compare_files(
    path: &Path,
    truth_path: &Path,
    kind: TruthKind,
    count: &mut PixelCount,
) -> Result<(), BadInput> {
    let mask = read_gray(path)?;
    let truth = read_gray(truth_path)?;
    if (mask.width, mask.height) != (truth.width, truth.height) {
        return Err(BadInput::of_file(
            path,
            format!(
                "is {}x{}, but its truth {} is {}x{}",
                mask.width,
                mask.height,
                truth_path.display(),
                truth.width,
                truth.height
            ),
            "compare masks of the input's size",
        ));
    }
    count
        .add(&mask.pixels, &truth.pixels, kind)
        .map_err(|value| foreign_value(truth_path, kind, value))
}

impl TruthKind {
    /// The word of the command line.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Camvid => "camvid",
            Self::Kitti => "kitti",
            Self::World => "world",
        }
    }
}
