//! The model's manifest: which file, what goes in, what comes out, which classes are road.
//!
//! In: a TOML file such as `models/road.toml`. Out: a [`Manifest`] whose every field has been checked, and the model's bytes,
//! whose SHA-256 is the one stated. Invariant: classes are unique, at least one is road and at least one is not.
//! An error names the file, the line or field, and the fix.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::{ChannelOrder, NetworkShape};

/// Largest accepted width or height, pixels: a typing error should not allocate gigabytes.
const MAX_SIDE: usize = 4096;

use freespace::budget::MAX_CLASSES;

/// The network's input, `[3, height, width]`: `(pixel - mean) * scale`, pixels 0 to 255, in the stated order.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputDescription {
    /// Name in the model.
    pub name: String,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Order of the planes; `mean` and `scale` follow it.
    pub order: ChannelOrder,
    /// Subtracted from each plane's pixels.
    pub mean: [f32; 3],
    /// Multiplied afterwards.
    pub scale: [f32; 3],
}

/// The network's output, `[classes, height, width]` probabilities.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputDescription {
    /// Name in the model.
    pub name: String,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
}

/// A checked manifest.
#[derive(Clone, Debug, PartialEq)]
pub struct Manifest {
    /// The manifest's own file.
    pub path: PathBuf,
    /// The network's name.
    pub name: String,
    /// The model's file.
    pub file: PathBuf,
    /// Lower-case hexadecimal SHA-256 of the model's file.
    pub sha256: String,
    /// What goes in.
    pub input: InputDescription,
    /// What comes out.
    pub output: OutputDescription,
    /// Names of the classes, in the output's order.
    pub classes: Vec<String>,
    /// Indices of the classes that are road, ascending.
    pub road: Vec<usize>,
    /// Indices of the classes that are vehicles, ascending; none where the network knows none.
    pub vehicle: Vec<usize>,
}

/// Why a manifest, or the model that it describes, is refused.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum ManifestError {
    /// A file cannot be read.
    #[error("{file}: {field} cannot be read: {error}", file = .file.display())]
    #[diagnostic(help("{fix}"))]
    Read {
        /// The file that names the missing one, or the missing one itself.
        file: PathBuf,
        /// Which field, or the manifest itself.
        field: String,
        /// The system's words.
        error: std::io::Error,
        /// What to do.
        fix: String,
    },
    /// Not TOML, an unknown key, a missing key or a value of another type.
    #[error("{file}, line {line}: {detail}", file = .file.display())]
    #[diagnostic(help("correct line {line} of {}", .file.display()))]
    Syntax {
        /// The manifest.
        file: PathBuf,
        /// One-based.
        line: usize,
        /// The parser's words.
        detail: String,
    },
    /// A value that cannot be right.
    #[error("{file}: {field}: {problem}", file = .file.display())]
    #[diagnostic(help("{fix}"))]
    Field {
        /// The manifest.
        file: PathBuf,
        /// `table.key`.
        field: &'static str,
        /// What is wrong.
        problem: String,
        /// What to do.
        fix: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    name: String,
    file: PathBuf,
    sha256: String,
    input: InputDescription,
    output: OutputDescription,
    classes: Classes,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Classes {
    names: Vec<String>,
    road: Vec<String>,
    #[serde(default)]
    vehicle: Vec<String>,
}

impl Manifest {
    /// Reads and checks a manifest; the model's file is looked for beside it.
    ///
    /// # Errors
    /// An unreadable file, an unknown or missing key, or a value that cannot be right.
    pub fn load(path: &Path) -> Result<Self, ManifestError> {
        let text = fs::read_to_string(path).map_err(|error| ManifestError::Read {
            file: path.to_owned(),
            field: "the model manifest".to_owned(),
            error,
            fix: "give the path of a manifest such as models/road.toml".to_owned(),
        })?;
        Self::parse(path, &text)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, ManifestError> {
        let document: Document = toml::from_str(text).map_err(|error| ManifestError::Syntax {
            file: path.to_owned(),
            line: line_of(text, error.span().map_or(0, |span| span.start)),
            detail: error.message().to_owned(),
        })?;
        let check = Check { path };
        check.sha256(&document.sha256)?;
        check.side("input.width", document.input.width)?;
        check.side("input.height", document.input.height)?;
        check.side("output.width", document.output.width)?;
        check.side("output.height", document.output.height)?;
        check.normalisation(&document.input)?;
        let road = check.classes(&document.classes)?;
        let vehicle = check.vehicles(&document.classes)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Ok(Self {
            path: path.to_owned(),
            name: document.name,
            file: folder.join(document.file),
            sha256: document.sha256.to_ascii_lowercase(),
            input: document.input,
            output: document.output,
            classes: document.classes.names,
            road,
            vehicle,
        })
    }

    /// What the core must know of the network.
    #[must_use]
    pub fn shape(&self) -> NetworkShape {
        NetworkShape {
            width: self.input.width,
            height: self.input.height,
            classes: self.classes.len(),
            road: self.road.iter().copied().collect(),
            vehicle: self.vehicle.iter().copied().collect(),
            mean: self.input.mean,
            scale: self.input.scale,
            order: self.input.order,
            out_width: self.output.width,
            out_height: self.output.height,
        }
    }

    /// Reads the model's file and compares its SHA-256 with the stated one.
    ///
    /// # Errors
    /// An unreadable file or another sum.
    pub fn read_model(&self) -> Result<Vec<u8>, ManifestError> {
        let bytes = fs::read(&self.file).map_err(|error| ManifestError::Read {
            file: self.path.clone(),
            field: format!("file = \"{}\"", self.file.display()),
            error,
            fix: format!("put the model there, or correct file in {}", self.path.display()),
        })?;
        let found: String = (Sha256::digest(&bytes).iter())
            .map(|byte| format!("{byte:02x}"))
            .collect();
        if found == self.sha256 {
            return Ok(bytes);
        }
        Err(ManifestError::Field {
            file: self.path.clone(),
            field: "sha256",
            problem: format!(
                "{} has the SHA-256 {found}, the manifest states {}",
                self.file.display(),
                self.sha256
            ),
            fix: "restore the model's file; if it was meant to change, state the new sum in the manifest"
                .to_owned(),
        })
    }
}

struct Check<'a> {
    path: &'a Path,
}

impl Check<'_> {
    fn refuse<T>(&self, field: &'static str, problem: String, fix: &str) -> Result<T, ManifestError> {
        Err(ManifestError::Field {
            file: self.path.to_owned(),
            field,
            problem,
            fix: fix.to_owned(),
        })
    }

    fn sha256(&self, sum: &str) -> Result<(), ManifestError> {
        if sum.len() == 64 && sum.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Ok(());
        }
        let problem = format!("\"{sum}\" is not 64 hexadecimal digits");
        self.refuse(
            "sha256",
            problem,
            "state what `sha256sum` prints for the model's file",
        )
    }

    fn side(&self, field: &'static str, pixels: usize) -> Result<(), ManifestError> {
        if (1..=MAX_SIDE).contains(&pixels) {
            return Ok(());
        }
        let problem = format!("{pixels} is not between 1 and {MAX_SIDE} pixels");
        self.refuse(field, problem, "state the size that the model was exported with")
    }

    fn normalisation(&self, input: &InputDescription) -> Result<(), ManifestError> {
        let fix = "state the values that the network was trained with; pixels run from 0 to 255";
        if !input.mean.iter().all(|mean| mean.is_finite()) {
            return self.refuse("input.mean", format!("{:?} is not finite", input.mean), fix);
        }
        if !input.scale.iter().all(|scale| scale.is_finite() && *scale != 0.0) {
            let problem = format!("{:?} holds a zero or is not finite", input.scale);
            return self.refuse("input.scale", problem, fix);
        }
        Ok(())
    }

    fn classes(&self, classes: &Classes) -> Result<Vec<usize>, ManifestError> {
        let names = &classes.names;
        if !(2..=MAX_CLASSES).contains(&names.len()) {
            let problem = format!("{} classes; 2 to {MAX_CLASSES} are possible", names.len());
            return self.refuse(
                "classes.names",
                problem,
                "name every class of the output, in its order",
            );
        }
        if let Some((_, twice)) = (names.iter().enumerate()).find(|(at, name)| names[..*at].contains(name)) {
            let problem = format!("\"{twice}\" stands there twice");
            return self.refuse("classes.names", problem, "give every class a name of its own");
        }
        if let Some(stranger) = classes.road.iter().find(|road| !names.contains(road)) {
            let problem = format!("\"{stranger}\" is none of classes.names: {}", names.join(", "));
            return self.refuse("classes.road", problem, "name road classes as in classes.names");
        }
        let road: Vec<usize> = (0..names.len())
            .filter(|class| classes.road.contains(&names[*class]))
            .collect();
        if road.is_empty() || road.len() == names.len() {
            let problem = format!("{} of {} classes are road", road.len(), names.len());
            return self.refuse(
                "classes.road",
                problem,
                "at least one class is road and at least one is not",
            );
        }
        Ok(road)
    }

    fn vehicles(&self, classes: &Classes) -> Result<Vec<usize>, ManifestError> {
        let names = &classes.names;
        let odd = |name: &&String| !names.contains(name) || classes.road.contains(name);
        if let Some(stranger) = classes.vehicle.iter().find(odd) {
            let problem = format!(
                "\"{stranger}\" is none of classes.names, or is road: {}",
                names.join(", ")
            );
            return self.refuse(
                "classes.vehicle",
                problem,
                "name vehicle classes as in classes.names, or none",
            );
        }
        Ok((0..names.len())
            .filter(|class| classes.vehicle.contains(&names[*class]))
            .collect())
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + (text.bytes().take(offset)).filter(|byte| *byte == b'\n').count()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]
    use super::*;
    use miette::Diagnostic;

    const GOOD: &str = r#"name = "road"
file = "road.onnx"
sha256 = "0000000000000000000000000000000000000000000000000000000000000000"
[input]
name = "image"
width = 480
height = 360
order = "rgb"
mean = [123.7, 116.3, 103.5]
scale = [0.017, 0.017, 0.017]
[output]
name = "probabilities"
width = 120
height = 90
[classes]
names = ["sky", "road", "mark", "car"]
road = ["mark", "road"]
"#;

    #[test]
    fn a_good_manifest_is_read() {
        let manifest = Manifest::parse(Path::new("models/road.toml"), GOOD).unwrap();
        assert_eq!(manifest.road, [1, 2]);
        assert_eq!(manifest.file, Path::new("models/road.onnx"));
        assert_eq!(manifest.input.order, ChannelOrder::Rgb);
        assert_eq!(manifest.shape().input_len(), 3 * 480 * 360);
        assert_eq!(manifest.shape().output_len(), 4 * 120 * 90);
    }

    /// Each wrong manifest: what replaces what, where the message points, and a word of the fix.
    #[test]
    fn every_error_names_file_place_and_fix() {
        let cases = [
            ("mean = [", "maen = [", "line 9", "maen", "line 9"),
            ("order = \"rgb\"", "order = \"yuv\"", "line 8", "yuv", "line 8"),
            ("width = 480", "width = \"480\"", "line 6", "480", "line 6"),
            ("width = 480", "width = 0", "input.width", "0 is not", "exported"),
            (
                "height = 90",
                "height = 90000",
                "output.height",
                "90000",
                "exported",
            ),
            (
                "sha256 = \"0000",
                "sha256 = \"xyz",
                "sha256",
                "hexadecimal",
                "sha256sum",
            ),
            ("scale = [0.017", "scale = [0.0", "input.scale", "zero", "trained"),
            ("mean = [123.7", "mean = [nan", "input.mean", "finite", "trained"),
            (
                "\"mark\", \"road\"]",
                "\"lane\"]",
                "classes.road",
                "lane",
                "classes.names",
            ),
            (
                "road = [\"mark\", \"road\"]",
                "road = []",
                "classes.road",
                "0 of 4",
                "at least one",
            ),
            ("\"sky\"", "\"car\"", "classes.names", "twice", "own"),
            (
                "height = 90\n",
                "",
                "line 11",
                "missing field `height`",
                "line 11",
            ),
        ];
        for (from, to, place, cause, fix) in cases {
            let text = GOOD.replacen(from, to, 1);
            assert_ne!(text, GOOD, "{from}");
            let error = Manifest::parse(Path::new("models/road.toml"), &text).unwrap_err();
            let message = error.to_string();
            assert!(message.contains("models/road.toml"), "{message}");
            assert!(message.contains(place), "{message}");
            assert!(message.contains(cause), "{message}");
            let help = error.help().unwrap().to_string();
            assert!(help.contains(fix), "{message}: {help}");
        }
    }

    #[test]
    fn a_model_with_another_sum_is_refused() {
        let folder = std::env::temp_dir().join(format!("freespace-manifest-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("road.toml");
        let mut manifest = Manifest::parse(&path, GOOD).unwrap();

        let missing = manifest.read_model().unwrap_err();
        assert!(missing.to_string().contains("file = "), "{missing}");

        fs::write(folder.join("road.onnx"), b"abc").unwrap();
        let error = manifest.read_model().unwrap_err();
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert!(
            error.to_string().contains("sha256") && error.to_string().contains(abc),
            "{error}"
        );
        assert!(error.help().unwrap().to_string().contains("restore"));

        manifest.sha256 = abc.to_owned();
        assert_eq!(manifest.read_model().unwrap(), b"abc");
        fs::remove_dir_all(&folder).unwrap();
    }
}
