//! The configuration of a run: TOML in, a checked [`Config`] out.
//!
//! In: one file, its relative paths taken from the folder it lies in. Out: plain values, every range checked once here,
//! so that nobody checks them again. An unknown key, a wrong type or a value out of range is a [`BadInput`] that shows
//! the line and the fix. `config/freespace.schema.json` describes the same keys for editors.

mod camera;
mod can;
mod device;
mod document;
mod runtime;
mod shared_memory;
mod stages;
mod wheels;

pub use camera::{CameraSection, LensModel, LensSection};
pub use can::{CanOut, CanSection};
pub use device::{ControlValue, DeviceFormat, DeviceSection};
pub use runtime::{PolicyName, RuntimeSection, ThreadSection};
pub use shared_memory::{SharedMemorySection, Sharing};
pub use wheels::{
    CanWheels, ChecksumSection, DirectionSignals, FourSignals, WheelKind, WheelSource, Wheels, WheelsSection,
};

use std::path::{Path, PathBuf};

use freespace::crf::CrfConfig;
use freespace::deadline::Slices;
use freespace::frame::Camera;
use freespace::grid::GridConfig;
use freespace::map::MapConfig;
use freespace::priors::PriorsConfig;
use freespace::segmentation::ColourConfig;
use freespace::track::TrackConfig;
use serde::Deserialize;

use crate::bad_input::{BadInput, read_text};
use crate::calibrate::import;
use document::Document;

/// Everything a run is configured with.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The file this was read from.
    #[serde(skip)]
    pub path: PathBuf,
    /// Camera: size, rate, place and lens.
    pub camera: CameraSection,
    /// Wheel encoders; none without this table.
    #[serde(default)]
    pub wheels: WheelsSection,
    /// What is sent on CAN; nothing without this table.
    #[serde(default)]
    pub can: CanSection,
    /// Segmentation network.
    pub network: NetworkSection,
    /// When a frame becomes a key frame.
    #[serde(default)]
    pub key_frames: KeyFramesSection,
    /// When a grid must be out.
    #[serde(default)]
    pub deadline: DeadlineSection,
    /// What the threads ask of the kernel.
    #[serde(default)]
    pub runtime: RuntimeSection,
    /// Message for readers on this computer.
    #[serde(default)]
    pub shared_memory: SharedMemorySection,
    /// Keypoints and frame poses.
    #[serde(default)]
    pub track: TrackConfig,
    /// Map.
    #[serde(default)]
    pub map: MapConfig,
    /// Road plane, boxes and what is believed of the ground.
    #[serde(default)]
    pub priors: PriorsConfig,
    /// Colour lines.
    #[serde(default)]
    pub colour_lines: ColourConfig,
    /// Energy.
    #[serde(default)]
    pub crf: CrfConfig,
    /// Free-space grid.
    #[serde(default)]
    pub grid: GridConfig,
    /// Size of the image that network, energy and cut work on; derived from the camera's without this table.
    pub working_image: Option<ImageSize>,
}

/// Which network runs, and how.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkSection {
    /// Manifest of the network; relative to the config file, absolute once loaded from one.
    pub manifest: PathBuf,
    /// Side-by-side tiles that a wide image is cut into, each run through the network.
    #[serde(default = "one")]
    pub tiles: usize,
    /// Whether the network sees the far end of the road once more, larger.
    #[serde(default)]
    pub far_tile: bool,
    /// Threads of one run.
    #[serde(default = "one")]
    pub threads: usize,
}

const fn one() -> usize {
    1
}

/// When a frame becomes a key frame.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct KeyFramesSection {
    /// Time between key frames.
    pub interval_s: f64,
}

impl Default for KeyFramesSection {
    /// Half a second, the promise of the design: one each 15 to 20 frames at 30 Hz.
    fn default() -> Self {
        Self { interval_s: 0.5 }
    }
}

/// When a grid must be out.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DeadlineSection {
    /// Time from capture to publication that no grid may exceed.
    pub publish_ms: f64,
}

impl Default for DeadlineSection {
    #[expect(clippy::cast_precision_loss, reason = "half a million")]
    fn default() -> Self {
        Self {
            publish_ms: freespace::budget::DEADLINE_MICROS as f64 * 1e-3,
        }
    }
}

impl DeadlineSection {
    /// The same in microseconds.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked to lie between 1 ms and the core's deadline"
    )]
    pub fn publish_micros(&self) -> u64 {
        (self.publish_ms * 1e3).round() as u64
    }
}

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct ImageSize {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

/// Pixels of the largest derived working image: the network's own 480x360.
const WORKING_PIXELS: f64 = 480.0 * 360.0;

/// Reductions tried for the working image, as ratios of small numbers so that every pixel sees the same phase pattern.
const REDUCTIONS: [f64; 9] = [1.0, 4.0 / 3.0, 1.5, 2.0, 8.0 / 3.0, 3.0, 4.0, 6.0, 8.0];

/// A value out of range: its dotted key, what is wrong, the fix.
pub(crate) struct Invalid {
    key: &'static str,
    message: String,
    fix: String,
}

impl Invalid {
    pub(crate) fn new(key: &'static str, message: impl Into<String>, fix: impl Into<String>) -> Self {
        Self {
            key,
            message: message.into(),
            fix: fix.into(),
        }
    }
}

/// `value` must be finite and inside `range`.
pub(crate) fn within(
    key: &'static str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
    unit: &str,
) -> Result<(), Invalid> {
    if range.contains(&value) {
        return Ok(());
    }
    let (low, high) = (range.start(), range.end());
    Err(Invalid::new(
        key,
        format!("`{key}` is {value}, outside {low} to {high} {unit}"),
        format!("set it between {low} and {high} {unit}"),
    ))
}

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// Where the file cannot be read, is no TOML, has an unknown key, a wrong type or a value out of range.
    pub fn load(path: &Path) -> Result<Self, BadInput> {
        let text = read_text(path, "give the path of a TOML file, such as config/kitti.toml")?;
        Self::parse(path, &text)
    }

    /// Checks a text that came from `path`.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, BadInput> {
        let document = Document { path, text };
        let mut config: Self = document.deserialize()?;
        config.check().map_err(|invalid| document.invalid(&invalid))?;
        config.path = path.to_owned();
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        config.network.manifest = folder.join(&config.network.manifest);
        if let Some(dbc) = &mut config.wheels.dbc {
            *dbc = folder.join(&*dbc);
        }
        if let Some(lens) = &mut config.camera.lens.source
            && import::is_yaml(lens)
        {
            *lens = folder.join(&*lens);
        }
        Ok(config)
    }

    fn check(&self) -> Result<(), Invalid> {
        self.camera.check()?;
        self.wheels.plan().map(drop)?;
        within("network.tiles", self.network.tiles as f64, 1.0..=8.0, "tiles")?;
        within(
            "network.threads",
            self.network.threads as f64,
            1.0..=64.0,
            "threads",
        )?;
        within(
            "key_frames.interval_s",
            self.key_frames.interval_s,
            0.05..=10.0,
            "seconds",
        )?;
        let promise_ms = DeadlineSection::default().publish_ms;
        within(
            "deadline.publish_ms",
            self.deadline.publish_ms,
            1.0..=promise_ms,
            "ms",
        )?;
        self.runtime.check()?;
        self.shared_memory.check()?;
        if let Some(size) = self.working_image {
            within("working_image.width", size.width as f64, 64.0..=1920.0, "pixels")?;
            within(
                "working_image.height",
                size.height as f64,
                64.0..=1280.0,
                "pixels",
            )?;
        }
        self.check_stages()?;
        self.plan_can().map(drop)
    }

    /// Slices of the deadline.
    #[must_use]
    pub fn slices(&self) -> Slices {
        Slices::within(self.deadline.publish_micros())
    }

    /// The camera for frames of `width` x `height`, its lens from the config or from a file in `source`, the replayed folder.
    ///
    /// # Errors
    /// Where the frames have another size than the config says, or the lens file in `source` is missing or malformed.
    pub fn camera_for(&self, source: &Path, width: usize, height: usize) -> Result<Camera, BadInput> {
        if let Some(expected) = self.camera.size()
            && expected != (ImageSize { width, height })
        {
            return Err(BadInput::of_file(
                source,
                format!(
                    "frames are {width}x{height}, but [camera] in {} says {}x{}",
                    self.path.display(),
                    expected.width,
                    expected.height
                ),
                "correct width and height in [camera], and the lens with them, or replay the frames that belong to this config",
            ));
        }
        let lens = self.camera.lens.resolve(source, width, height)?;
        Ok(Camera {
            lens,
            width,
            height,
            mount: self.camera.mount,
        })
    }

    /// Wheel encoders, checked when the config was read.
    #[must_use]
    pub fn wheels(&self) -> Wheels {
        self.wheels.plan().unwrap_or(Wheels::None)
    }

    /// The working image of a camera of that size: as configured, else the camera's aspect at the first of a few simple
    /// reductions that has no more pixels than 480x360.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "image sizes"
    )]
    pub fn working_size(&self, width: usize, height: usize) -> ImageSize {
        self.working_image.unwrap_or_else(|| {
            let by = |reduction: f64| ImageSize {
                width: (width as f64 / reduction).round() as usize,
                height: (height as f64 / reduction).round() as usize,
            };
            REDUCTIONS
                .map(by)
                .into_iter()
                .find(|size| (size.width * size.height) as f64 <= WORKING_PIXELS)
                .unwrap_or_else(|| by((width as f64 * height as f64 / WORKING_PIXELS).sqrt()))
        })
    }
}

#[cfg(test)]
mod tests;
