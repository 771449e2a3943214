//! The network behind one small port: `[3, H, W] f32` in, `[C, h, w] f32` class probabilities out.
//!
//! In: planes in the order, mean and scale that the model's [`Manifest`] states, row-major. Out: the softmax of each class,
//! row-major, at the network's output size. Invariant: an opened segmenter has run once, and its input and output are the
//! manifest's. Cost bound: the network's own; `run` of ONNX Runtime makes no Rust allocation, that of rten does.
//! There is no queue: a caller that is late skips the frame.

pub mod manifest;
#[cfg(feature = "onnx")]
mod onnx_arena;
#[cfg(feature = "onnx")]
pub mod onnx_runtime;
#[cfg(feature = "rten")]
pub mod rten;

#[cfg(test)]
mod conformance;

pub use freespace::segmentation::{ChannelOrder, NetworkShape};
pub use manifest::{Manifest, ManifestError};

use std::path::PathBuf;
use std::sync::Arc;

/// Why one run gave no answer; the caller keeps the last probabilities and counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SegmenterError {
    /// The input is not `3 * H * W` long: a fault of the caller.
    #[error("the network's input has another length than 3 * H * W")]
    InputLength,
    /// The output is not `C * h * w` long: a fault of the caller.
    #[error("the network's output has another length than C * h * w")]
    OutputLength,
    /// The engine refused: skip this frame.
    #[error("the network's engine failed")]
    Engine,
}

/// A network that runs.
pub trait Segmenter: Send {
    /// Engine, its version, and why it was taken, for the start-up line and the report.
    fn name(&self) -> &str;

    /// Sizes of input and output.
    fn shape(&self) -> &NetworkShape;

    /// Runs the network: `fill` writes the engine's input, `[3, H, W]`, and `read` takes its output, `[C, h, w]`, both where the
    /// engine has them, for a copy of them would cost megabytes a key frame.
    ///
    /// # Errors
    /// A failure of the engine; `read` was not called then.
    fn run_in_place(
        &mut self,
        fill: &mut dyn FnMut(&mut [f32]),
        read: &mut dyn FnMut(&[f32]),
    ) -> Result<(), SegmenterError>;

    /// Runs the network on a copy of `input` and copies its output to `output`.
    ///
    /// # Errors
    /// A wrong length, or a failure of the engine; `output` is as it was.
    fn run(&mut self, input: &[f32], output: &mut [f32]) -> Result<(), SegmenterError> {
        if input.len() != self.shape().input_len() {
            return Err(SegmenterError::InputLength);
        }
        if output.len() != self.shape().output_len() {
            return Err(SegmenterError::OutputLength);
        }
        self.run_in_place(&mut |buffer| buffer.copy_from_slice(input), &mut |answer| {
            output.copy_from_slice(answer);
        })
    }

    /// What stops a run from another thread; none where the engine cannot be stopped.
    fn stopper(&self) -> Option<Arc<dyn Stop>> {
        None
    }
}

/// Stops a run that is under way; it then fails, and the next one runs as ever.
pub trait Stop: Send + Sync {
    /// Returns at once; without a run under way, nothing happens.
    fn stop(&self);
}

/// Which engine runs the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum EngineChoice {
    /// ONNX Runtime where its library is found, else rten; the name tells which and why.
    #[default]
    Auto,
    /// ONNX Runtime or an error.
    OnnxRuntime,
    /// rten or an error.
    Rten,
}

/// Why a network could not be opened.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum OpenError {
    /// The manifest or its model file is wrong.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Manifest(#[from] ManifestError),
    /// The model is another one than its manifest describes.
    #[error("{manifest}: [{table}]: the manifest says {stated}, the model {model} has {found}", manifest = .manifest.display(), model = .model.display())]
    #[diagnostic(help("correct [{table}] in {}, or export the model with the shape stated there", .manifest.display()))]
    Shape {
        /// The manifest.
        manifest: PathBuf,
        /// Table of the manifest: `input`, `output` or `classes`.
        table: &'static str,
        /// What the manifest states.
        stated: String,
        /// The model file.
        model: PathBuf,
        /// What the model has.
        found: String,
    },
    /// The engine cannot take the model.
    #[error("{model}: {engine} cannot run this model: {detail}", model = .model.display())]
    #[diagnostic(help(
        "choose another engine (auto, onnx-runtime, rten), or export the model with opset 16 and plain operators"
    ))]
    Engine {
        /// The model file.
        model: PathBuf,
        /// The engine.
        engine: String,
        /// Its own words.
        detail: String,
    },
    /// The engine asked for is not there.
    #[error("the engine {engine} is not available: {detail}")]
    #[diagnostic(help(
        "run scripts/fetch-onnxruntime.sh, set ORT_DYLIB_PATH to the library, or choose the engine auto"
    ))]
    Unavailable {
        /// The engine.
        engine: &'static str,
        /// Why not.
        detail: String,
    },
}

/// Opens the network of a manifest, checks it against the manifest and warms it up.
///
/// `threads` is the engine's thread count; one is best beside other real-time work.
///
/// # Errors
/// A model file that differs from its manifest, or no engine that can run it.
pub fn open(
    manifest: &Manifest,
    choice: EngineChoice,
    threads: usize,
) -> Result<Box<dyn Segmenter>, OpenError> {
    let model = manifest.read_model()?;
    let threads = threads.max(1);
    let why_not_onnx = match choice {
        EngineChoice::Rten => "chosen".to_owned(),
        EngineChoice::OnnxRuntime | EngineChoice::Auto => {
            match open_onnx_runtime(manifest, &model, threads) {
                Err(OpenError::Unavailable { detail, .. }) if choice == EngineChoice::Auto => {
                    format!("ONNX Runtime is not available: {detail}")
                }
                other => return other,
            }
        }
    };
    open_rten(manifest, model, threads, &why_not_onnx)
}

#[cfg(feature = "onnx")]
fn open_onnx_runtime(
    manifest: &Manifest,
    model: &[u8],
    threads: usize,
) -> Result<Box<dyn Segmenter>, OpenError> {
    let mut segmenter = onnx_runtime::OnnxRuntimeSegmenter::open(manifest, model, threads)?;
    warm_up(&mut segmenter, manifest)?;
    Ok(Box::new(segmenter))
}

#[cfg(not(feature = "onnx"))]
fn open_onnx_runtime(_: &Manifest, _: &[u8], _: usize) -> Result<Box<dyn Segmenter>, OpenError> {
    Err(OpenError::Unavailable {
        engine: "onnx-runtime",
        detail: "built without the feature onnx".to_owned(),
    })
}

#[cfg(feature = "rten")]
fn open_rten(
    manifest: &Manifest,
    model: Vec<u8>,
    threads: usize,
    why: &str,
) -> Result<Box<dyn Segmenter>, OpenError> {
    let mut segmenter = rten::RtenSegmenter::open(manifest, model, threads, why)?;
    warm_up(&mut segmenter, manifest)?;
    Ok(Box::new(segmenter))
}

#[cfg(not(feature = "rten"))]
fn open_rten(_: &Manifest, _: Vec<u8>, _: usize, why: &str) -> Result<Box<dyn Segmenter>, OpenError> {
    Err(OpenError::Unavailable {
        engine: "rten",
        detail: format!("built without the feature rten; {why}"),
    })
}

/// The first runs lay out the engine's memory: they cost several times a later one, so they happen before the loop.
#[cfg(any(feature = "onnx", feature = "rten"))]
fn warm_up(segmenter: &mut dyn Segmenter, manifest: &Manifest) -> Result<(), OpenError> {
    const RUNS: usize = 3;
    let (input_len, output_len) = (segmenter.shape().input_len(), segmenter.shape().output_len());
    let input = vec![0.0; input_len];
    let mut output = vec![0.0; output_len];
    for _ in 0..RUNS {
        segmenter
            .run(&input, &mut output)
            .map_err(|error| OpenError::Engine {
                model: manifest.file.clone(),
                engine: segmenter.name().to_owned(),
                detail: error.to_string(),
            })?;
    }
    Ok(())
}

/// The input as the engines state it.
#[cfg(any(feature = "onnx", feature = "rten"))]
fn input_dims(shape: &NetworkShape) -> [usize; 4] {
    [1, 3, shape.height, shape.width]
}

/// The output as the engines state it.
#[cfg(any(feature = "onnx", feature = "rten"))]
fn output_dims(shape: &NetworkShape) -> [usize; 4] {
    [1, shape.classes, shape.out_height, shape.out_width]
}

/// Compares what a model states with what the manifest does; a dimension the model leaves open fits any.
#[cfg(any(feature = "onnx", feature = "rten"))]
fn check_dims(
    manifest: &Manifest,
    table: &'static str,
    stated: [usize; 4],
    found: &[Option<usize>],
) -> Result<(), OpenError> {
    let fits = found.len() == stated.len()
        && (found.iter().zip(stated)).all(|(found, stated)| found.is_none_or(|found| found == stated));
    if fits {
        return Ok(());
    }
    let found: Vec<String> = (found.iter())
        .map(|dim| dim.map_or_else(|| "?".to_owned(), |dim| dim.to_string()))
        .collect();
    Err(OpenError::Shape {
        manifest: manifest.path.clone(),
        table,
        stated: stated.map(|dim| dim.to_string()).join("x"),
        model: manifest.file.clone(),
        found: found.join("x"),
    })
}

/// A name that the manifest gives and the model lacks.
#[cfg(any(feature = "onnx", feature = "rten"))]
fn no_such_name<'a>(
    manifest: &Manifest,
    table: &'static str,
    stated: &str,
    found: impl Iterator<Item = &'a str>,
) -> OpenError {
    let found: Vec<&str> = found.collect();
    OpenError::Shape {
        manifest: manifest.path.clone(),
        table,
        stated: format!("name = \"{stated}\""),
        model: manifest.file.clone(),
        found: format!("only \"{}\"", found.join("\", \"")),
    }
}
