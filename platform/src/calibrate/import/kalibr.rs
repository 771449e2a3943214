//! Kalibr's camera chain: `cam0:` with `camera_model`, `distortion_model`, `intrinsics`, `distortion_coeffs`, `resolution`.

use super::yaml::{Document, Node, Value};
use super::{Choice, Format, Imported, Pinhole, lens, size};
use crate::bad_input::{BadInput, closest};
use crate::config::LensModel;

/// Whether a file has cameras as Kalibr writes them.
pub(super) fn is_chain(root: &Node) -> bool {
    cameras(root).next().is_some()
}

fn cameras(root: &Node) -> impl Iterator<Item = (&str, &Node)> {
    let entries: &[(String, Node)] = match &root.value {
        Value::Map(entries) => entries,
        Value::Text(_) | Value::List(_) => &[],
    };
    entries
        .iter()
        .filter(|(_, node)| node.get("camera_model").is_some() && node.get("intrinsics").is_some())
        .map(|(name, node)| (name.as_str(), node))
}

pub(super) fn read(document: &Document<'_>, root: &Node, choice: &Choice) -> Result<Imported, BadInput> {
    let wanted = choice.camera.as_deref();
    let camera = cameras(root).find(|(name, _)| wanted.is_none_or(|wanted| wanted == *name));
    let Some((_, camera)) = camera else {
        let names: Vec<&str> = cameras(root).map(|(name, _)| name).collect();
        let wanted = wanted.unwrap_or_default();
        let meant = closest(wanted, names.iter().copied()).unwrap_or(names[0]);
        return Err(document.fault(
            root.line,
            format!("has no camera `{wanted}`: {}", names.join(", ")),
            &format!("give --camera {meant}"),
        ));
    };
    let need = |key: &str| {
        camera.get(key).ok_or_else(|| {
            document.fault(
                camera.line,
                format!("this camera has no `{key}`"),
                "give the camchain YAML that Kalibr wrote",
            )
        })
    };
    let model_node = need("camera_model")?;
    let model_name = model_node.text().unwrap_or_default();
    if model_name != "pinhole" {
        return Err(document.fault(
            model_node.line,
            format!("the camera model `{model_name}` is not supported"),
            "calibrate with --models pinhole-radtan, or pinhole-equi for a wide lens",
        ));
    }
    let distortion = need("distortion_model")?;
    let model = match distortion.text().unwrap_or_default() {
        "radtan" | "none" => LensModel::BrownConrady,
        "equidistant" => LensModel::KannalaBrandt,
        other => {
            return Err(document.fault(
                distortion.line,
                format!("the distortion model `{other}` is not supported"),
                "calibrate with --models pinhole-radtan, or pinhole-equi for a wide lens",
            ));
        }
    };
    let intrinsics = need("intrinsics")?;
    let values: [f64; 4] = document
        .numbers(intrinsics)?
        .try_into()
        .map_err(|numbers: Vec<f64>| {
            document.fault(
                intrinsics.line,
                format!("{} numbers, not 4", numbers.len()),
                "intrinsics are [fx, fy, cx, cy]",
            )
        })?;
    let coefficients = match camera.get("distortion_coeffs") {
        Some(node) => {
            let numbers = document.numbers(node)?;
            if !matches!(numbers.len(), 0 | 4) {
                return Err(document.fault(
                    node.line,
                    format!("{} coefficients, not 4", numbers.len()),
                    "radtan has k1 k2 p1 p2, equidistant k1 k2 k3 k4",
                ));
            }
            numbers
        }
        None => Vec::new(),
    };
    let size = match camera.get("resolution") {
        Some(Node {
            value: Value::List(sides),
            ..
        }) if sides.len() == 2 => Some(size(document, &sides[0], &sides[1])?),
        _ => None,
    };
    let pinhole = Pinhole {
        values,
        line: intrinsics.line,
    };
    Ok(Imported {
        lens: lens(document, &pinhole, model, &coefficients)?,
        size,
        format: Format::Kalibr,
    })
}
