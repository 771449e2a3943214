//! What every engine promises, tried on a small network whose answer is known.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::cast_possible_truncation,
    reason = "tests"
)]

use std::fs;
use std::path::PathBuf;

use sha2::{Digest, Sha256};

use super::{EngineChoice, Manifest, OpenError, Segmenter, SegmenterError, open};
use crate::runtime::allocation::RealTimeScope;

/// `Softmax(Conv1x1(x))`, 3 to 4 channels, 8x6 pixels, opset 13; weights `[c][k] = 0.1 * (c + 1) * (k - 1)`.
const HEIGHT: usize = 6;
const WIDTH: usize = 8;
const CLASSES: usize = 4;

/// A scratch folder of one test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("freespace-segmenter-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    /// A model with its manifest, both described by the test.
    fn manifest(&self, model: &[u8], edit: impl Fn(String) -> String) -> Manifest {
        fs::write(self.0.join("tiny.onnx"), model).unwrap();
        let sum: String = Sha256::digest(model)
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        let text = format!(
            "name = \"tiny\"\nfile = \"tiny.onnx\"\nsha256 = \"{sum}\"\n\
             [input]\nname = \"image\"\nwidth = {WIDTH}\nheight = {HEIGHT}\norder = \"rgb\"\nmean = [0, 0, 0]\nscale = [1, 1, 1]\n\
             [output]\nname = \"probabilities\"\nwidth = {WIDTH}\nheight = {HEIGHT}\n\
             [classes]\nnames = [\"a\", \"b\", \"c\", \"d\"]\nroad = [\"b\"]\n"
        );
        let path = self.0.join("tiny.toml");
        fs::write(&path, edit(text)).unwrap();
        Manifest::load(&path).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn weight(class: usize, channel: usize) -> f32 {
    0.1 * (class as f32 + 1.0) * (channel as f32 - 1.0)
}

/// The wire format of ONNX, as far as the tiny network needs it.
mod wire {
    pub(super) fn varint(field: u32, value: u64) -> Vec<u8> {
        let mut bytes = raw(u64::from(field << 3));
        bytes.extend(raw(value));
        bytes
    }

    pub(super) fn bytes(field: u32, content: &[u8]) -> Vec<u8> {
        let mut bytes = raw(u64::from(field << 3 | 2));
        bytes.extend(raw(content.len() as u64));
        bytes.extend(content);
        bytes
    }

    fn raw(mut value: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while value > 0x7f {
            bytes.push((value & 0x7f) as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
        bytes
    }

    pub(super) fn node(op: &str, inputs: &[&str], output: &str, attribute: &[u8]) -> Vec<u8> {
        let mut node = Vec::new();
        for input in inputs {
            node.extend(bytes(1, input.as_bytes()));
        }
        node.extend(bytes(2, output.as_bytes()));
        node.extend(bytes(3, output.as_bytes()));
        node.extend(bytes(4, op.as_bytes()));
        node.extend(attribute);
        bytes(1, &node)
    }

    pub(super) fn ints(name: &str, values: &[u64]) -> Vec<u8> {
        let mut attribute = bytes(1, name.as_bytes());
        for value in values {
            attribute.extend(varint(8, *value));
        }
        attribute.extend(varint(20, 7));
        bytes(5, &attribute)
    }

    pub(super) fn value(field: u32, name: &str, dims: &[u64]) -> Vec<u8> {
        let dims: Vec<u8> = dims.iter().flat_map(|dim| bytes(1, &varint(1, *dim))).collect();
        let tensor = [varint(1, 1), bytes(2, &dims)].concat();
        bytes(
            field,
            &[bytes(1, name.as_bytes()), bytes(2, &bytes(1, &tensor))].concat(),
        )
    }
}

fn tiny_model() -> Vec<u8> {
    let (h, w, c) = (HEIGHT as u64, WIDTH as u64, CLASSES as u64);
    let weights: Vec<u8> = (0..CLASSES)
        .flat_map(|class| (0..3).flat_map(move |channel| weight(class, channel).to_le_bytes()))
        .collect();
    let initializer = [
        wire::varint(1, c),
        wire::varint(1, 3),
        wire::varint(1, 1),
        wire::varint(1, 1),
        wire::varint(2, 1),
        wire::bytes(8, b"weights"),
        wire::bytes(9, &weights),
    ];
    let convolution = [
        wire::ints("kernel_shape", &[1, 1]),
        wire::ints("strides", &[1, 1]),
        wire::ints("dilations", &[1, 1]),
        wire::ints("pads", &[0, 0, 0, 0]),
    ]
    .concat();
    let axis = [wire::bytes(1, b"axis"), wire::varint(3, 1), wire::varint(20, 2)].concat();
    let graph = [
        wire::node("Conv", &["image", "weights"], "scores", &convolution),
        wire::node("Softmax", &["scores"], "probabilities", &wire::bytes(5, &axis)),
        wire::bytes(2, b"tiny"),
        wire::bytes(5, &initializer.concat()),
        wire::value(11, "image", &[1, 3, h, w]),
        wire::value(12, "probabilities", &[1, c, h, w]),
    ];
    let opset = [wire::bytes(1, b""), wire::varint(2, 13)].concat();
    [
        wire::varint(1, 7),
        wire::bytes(7, &graph.concat()),
        wire::bytes(8, &opset),
    ]
    .concat()
}

fn input() -> Vec<f32> {
    (0..3 * HEIGHT * WIDTH)
        .map(|at| (at * 37 % 101) as f32 / 50.0 - 1.0)
        .collect()
}

fn expected(input: &[f32]) -> Vec<f32> {
    let pixels = HEIGHT * WIDTH;
    let mut output = vec![0.0; CLASSES * pixels];
    for pixel in 0..pixels {
        let scores: [f32; CLASSES] = std::array::from_fn(|class| {
            let score: f32 = (0..3)
                .map(|channel| weight(class, channel) * input[channel * pixels + pixel])
                .sum();
            score.exp()
        });
        for class in 0..CLASSES {
            output[class * pixels + pixel] = scores[class] / scores.iter().sum::<f32>();
        }
    }
    output
}

/// The engines that can be tried here; one that is absent is named.
fn each_engine(manifest: &Manifest, mut try_it: impl FnMut(EngineChoice, Box<dyn Segmenter>)) {
    for choice in [EngineChoice::Rten, EngineChoice::OnnxRuntime] {
        match open(manifest, choice, 1) {
            Ok(segmenter) => try_it(choice, segmenter),
            Err(OpenError::Unavailable { engine, detail }) => eprintln!("SKIPPED engine {engine}: {detail}"),
            Err(error) => panic!("{error}"),
        }
    }
}

#[test]
fn every_engine_gives_the_known_answer_again_and_again() {
    let folder = Folder::new("answer");
    let manifest = folder.manifest(&tiny_model(), |text| text);
    each_engine(&manifest, |choice, mut segmenter| {
        let input = input();
        let mut output = vec![0.0; segmenter.shape().output_len()];
        segmenter.run(&input, &mut output).unwrap();
        for (found, expected) in output.iter().zip(expected(&input)) {
            assert!((found - expected).abs() < 1e-5, "{choice:?}: {found} {expected}");
        }
        let first = output.clone();
        let other: Vec<f32> = input.iter().map(|value| -value).collect();
        segmenter.run(&other, &mut output).unwrap();
        assert_ne!(first, output);
        segmenter.run(&input, &mut output).unwrap();
        assert_eq!(first, output, "{choice:?}");
    });
}

#[test]
fn a_wrong_length_is_an_error_not_a_panic() {
    let folder = Folder::new("length");
    let manifest = folder.manifest(&tiny_model(), |text| text);
    each_engine(&manifest, |_, mut segmenter| {
        let (input, mut output) = (input(), vec![0.0; segmenter.shape().output_len()]);
        assert_eq!(
            segmenter.run(&input[1..], &mut output),
            Err(SegmenterError::InputLength)
        );
        assert_eq!(
            segmenter.run(&input, &mut output[1..]),
            Err(SegmenterError::OutputLength)
        );
        assert_eq!(segmenter.run(&input, &mut output), Ok(()));
    });
}

#[test]
fn onnx_runtime_runs_without_a_rust_allocation() {
    let folder = Folder::new("allocation");
    let manifest = folder.manifest(&tiny_model(), |text| text);
    each_engine(&manifest, |choice, mut segmenter| {
        let (input, mut output) = (input(), vec![0.0; segmenter.shape().output_len()]);
        let scope = RealTimeScope::enter();
        for _ in 0..10 {
            segmenter.run(&input, &mut output).unwrap();
        }
        let allocations = scope.allocations();
        eprintln!("{}: {allocations} allocations in 10 runs", segmenter.name());
        if choice == EngineChoice::OnnxRuntime {
            assert_eq!(allocations, 0);
        }
    });
}

#[test]
fn a_model_unlike_its_manifest_is_refused_by_name() {
    let cases = [
        (
            "width = 8\nheight = 6\norder",
            "width = 16\nheight = 6\norder",
            "[input]",
            "1x3x6x16",
            "1x3x6x8",
        ),
        (
            "width = 8\nheight = 6\n[classes]",
            "width = 8\nheight = 3\n[classes]",
            "[output]",
            "1x4x3x8",
            "1x4x6x8",
        ),
        ("\"c\", \"d\"", "\"c\"", "[output]", "1x3x6x8", "1x4x6x8"),
        (
            "name = \"image\"",
            "name = \"picture\"",
            "[input]",
            "picture",
            "image",
        ),
        (
            "name = \"probabilities\"",
            "name = \"logits\"",
            "[output]",
            "logits",
            "probabilities",
        ),
    ];
    let folder = Folder::new("unlike");
    for (from, to, table, stated, found) in cases {
        let manifest = folder.manifest(&tiny_model(), |text| text.replacen(from, to, 1));
        for choice in [EngineChoice::Rten, EngineChoice::OnnxRuntime] {
            match open(&manifest, choice, 1) {
                Err(OpenError::Unavailable { engine, detail }) => {
                    eprintln!("SKIPPED engine {engine}: {detail}")
                }
                Err(error @ OpenError::Shape { .. }) => {
                    let message = error.to_string();
                    for word in ["tiny.toml", "tiny.onnx", table, stated, found] {
                        assert!(message.contains(word), "{choice:?}: {word} is not in: {message}");
                    }
                }
                other => panic!(
                    "{choice:?}, {from}: {:?}",
                    other.map(|segmenter| segmenter.shape().clone())
                ),
            }
        }
    }
}

#[test]
fn bytes_that_are_no_model_are_refused() {
    let folder = Folder::new("garbage");
    let manifest = folder.manifest(b"this is no network", |text| text);
    let error = open(&manifest, EngineChoice::Auto, 1).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("tiny.onnx"), "{error}");
}

#[test]
fn the_automatic_choice_tells_its_engine() {
    let folder = Folder::new("auto");
    let manifest = folder.manifest(&tiny_model(), |text| text);
    let segmenter = open(&manifest, EngineChoice::Auto, 1).unwrap();
    let name = segmenter.name();
    assert!(
        name.starts_with("ONNX Runtime") || name.contains("ONNX Runtime is not available"),
        "{name}"
    );
}
