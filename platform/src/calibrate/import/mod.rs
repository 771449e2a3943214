//! Calibration files of other tools, read as a lens.
//!
//! In: YAML as OpenCV's FileStorage writes it, ROS's `camera_info`, or Kalibr's `camchain`; which one is told by its keys. Out: the
//! [`Imported`] lens, and the image size where the file states it. Invariant: what this program's lenses cannot express (a
//! rational model's denominator, a thin prism, an omnidirectional camera) is refused by name, never left out.

mod kalibr;
mod opencv;
mod yaml;

use std::path::Path;

use freespace::frame::{BrownConrady, KannalaBrandt, Lens};

use crate::bad_input::{BadInput, read_text};
use crate::config::{ImageSize, LensModel};
use yaml::{Document, Node};

/// A lens from a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imported {
    /// The lens.
    pub lens: Lens,
    /// Size of the images that it was calibrated with.
    pub size: Option<ImageSize>,
    /// What wrote the file.
    pub format: Format,
}

/// What wrote a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenCV's FileStorage.
    OpenCv,
    /// ROS's `camera_info`.
    RosCameraInfo,
    /// Kalibr's `camchain`.
    Kalibr,
}

impl Format {
    /// For a reader.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OpenCv => "OpenCV FileStorage",
            Self::RosCameraInfo => "ROS camera_info",
            Self::Kalibr => "Kalibr camchain",
        }
    }
}

/// What the user says of a file that the file does not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choice {
    /// Lens model, where the file states none: OpenCV's own files of fisheye lenses may not.
    pub model: Option<LensModel>,
    /// Camera of a Kalibr chain; the first one without.
    pub camera: Option<String>,
}

/// Whether a file's ending is one that [`read`] takes.
#[must_use]
pub fn is_yaml(path: &Path) -> bool {
    let ending = path
        .extension()
        .and_then(|ending| ending.to_str())
        .map(str::to_ascii_lowercase);
    matches!(ending.as_deref(), Some("yaml" | "yml"))
}

/// Reads a file.
///
/// # Errors
/// A file that cannot be read, is none of these formats, lacks a number, or describes a lens of another kind.
pub fn read(path: &Path, choice: &Choice) -> Result<Imported, BadInput> {
    let text = read_text(
        path,
        "give a calibration in YAML: OpenCV's, ROS's camera_info, or Kalibr's camchain",
    )?;
    parse(path, &text, choice)
}

/// Reads a text that came from `path`.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &str, choice: &Choice) -> Result<Imported, BadInput> {
    if text.trim_start().starts_with("<?xml") {
        return Err(BadInput::of_file(
            path,
            "is XML",
            "save it as YAML: cv::FileStorage and its Python twin choose by the file's ending, .yaml",
        ));
    }
    let document = Document { path, text };
    let root = document.root()?;
    let imported = if kalibr::is_chain(&root) {
        kalibr::read(&document, &root, choice)?
    } else {
        opencv::read(&document, &root, choice)?
    };
    Ok(imported)
}

/// Focal lengths, principal point, and where they stand.
struct Pinhole {
    values: [f64; 4],
    line: usize,
}

/// Checks the numbers and makes a lens of them; `coefficients` are k1 k2 p1 p2 k3, or a fisheye's k1 to k4.
fn lens(
    document: &Document<'_>,
    pinhole: &Pinhole,
    model: LensModel,
    coefficients: &[f64],
) -> Result<Lens, BadInput> {
    let [fx, fy, cx, cy] = pinhole.values;
    let is_sound = (1.0..1e5).contains(&fx) && (1.0..1e5).contains(&fy) && cx.abs() < 1e5 && cy.abs() < 1e5;
    if !is_sound || coefficients.iter().any(|value| !(value.abs() <= 100.0)) {
        return Err(document.fault(
            pinhole.line,
            format!("fx {fx}, fy {fy}, cx {cx}, cy {cy} and coefficients {coefficients:?} are no lens"),
            "calibrate again: focal lengths are positive pixels, coefficients between -100 and 100",
        ));
    }
    let at = |i: usize| coefficients.get(i).copied().unwrap_or_default();
    Ok(match model {
        LensModel::BrownConrady => Lens::BrownConrady(BrownConrady {
            fx,
            fy,
            cx,
            cy,
            k: [at(0), at(1), at(4)],
            p: [at(2), at(3)],
        }),
        LensModel::KannalaBrandt => Lens::KannalaBrandt(KannalaBrandt {
            fx,
            fy,
            cx,
            cy,
            k: std::array::from_fn(at),
        }),
    })
}

/// An image size from two nodes.
fn size(document: &Document<'_>, width: &Node, height: &Node) -> Result<ImageSize, BadInput> {
    let side = |node: &Node| {
        (node.text().and_then(|text| text.parse::<usize>().ok()))
            .filter(|side| (16..=20_000).contains(side))
            .ok_or_else(|| {
                document.fault(
                    node.line,
                    "this is no image size".to_owned(),
                    "give whole pixels, 16 to 20000",
                )
            })
    };
    Ok(ImageSize {
        width: side(width)?,
        height: side(height)?,
    })
}

#[cfg(test)]
mod tests;
