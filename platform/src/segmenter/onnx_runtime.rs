//! The network by ONNX Runtime, whose library is found at run time.
//!
//! In and Out: see [`Segmenter`]. The library is looked for at `ORT_DYLIB_PATH`, then as `.runtime/libonnxruntime.so` above the
//! program and above the current folder, then in the system's folders and `LD_LIBRARY_PATH`; it is loaded once a process.
//! One intra-op thread unless told otherwise (the calling one), threads that sleep instead of spin, an arena that grows by what
//! is asked for (`onnx_arena`), no memory pattern, which would hold a second set of blocks, input and output allocated once: a
//! run makes no Rust allocation and no page fault. What the library itself takes from `malloc` within a run (about 145 small
//! blocks) is freed within it and does not grow.

use std::env;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use ort::environment::Environment;
use ort::memory::Allocator;
use ort::session::builder::GraphOptimizationLevel;
use ort::session::{HasSelectedOutputs, OutputSelector, RunOptions, Session};
use ort::value::{Outlet, Tensor, TensorElementType, ValueType};

use super::{
    Manifest, NetworkShape, OpenError, Segmenter, SegmenterError, Stop, check_dims, input_dims, no_such_name,
    onnx_arena, output_dims,
};

/// Folders above the program or the current one in which `.runtime` is looked for: `target/release/deps` is three deep.
const ANCESTORS: usize = 6;

/// The loaded library; a failure is kept too, for a second attempt would be undefined.
static LIBRARY: OnceLock<Result<Library, String>> = OnceLock::new();

struct Library {
    environment: Environment,
    name: String,
}

/// A session with its input and output.
pub struct OnnxRuntimeSegmenter {
    session: Session,
    input: Tensor<f32>,
    /// The output's name in the model.
    output: String,
    /// Holds the output tensor.
    options: Arc<Options>,
    shape: NetworkShape,
    name: String,
}

/// Options of every run, shared with whoever stops one.
struct Options(RunOptions<HasSelectedOutputs>);

// SAFETY: other threads reach the options through `Stop` only, which sets the library's own termination flag: made to be set
// while a run is under way (`OrtApi::RunOptionsSetTerminate`). The output tensor inside is touched by the segmenter alone.
unsafe impl Sync for Options {}

impl Stop for Options {
    fn stop(&self) {
        // Setting a flag cannot fail.
        let _ = self.0.terminate();
    }
}

impl std::fmt::Debug for OnnxRuntimeSegmenter {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        (formatter.debug_struct("OnnxRuntimeSegmenter"))
            .field("name", &self.name)
            .field("shape", &self.shape)
            .finish_non_exhaustive()
    }
}

impl OnnxRuntimeSegmenter {
    /// Makes a session of the model's bytes and compares it with the manifest.
    ///
    /// # Errors
    /// No library, a model that the library refuses, or one that differs from its manifest.
    pub fn open(manifest: &Manifest, model: &[u8], threads: usize) -> Result<Self, OpenError> {
        let library = match LIBRARY.get_or_init(load_library) {
            Ok(library) => library,
            Err(detail) => {
                return Err(OpenError::Unavailable {
                    engine: "onnx-runtime",
                    detail: detail.clone(),
                });
            }
        };
        let refused = |detail: String| OpenError::Engine {
            model: manifest.file.clone(),
            engine: library.name.clone(),
            detail,
        };
        let session = session(&library.environment, model, threads).map_err(&refused)?;
        let shape = manifest.shape();
        check_outlet(
            manifest,
            "input",
            &manifest.input.name,
            session.inputs(),
            input_dims(&shape),
        )?;
        check_outlet(
            manifest,
            "output",
            &manifest.output.name,
            session.outputs(),
            output_dims(&shape),
        )?;
        if session.inputs().len() != 1 {
            return Err(refused(format!(
                "it has {} inputs, one is expected",
                session.inputs().len()
            )));
        }

        let (input, options) = tensors(manifest, &shape).map_err(|error| refused(error.to_string()))?;
        Ok(Self {
            session,
            input,
            output: manifest.output.name.clone(),
            options: Arc::new(Options(options)),
            shape,
            name: format!("{}, threads: {threads}", library.name),
        })
    }
}

impl Segmenter for OnnxRuntimeSegmenter {
    fn name(&self) -> &str {
        &self.name
    }

    fn shape(&self) -> &NetworkShape {
        &self.shape
    }

    fn run_in_place(
        &mut self,
        fill: &mut dyn FnMut(&mut [f32]),
        read: &mut dyn FnMut(&[f32]),
    ) -> Result<(), SegmenterError> {
        let (_, buffer) = (self.input.try_extract_tensor_mut()).map_err(|_| SegmenterError::Engine)?;
        fill(buffer);
        // An earlier run may have been stopped.
        (self.options.0.unterminate()).map_err(|_| SegmenterError::Engine)?;
        let outputs = (self.session)
            .run_with_options(ort::inputs![&self.input], &self.options.0)
            .map_err(|_| SegmenterError::Engine)?;
        let value = outputs.get(&self.output).ok_or(SegmenterError::Engine)?;
        let (_, probabilities) = value
            .try_extract_tensor::<f32>()
            .map_err(|_| SegmenterError::Engine)?;
        if probabilities.len() != self.shape.output_len() {
            return Err(SegmenterError::Engine);
        }
        read(probabilities);
        Ok(())
    }

    fn stopper(&self) -> Option<Arc<dyn Stop>> {
        Some(Arc::clone(&self.options) as Arc<dyn Stop>)
    }
}

fn session(environment: &Environment, model: &[u8], threads: usize) -> Result<Session, String> {
    let session = || -> Result<Session, ort::Error> {
        let cpu = ort::ep::CPU::default().with_arena_allocator(true).build();
        let mut builder = Session::builder(environment)?
            .with_execution_providers([cpu])?
            .with_optimization_level(GraphOptimizationLevel::All)?
            .with_parallel_execution(false)?
            .with_intra_threads(threads)?
            .with_inter_threads(1)?
            .with_intra_op_spinning(false)?
            .with_inter_op_spinning(false)?
            .with_memory_pattern(false)?
            .with_env_allocators()?;
        builder.commit_from_memory(model)
    };
    session().map_err(|error| error.to_string())
}

fn tensors(
    manifest: &Manifest,
    shape: &NetworkShape,
) -> Result<(Tensor<f32>, RunOptions<HasSelectedOutputs>), ort::Error> {
    let allocator = Allocator::default();
    let input = Tensor::<f32>::new(&allocator, input_dims(shape))?;
    let output = Tensor::<f32>::new(&allocator, output_dims(shape))?;
    let name = &manifest.output.name;
    let outputs = OutputSelector::no_default().with(name).preallocate(name, output);
    Ok((input, RunOptions::new()?.with_outputs(outputs)))
}

fn check_outlet(
    manifest: &Manifest,
    table: &'static str,
    name: &str,
    outlets: &[Outlet],
    stated: [usize; 4],
) -> Result<(), OpenError> {
    let outlet = (outlets.iter().find(|outlet| outlet.name() == name))
        .ok_or_else(|| no_such_name(manifest, table, name, outlets.iter().map(Outlet::name)))?;
    match outlet.dtype() {
        ValueType::Tensor {
            ty: TensorElementType::Float32,
            shape,
            ..
        } => {
            // A negative dimension is one that the model leaves open.
            let found: Vec<Option<usize>> = shape.iter().map(|dim| usize::try_from(*dim).ok()).collect();
            check_dims(manifest, table, stated, &found)
        }
        other => Err(OpenError::Shape {
            manifest: manifest.path.clone(),
            table,
            stated: "float32".to_owned(),
            model: manifest.file.clone(),
            found: format!("{other}"),
        }),
    }
}

/// Keeps ONNX Runtime from telling its makers of its use. From 1.29 on its packages for Linux open a data base and upload from
/// threads of their own, ten seconds after the start; the switch of its interface comes too late for that, this variable does not.
///
/// To be called first in `main`, before any other thread: the environment is the whole process's.
pub fn forbid_telemetry() {
    // SAFETY: no other thread runs yet that could read the environment; the caller keeps that.
    unsafe { env::set_var("ORT_DISABLE_TELEMETRY", "1") };
}

fn load_library() -> Result<Library, String> {
    let path = find_library()?;
    let builder = ort::init_from(&path).map_err(|error| error.to_string())?;
    let mut environment = (builder.with_name("freespace").with_telemetry(false).build())
        .map_err(|error| format!("{}: {error}", path.display()))?;
    onnx_arena::register(&mut environment)
        .map_err(|call| format!("{}: {call} failed: a newer library is needed", path.display()))?;
    Ok(Library {
        environment,
        name: format!(
            "ONNX Runtime {} ({})",
            version_of(&path, ort::info()),
            path.display()
        ),
    })
}

/// The version in the file's name, `libonnxruntime.so.1.31.1`, else the commit it was built from.
fn version_of(path: &Path, build_info: &str) -> String {
    let file = path.file_name().unwrap_or_default().to_string_lossy();
    if let Some((_, version)) = file
        .split_once(".so.")
        .filter(|(_, version)| version.contains('.'))
    {
        return version.to_owned();
    }
    let commit = (build_info.split("git-commit-id=").nth(1)).and_then(|rest| rest.split(',').next());
    commit.map_or_else(
        || "of unknown version".to_owned(),
        |commit| format!("built from {}", commit.trim()),
    )
}

/// The first library that exists, or the places that have none.
fn find_library() -> Result<PathBuf, String> {
    if let Some(path) = env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty()) {
        let path = PathBuf::from(path);
        return (path.canonicalize()).map_err(|error| format!("ORT_DYLIB_PATH={}: {error}", path.display()));
    }
    let here = env::current_dir().ok();
    let program = env::current_exe().ok();
    candidates(here.as_deref(), program.as_deref())
        .into_iter()
        .find_map(|path| path.canonicalize().ok())
        .ok_or_else(|| "no .runtime folder and no system folder holds its library".to_owned())
}

fn candidates(here: Option<&Path>, program: Option<&Path>) -> Vec<PathBuf> {
    let file = format!(
        "{}onnxruntime{}",
        env::consts::DLL_PREFIX,
        env::consts::DLL_SUFFIX
    );
    let fetched = (program
        .into_iter()
        .flat_map(|path| path.ancestors().skip(1).take(ANCESTORS)))
    .chain(here.into_iter().flat_map(|path| path.ancestors().take(ANCESTORS)))
    .map(|folder| folder.join(".runtime").join(&file));
    let listed = env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
    let multiarch = format!("/usr/lib/{}-linux-gnu", env::consts::ARCH);
    let system = env::split_paths(&listed)
        .filter(|folder| folder.is_absolute())
        .chain(
            ["/usr/local/lib", "/usr/lib", "/usr/lib64", "/opt/onnxruntime/lib"]
                .map(PathBuf::from)
                .into_iter()
                .chain([PathBuf::from(multiarch)]),
        )
        .flat_map(|folder| [folder.join(&file), folder.join(format!("{file}.1"))]);
    fetched.chain(system).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn the_fetched_library_comes_before_the_systems() {
        let paths = candidates(
            Some(Path::new("/home/driver/recordings")),
            Some(Path::new("/build/target/release/freespace")),
        );
        let of = |path: &str| paths.iter().position(|other| other == Path::new(path)).unwrap();
        let beside = of("/build/target/release/.runtime/libonnxruntime.so");
        let workspace = of("/build/.runtime/libonnxruntime.so");
        let here = of("/home/driver/recordings/.runtime/libonnxruntime.so");
        let system = of("/usr/lib/libonnxruntime.so");
        assert!(beside < workspace && workspace < here && here < system);
    }

    #[test]
    fn the_version_is_that_of_the_file_or_of_the_build() {
        let info = "ORT Build Info: git-branch=HEAD, git-commit-id=26250ae, build type=Release";
        let versioned = Path::new("/opt/.runtime/libonnxruntime.so.1.31.1");
        assert_eq!(version_of(versioned, info), "1.31.1");
        assert_eq!(
            version_of(Path::new("/usr/lib/libonnxruntime.so"), info),
            "built from 26250ae"
        );
    }
}
