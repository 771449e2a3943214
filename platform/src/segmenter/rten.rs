//! The network by rten, an engine in pure Rust, where ONNX Runtime's library is absent.
//!
//! In and Out: see [`Segmenter`]. Weights are packed once. Its API takes no output buffer: a run allocates, from a pool that
//! lives within the run, and works on its own threads, which do not inherit the caller's priority. It is the engine of
//! development machines and demonstrations; a car runs ONNX Runtime.

use std::sync::Arc;

use rten::{Dimension, Model, ModelOptions, NodeId, RunOptions, ThreadPool, Value, ValueView};

use super::{
    Manifest, NetworkShape, OpenError, Segmenter, SegmenterError, check_dims, input_dims, no_such_name,
    output_dims,
};

/// A loaded model with its threads.
pub struct RtenSegmenter {
    model: Model,
    input: NodeId,
    output: NodeId,
    options: RunOptions,
    /// The input, `[3, H, W]`.
    buffer: Box<[f32]>,
    shape: NetworkShape,
    name: String,
}

impl std::fmt::Debug for RtenSegmenter {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        (formatter.debug_struct("RtenSegmenter"))
            .field("name", &self.name)
            .field("shape", &self.shape)
            .finish_non_exhaustive()
    }
}

impl RtenSegmenter {
    /// Loads the model's bytes and compares them with the manifest; `why` this engine goes into the name.
    ///
    /// # Errors
    /// A model that rten refuses, or one that differs from its manifest.
    pub fn open(manifest: &Manifest, model: Vec<u8>, threads: usize, why: &str) -> Result<Self, OpenError> {
        let mut options = ModelOptions::with_all_ops();
        options.prepack_weights(true);
        let model = options.load(model).map_err(|error| OpenError::Engine {
            model: manifest.file.clone(),
            engine: "rten".to_owned(),
            detail: error.to_string(),
        })?;
        let shape = manifest.shape();
        let (input_name, output_name) = (&manifest.input.name, &manifest.output.name);
        let input = find(manifest, &model, "input", input_name, model.input_ids())?;
        let output = find(manifest, &model, "output", output_name, model.output_ids())?;
        check_node(manifest, &model, "input", input, input_dims(&shape))?;
        check_node(manifest, &model, "output", output, output_dims(&shape))?;

        let pool = Arc::new(ThreadPool::with_num_threads(threads));
        let segmenter = Self {
            model,
            input,
            output,
            options: RunOptions::default().with_thread_pool(Some(pool)),
            buffer: vec![0.0; shape.input_len()].into_boxed_slice(),
            shape,
            name: format!("rten ({why}), threads: {threads}"),
        };
        segmenter.check_answer(manifest)?;
        Ok(segmenter)
    }

    /// The model may leave its output's size open: only an answer shows it.
    fn check_answer(&self, manifest: &Manifest) -> Result<(), OpenError> {
        let answer =
            (self.answer(&vec![0.0; self.shape.input_len()])).map_err(|detail| OpenError::Engine {
                model: manifest.file.clone(),
                engine: "rten".to_owned(),
                detail,
            })?;
        let (dims, _) = (answer.into_shape_vec::<f32, 4>()).map_err(|error| OpenError::Shape {
            manifest: manifest.path.clone(),
            table: "output",
            stated: "float32 of 4 dimensions".to_owned(),
            model: manifest.file.clone(),
            found: error.to_string(),
        })?;
        check_dims(manifest, "output", output_dims(&self.shape), &dims.map(Some))
    }

    fn answer(&self, input: &[f32]) -> Result<Value, String> {
        let input =
            ValueView::from_shape(input_dims(&self.shape), input).map_err(|error| error.to_string())?;
        let answer = self.model.run_n(
            vec![(self.input, input.into())],
            [self.output],
            Some(self.options.clone()),
        );
        answer.map(|[value]| value).map_err(|error| error.to_string())
    }
}

impl Segmenter for RtenSegmenter {
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
        fill(&mut self.buffer);
        let answer = self.answer(&self.buffer).map_err(|_| SegmenterError::Engine)?;
        let (_, probabilities) = (answer.into_shape_vec::<f32, 4>()).map_err(|_| SegmenterError::Engine)?;
        if probabilities.len() != self.shape.output_len() {
            return Err(SegmenterError::Engine);
        }
        read(&probabilities);
        Ok(())
    }
}

fn find(
    manifest: &Manifest,
    model: &Model,
    table: &'static str,
    name: &str,
    ids: &[NodeId],
) -> Result<NodeId, OpenError> {
    let name_of = |id: &NodeId| model.node_info(*id).and_then(|info| info.name());
    (ids.iter().copied().find(|id| name_of(id) == Some(name)))
        .ok_or_else(|| no_such_name(manifest, table, name, ids.iter().filter_map(name_of)))
}

fn check_node(
    manifest: &Manifest,
    model: &Model,
    table: &'static str,
    node: NodeId,
    stated: [usize; 4],
) -> Result<(), OpenError> {
    // Without a stated shape the answer of the first run decides.
    let Some(dims) = model.node_info(node).and_then(|info| info.shape()) else {
        return Ok(());
    };
    let found: Vec<Option<usize>> = (dims.iter())
        .map(|dim| match dim {
            Dimension::Fixed(size) => Some(*size),
            Dimension::Symbolic(_) => None,
        })
        .collect();
    check_dims(manifest, table, stated, &found)
}
