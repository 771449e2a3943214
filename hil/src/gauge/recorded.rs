//! Stands in for the network: its answers, recorded in their order.

use std::sync::{Arc, Mutex, PoisonError};

use freespace::segmentation::NetworkShape;
use freespace_platform::segmenter::{Segmenter, SegmenterError};

/// Gives the recorded answers; begins again after the last.
pub(super) struct RecordedNetwork {
    shape: NetworkShape,
    input: Vec<f32>,
    answers: Arc<Vec<Vec<f32>>>,
    next: usize,
}

impl RecordedNetwork {
    pub(super) fn new(shape: NetworkShape, answers: Arc<Vec<Vec<f32>>>) -> Self {
        Self {
            input: vec![0.0; shape.input_len()],
            shape,
            answers,
            next: 0,
        }
    }
}

impl Segmenter for RecordedNetwork {
    fn name(&self) -> &str {
        "recorded"
    }

    fn shape(&self) -> &NetworkShape {
        &self.shape
    }

    fn run_in_place(
        &mut self,
        fill: &mut dyn FnMut(&mut [f32]),
        read: &mut dyn FnMut(&[f32]),
    ) -> Result<(), SegmenterError> {
        fill(&mut self.input);
        let answer = self
            .answers
            .get(self.next % self.answers.len().max(1))
            .ok_or(SegmenterError::Engine)?;
        self.next += 1;
        read(answer);
        Ok(())
    }
}

/// Keeps every answer of a network.
pub(super) struct Recording {
    pub(super) inner: Box<dyn Segmenter>,
    pub(super) answers: Arc<Mutex<Vec<Vec<f32>>>>,
}

impl Segmenter for Recording {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn shape(&self) -> &NetworkShape {
        self.inner.shape()
    }

    fn run_in_place(
        &mut self,
        fill: &mut dyn FnMut(&mut [f32]),
        read: &mut dyn FnMut(&[f32]),
    ) -> Result<(), SegmenterError> {
        let answers = &self.answers;
        self.inner.run_in_place(fill, &mut |answer| {
            answers
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(answer.to_vec());
            read(answer);
        })
    }
}
