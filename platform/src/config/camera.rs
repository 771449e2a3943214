//! `[camera]`: size, rate, mount, and a lens given in full, by its field of view, or by a file: KITTI's `calib.txt`, or YAML of a
//! calibration tool.

use std::path::{Path, PathBuf};

use freespace::frame::{BrownConrady, KannalaBrandt, Lens};
use freespace::space::Mount;
use serde::Deserialize;

use super::{DeviceSection, ImageSize, Invalid, within};
use crate::bad_input::{BadInput, read_text};
use crate::calibrate::import::{self, Choice};

/// What the config says of the camera.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSection {
    /// Image width in pixels; taken from the first image where it is not given.
    pub width: Option<usize>,
    /// Image height in pixels; given together with the width.
    pub height: Option<usize>,
    /// Frames a second; stamps frames that carry none.
    pub frame_rate_hz: f64,
    /// Place on the vehicle.
    pub mount: Mount,
    /// Lens.
    pub lens: LensSection,
    /// The camera of this computer; none where frames come from elsewhere.
    pub device: Option<DeviceSection>,
}

/// Three ways to say what the lens is: `model` with its numbers, `hfov_deg`, or `source`.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LensSection {
    /// Lens model of the numbers below.
    pub model: Option<LensModel>,
    /// Focal length in pixels along x.
    pub fx: Option<f64>,
    /// Focal length in pixels along y.
    pub fy: Option<f64>,
    /// Principal point in pixels, the top-left pixel's centre being 0.
    pub cx: Option<f64>,
    /// See `cx`.
    pub cy: Option<f64>,
    /// Radial coefficients: three for Brown-Conrady, four for Kannala-Brandt; zero without.
    pub k: Option<Vec<f64>>,
    /// Tangential coefficients of Brown-Conrady; zero without.
    pub p: Option<[f64; 2]>,
    /// Calibration file: KITTI's `calib.txt` in the replayed folder, its `P0:` line; or YAML (OpenCV, ROS, Kalibr) relative to the
    /// config file, absolute once loaded from one.
    pub source: Option<PathBuf>,
    /// Horizontal field of view in degrees of a lens without distortion, its axis through the image centre.
    pub hfov_deg: Option<f64>,
    /// Width of a pixel over its height, with `hfov_deg`; 1 without.
    pub pixel_aspect: Option<f64>,
}

/// Lens models of the core.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum LensModel {
    /// Pinhole with radial and tangential distortion.
    BrownConrady,
    /// Fisheye.
    KannalaBrandt,
}

impl CameraSection {
    /// The configured size.
    #[must_use]
    pub fn size(&self) -> Option<ImageSize> {
        self.width
            .zip(self.height)
            .map(|(width, height)| ImageSize { width, height })
    }

    #[expect(clippy::cast_precision_loss, reason = "image sizes")]
    pub(super) fn check(&self) -> Result<(), Invalid> {
        within("camera.frame_rate_hz", self.frame_rate_hz, 0.5..=240.0, "Hz")?;
        if self.width.is_some() != self.height.is_some() {
            return Err(Invalid::new(
                if self.width.is_some() {
                    "camera.width"
                } else {
                    "camera.height"
                },
                "`width` and `height` of [camera] belong together",
                "give both, or neither to take them from the first image",
            ));
        }
        if let Some(size) = self.size() {
            within("camera.width", size.width as f64, 64.0..=1920.0, "pixels")?;
            within("camera.height", size.height as f64, 64.0..=1280.0, "pixels")?;
        }
        let mount = &self.mount;
        within("camera.mount.height_m", mount.height_m, 0.2..=5.0, "metres")?;
        within("camera.mount.ahead_m", mount.ahead_m, -10.0..=10.0, "metres")?;
        within("camera.mount.left_m", mount.left_m, -3.0..=3.0, "metres")?;
        within("camera.mount.pitch_rad", mount.pitch_rad, -0.8..=0.8, "radians")?;
        within("camera.mount.yaw_rad", mount.yaw_rad, -0.8..=0.8, "radians")?;
        within("camera.mount.roll_rad", mount.roll_rad, -0.8..=0.8, "radians")?;
        if let Some(device) = &self.device {
            device.check(self.size().is_some())?;
        }
        self.lens.check(self.size().is_some())
    }
}

impl LensSection {
    fn check(&self, sized: bool) -> Result<(), Invalid> {
        let ways = [
            self.model.is_some(),
            self.source.is_some(),
            self.hfov_deg.is_some(),
        ];
        if ways.into_iter().filter(|given| *given).count() != 1 {
            return Err(Invalid::new(
                "camera.lens",
                "[camera.lens] must say in exactly one way what the lens is",
                "give `model` with fx, fy, cx, cy, or `hfov_deg`, or `source = \"calib.txt\"`",
            ));
        }
        let numbers = [self.fx, self.fy, self.cx, self.cy];
        if self.model.is_none() {
            let given = numbers.iter().any(Option::is_some) || self.k.is_some() || self.p.is_some();
            if given {
                return Err(Invalid::new(
                    "camera.lens",
                    "fx, fy, cx, cy, k and p of [camera.lens] belong to `model`",
                    "add `model = \"brown_conrady\"` or \"kannala_brandt\", or remove these numbers",
                ));
            }
        }
        if let Some(aspect) = self.pixel_aspect {
            if self.hfov_deg.is_none() {
                return Err(Invalid::new(
                    "camera.lens.pixel_aspect",
                    "`pixel_aspect` of [camera.lens] belongs to `hfov_deg`",
                    "remove it: fx and fy say the same",
                ));
            }
            within(
                "camera.lens.pixel_aspect",
                aspect,
                0.3..=3.0,
                "(width over height)",
            )?;
        }
        if let Some(hfov_deg) = self.hfov_deg {
            within("camera.lens.hfov_deg", hfov_deg, 10.0..=150.0, "degrees")?;
        }
        if self.model.is_some() {
            self.check_model(sized)?;
        }
        Ok(())
    }

    fn check_model(&self, sized: bool) -> Result<(), Invalid> {
        if !sized {
            return Err(Invalid::new(
                "camera.lens.model",
                "a lens given in pixels needs the image size it was calibrated at",
                "add width and height to [camera]",
            ));
        }
        let keys = [
            ("camera.lens.fx", self.fx, 10.0..=10_000.0),
            ("camera.lens.fy", self.fy, 10.0..=10_000.0),
            ("camera.lens.cx", self.cx, -10_000.0..=10_000.0),
            ("camera.lens.cy", self.cy, -10_000.0..=10_000.0),
        ];
        for (key, value, range) in keys {
            let value = value.ok_or_else(|| {
                Invalid::new(
                    key,
                    format!("`{key}` is missing"),
                    "give fx, fy, cx and cy of [camera.lens] in pixels",
                )
            })?;
            within(key, value, range, "pixels")?;
        }
        let (wanted, k, p) = match self.model {
            Some(LensModel::KannalaBrandt) => (4, self.k.as_deref(), None),
            _ => (3, self.k.as_deref(), self.p),
        };
        if self.model == Some(LensModel::KannalaBrandt) && self.p.is_some() {
            return Err(Invalid::new(
                "camera.lens.p",
                "`p` belongs to the model brown_conrady",
                "remove it",
            ));
        }
        let k = k.unwrap_or_default();
        if !k.is_empty() && k.len() != wanted {
            return Err(Invalid::new(
                "camera.lens.k",
                format!("`k` has {} coefficients, this model has {wanted}", k.len()),
                format!("give {wanted} numbers, 0.0 for those not calibrated"),
            ));
        }
        for value in k.iter().chain(p.iter().flatten()) {
            within("camera.lens.k", *value, -100.0..=100.0, "")?;
        }
        Ok(())
    }

    /// The lens for an image of that size.
    #[expect(clippy::cast_precision_loss, reason = "image sizes")]
    pub(super) fn resolve(&self, folder: &Path, width: usize, height: usize) -> Result<Lens, BadInput> {
        if let Some(file) = &self.source {
            if import::is_yaml(file) {
                return yaml_lens(file, ImageSize { width, height });
            }
            return kitti_lens(&folder.join(file));
        }
        if let Some(hfov_deg) = self.hfov_deg {
            let fx = width as f64 / (2.0 * (0.5 * hfov_deg.to_radians()).tan());
            let fy = fx * self.pixel_aspect.unwrap_or(1.0);
            let centre = |size: usize| 0.5 * (size as f64 - 1.0);
            return Ok(Lens::pinhole(fx, fy, centre(width), centre(height)));
        }
        let number = |value: Option<f64>| value.unwrap_or_default();
        let (fx, fy) = (number(self.fx), number(self.fy));
        let (cx, cy) = (number(self.cx), number(self.cy));
        let k = |i: usize| {
            self.k
                .as_ref()
                .and_then(|k| k.get(i))
                .copied()
                .unwrap_or_default()
        };
        Ok(match self.model {
            Some(LensModel::KannalaBrandt) => Lens::KannalaBrandt(KannalaBrandt {
                fx,
                fy,
                cx,
                cy,
                k: std::array::from_fn(k),
            }),
            _ => Lens::BrownConrady(BrownConrady {
                fx,
                fy,
                cx,
                cy,
                k: std::array::from_fn(k),
                p: self.p.unwrap_or_default(),
            }),
        })
    }
}

/// The lens of a calibration in YAML; it must belong to images of this size, where the file states its own.
fn yaml_lens(path: &Path, size: ImageSize) -> Result<Lens, BadInput> {
    let imported = import::read(path, &Choice::default())?;
    match imported.size {
        Some(own) if own != size => Err(BadInput::of_file(
            path,
            format!(
                "belongs to images of {}x{}, but the frames are {}x{}",
                own.width, own.height, size.width, size.height
            ),
            "calibrate at the size of the frames, or record at the size of the calibration",
        )),
        _ => Ok(imported.lens),
    }
}

/// The lens of the left gray camera from a KITTI odometry `calib.txt`: `P0:` and the 3x4 projection, row by row.
fn kitti_lens(path: &Path) -> Result<Lens, BadInput> {
    let text = read_text(
        path,
        "copy the sequence's calib.txt there, or give [camera.lens] a model with fx, fy, cx, cy",
    )?;
    let Some((line, numbers)) = text
        .lines()
        .enumerate()
        .find_map(|(line, row)| row.trim_start().strip_prefix("P0:").map(|rest| (line, rest)))
    else {
        return Err(BadInput::of_file(
            path,
            "has no line that begins with `P0:`",
            "use the calib.txt of a KITTI odometry sequence, or give [camera.lens] a model with fx, fy, cx, cy",
        ));
    };
    let fault = |what: String| {
        let fix = "`P0:` is followed by 12 numbers, the 3x4 projection matrix row by row";
        BadInput::at_line(path, &text, line, what, fix)
    };
    let p: Vec<f64> = numbers
        .split_whitespace()
        .map(|word| {
            word.parse()
                .map_err(|_| fault(format!("`{word}` is not a number")))
        })
        .collect::<Result<_, _>>()?;
    let &[fx, _, cx, _, _, fy, cy, ..] = p.as_slice() else {
        return Err(fault(format!("{} numbers after `P0:`, not 12", p.len())));
    };
    if p.len() != 12 {
        return Err(fault(format!("{} numbers after `P0:`, not 12", p.len())));
    }
    if !(fx > 0.0 && fy > 0.0 && p.iter().all(|v| v.is_finite())) {
        return Err(fault("focal lengths must be positive".to_owned()));
    }
    Ok(Lens::pinhole(fx, fy, cx, cy))
}
