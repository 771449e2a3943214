//! A camera matrix and distortion coefficients, as OpenCV's FileStorage and ROS's `camera_info` write them.
//!
//! OpenCV's order is k1 k2 p1 p2 k3, then the rational model's k4 k5 k6, the thin prism's s1 to s4 and the tilt's two angles,
//! which must be zero here. A fisheye's are k1 k2 k3 k4; ROS names that model, OpenCV's sample writes `fisheye_model: 1`.

use super::yaml::{Document, Node};
use super::{Choice, Format, Imported, Pinhole, lens, size};
use crate::bad_input::BadInput;
use crate::config::LensModel;

const MATRIX: [&str; 7] = [
    "camera_matrix",
    "cameraMatrix",
    "Camera_Matrix",
    "intrinsic_matrix",
    "K",
    "M1",
    "mtx",
];
const COEFFICIENTS: [&str; 8] = [
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distCoeffs",
    "dist_coeffs",
    "dist_coeff",
    "D",
    "D1",
    "dist",
];
/// Names of OpenCV's coefficients, in its order.
const NAMES: [&str; 14] = [
    "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y",
];
/// Coefficients of Brown-Conrady; the rest must be zero.
const BROWN_CONRADY: usize = 5;
const KANNALA_BRANDT: usize = 4;

pub(super) fn read(document: &Document<'_>, root: &Node, choice: &Choice) -> Result<Imported, BadInput> {
    let matrix = root.first(&MATRIX).ok_or_else(|| {
        document.fault(
            0,
            "has no `camera_matrix`, and no camera as Kalibr writes it".to_owned(),
            "give a calibration in YAML: OpenCV's, ROS's camera_info, or Kalibr's camchain",
        )
    })?;
    let numbers = document.numbers(matrix)?;
    let &[fx, skew, cx, zero, fy, cy, ..] = numbers.as_slice() else {
        return Err(document.fault(
            matrix.line,
            format!("{} numbers, not 9", numbers.len()),
            "the camera matrix is 3x3, row by row",
        ));
    };
    if numbers.len() != 9 || zero != 0.0 {
        return Err(document.fault(
            matrix.line,
            "this is no camera matrix".to_owned(),
            "it is 3x3, row by row: fx 0 cx, 0 fy cy, 0 0 1",
        ));
    }
    if skew.abs() > 1e-9 * fx.abs() {
        return Err(document.fault(
            matrix.line,
            format!("the skew {skew} is not zero"),
            "calibrate without skew: no lens of this program has it",
        ));
    }
    let model = model(document, root, choice)?;
    let coefficients = match root.first(&COEFFICIENTS) {
        Some(node) => coefficients(document, node, model)?,
        None => Vec::new(),
    };
    let sides = (root.first(&["image_width", "image_Width", "width"])).zip(root.first(&[
        "image_height",
        "image_Height",
        "height",
    ]));
    let pinhole = Pinhole {
        values: [fx, fy, cx, cy],
        line: matrix.line,
    };
    Ok(Imported {
        lens: lens(document, &pinhole, model, &coefficients)?,
        size: sides
            .map(|(width, height)| size(document, width, height))
            .transpose()?,
        format: if root.get("distortion_model").is_some() {
            Format::RosCameraInfo
        } else {
            Format::OpenCv
        },
    })
}

/// The model that the file names, else the user's, else OpenCV's ordinary one.
fn model(document: &Document<'_>, root: &Node, choice: &Choice) -> Result<LensModel, BadInput> {
    if let Some(node) = root.get("distortion_model") {
        return match node.text().unwrap_or_default() {
            // The rational model with its denominator zero is the ordinary one; see `coefficients`.
            "plumb_bob" | "rational_polynomial" | "radtan" | "none" | "" => Ok(LensModel::BrownConrady),
            "equidistant" | "fisheye" | "kannala_brandt" => Ok(LensModel::KannalaBrandt),
            other => Err(document.fault(
                node.line,
                format!("the distortion model `{other}` is not supported"),
                "calibrate as plumb_bob, or as equidistant (fisheye) for a wide lens",
            )),
        };
    }
    let is_fisheye = root
        .first(&["fisheye_model", "fisheye", "calibrate_useFisheye"])
        .and_then(Node::text)
        .is_some_and(|flag| matches!(flag, "1" | "true"));
    Ok(if is_fisheye {
        LensModel::KannalaBrandt
    } else {
        choice.model.unwrap_or(LensModel::BrownConrady)
    })
}

fn coefficients(document: &Document<'_>, node: &Node, model: LensModel) -> Result<Vec<f64>, BadInput> {
    let mut numbers = document.numbers(node)?;
    if model == LensModel::KannalaBrandt {
        return if numbers.len() == KANNALA_BRANDT {
            Ok(numbers)
        } else {
            Err(document.fault(
                node.line,
                format!("{} coefficients of a fisheye, not 4", numbers.len()),
                "give k1 k2 k3 k4, or --model brown_conrady for an ordinary lens",
            ))
        };
    }
    if !matches!(numbers.len(), 0 | 4 | 5 | 8 | 12 | 14) {
        return Err(document.fault(
            node.line,
            format!("{} coefficients", numbers.len()),
            "OpenCV writes 4, 5, 8, 12 or 14: k1 k2 p1 p2 k3 ...",
        ));
    }
    let higher: Vec<&str> = (numbers.iter().zip(NAMES).skip(BROWN_CONRADY))
        .filter(|(value, _)| **value != 0.0)
        .map(|(_, name)| name)
        .collect();
    if !higher.is_empty() {
        return Err(document.fault(
            node.line,
            format!("the coefficients {} are not zero: no lens of this program has them", higher.join(", ")),
            "calibrate without CALIB_RATIONAL_MODEL, CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL, or as a fisheye",
        ));
    }
    numbers.truncate(BROWN_CONRADY);
    Ok(numbers)
}
