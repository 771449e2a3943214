//! What is asked of a camera: the config's device, with the size and rate of `[camera]`.

use std::path::PathBuf;

use crate::config::{ControlValue, DeviceFormat, DeviceSection, ImageSize};

/// A device, and how it must be.
#[derive(Clone, Debug)]
pub(super) struct Request {
    pub(super) device: PathBuf,
    pub(super) formats: Vec<DeviceFormat>,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) rate_hz: f64,
    pub(super) buffers: u32,
    pub(super) controls: Vec<(String, ControlValue)>,
}

impl Request {
    pub(super) fn new(device: &DeviceSection, size: ImageSize, rate_hz: f64) -> Self {
        // Sizes are checked to be small; one that is not is refused by the driver.
        let pixels = |size: usize| u32::try_from(size).unwrap_or(u32::MAX);
        Self {
            device: device.path.clone(),
            formats: device.formats.clone(),
            width: pixels(size.width),
            height: pixels(size.height),
            rate_hz,
            buffers: device.buffers,
            controls: (device.controls.iter())
                .map(|(name, value)| (name.clone(), value.clone()))
                .collect(),
        }
    }
}
