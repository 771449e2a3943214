//! `[camera.device]`: which camera of this computer, and how it is set up.
//!
//! Size and rate are those of `[camera]`. Whether the device has the formats and controls named here is found out when it is
//! opened; the text alone is checked here.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use serde::de::{Deserializer, Error, Visitor};
use serde::{Deserialize, Serialize};

use super::{Invalid, within};

/// What the config says of the camera's device.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceSection {
    /// Its node: `/dev/video0`, or a link of `/dev/v4l/by-path` or `by-id` that stays when devices are numbered anew.
    pub path: PathBuf,
    /// Formats in order of preference.
    #[serde(default = "uncompressed_first")]
    pub formats: Vec<DeviceFormat>,
    /// Buffers asked of the driver.
    #[serde(default = "four")]
    pub buffers: u32,
    /// Controls by name, as `v4l2-ctl --list-ctrls` writes them.
    #[serde(default)]
    pub controls: BTreeMap<String, ControlValue>,
    /// Added to the driver's stamps, seconds: negative where they are late of the exposure's middle.
    #[serde(default)]
    pub stamp_offset_s: f64,
}

/// Formats of a camera that the core reads, or that are decoded for it.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum DeviceFormat {
    /// YUV 4:2:2, two pixels in four bytes.
    Yuyv,
    /// YUV 4:2:0, luma and chroma in two planes of one buffer.
    Nv12,
    /// Luma.
    Grey,
    /// Red, green, blue.
    Rgb24,
    /// Pictures compressed by JPEG.
    Mjpeg,
}

/// Value of a control.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ControlValue {
    /// On or off.
    Bool(bool),
    /// A number, or the number of a menu's item.
    Integer(i64),
    /// The name of a menu's item.
    Item(String),
}

/// Bytes as the sensor gave them lose nothing to compression; colour is wanted, so grey comes late.
fn uncompressed_first() -> Vec<DeviceFormat> {
    use DeviceFormat::{Grey, Mjpeg, Nv12, Rgb24, Yuyv};
    vec![Yuyv, Nv12, Rgb24, Grey, Mjpeg]
}

/// One is filled, one read, two stand between them: 66 ms at 30 Hz.
const fn four() -> u32 {
    4
}

impl DeviceSection {
    pub(super) fn check(&self, is_sized: bool) -> Result<(), Invalid> {
        if !self.path.is_absolute() {
            return Err(Invalid::new(
                "camera.device.path",
                format!("`{}` is no path of a device", self.path.display()),
                "write /dev/video0, or better a link of /dev/v4l/by-path, which stays the same camera after a restart",
            ));
        }
        if !is_sized {
            return Err(Invalid::new(
                "camera.device",
                "a camera device must be asked for a size",
                "add width and height to [camera]",
            ));
        }
        if self.formats.is_empty() {
            return Err(Invalid::new(
                "camera.device.formats",
                "`formats` names no format",
                "remove it, or name some of yuyv, nv12, rgb24, grey, mjpeg, the preferred one first",
            ));
        }
        within(
            "camera.device.buffers",
            f64::from(self.buffers),
            2.0..=32.0,
            "buffers",
        )?;
        // A second is more than any exposure and read-out take; a larger number is a wrong unit.
        within(
            "camera.device.stamp_offset_s",
            self.stamp_offset_s,
            -1.0..=1.0,
            "seconds",
        )
    }

    /// The offset of stamps in microseconds.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "at most a second")]
    pub fn stamp_offset_micros(&self) -> i64 {
        (self.stamp_offset_s * 1e6).round() as i64
    }
}

impl fmt::Display for ControlValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(is_on) => write!(f, "{is_on}"),
            Self::Integer(number) => write!(f, "{number}"),
            Self::Item(name) => write!(f, "\"{name}\""),
        }
    }
}

impl<'de> Deserialize<'de> for ControlValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl Visitor<'_> for Reader {
            type Value = ControlValue;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number, true or false, or the name of a menu item")
            }

            fn visit_bool<E: Error>(self, is_on: bool) -> Result<ControlValue, E> {
                Ok(ControlValue::Bool(is_on))
            }

            fn visit_i64<E: Error>(self, number: i64) -> Result<ControlValue, E> {
                Ok(ControlValue::Integer(number))
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<ControlValue, E> {
                Ok(ControlValue::Item(name.to_owned()))
            }
        }
        deserializer.deserialize_any(Reader)
    }
}
