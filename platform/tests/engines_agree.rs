//! The shipped network gives the same answer whichever engine runs it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::path::Path;
use std::time::Instant;

use freespace_platform::runtime::allocation::{CountingAllocator, RealTimeScope};
use freespace_platform::segmenter::{EngineChoice, Manifest, OpenError, open};

#[global_allocator]
static COUNTING: CountingAllocator = CountingAllocator;

/// Largest difference of a probability: the engines add in different orders.
const AGREEMENT: f32 = 1e-3;
const RUNS: usize = 20;

#[test]
fn the_shipped_network_answers_alike_in_every_engine() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/road.toml");
    if !path.exists() {
        eprintln!(
            "SKIPPED the_shipped_network_answers_alike_in_every_engine: {} is absent",
            path.display()
        );
        return;
    }
    let manifest = Manifest::load(&path).unwrap_or_else(|error| panic!("{error}"));
    let shape = manifest.shape();
    // Normalised pixels lie within a few units of zero.
    let input: Vec<f32> = (0..shape.input_len())
        .map(|at| (at * 7919 % 10_007) as f32 / 2500.0 - 2.0)
        .collect();

    let mut answers: Vec<Vec<f32>> = Vec::new();
    for choice in [EngineChoice::Rten, EngineChoice::OnnxRuntime] {
        let mut segmenter = match open(&manifest, choice, 1) {
            Ok(segmenter) => segmenter,
            Err(OpenError::Unavailable { engine, detail }) => {
                eprintln!("SKIPPED engine {engine}: {detail}");
                continue;
            }
            Err(error) => panic!("{error}"),
        };
        let mut answer = vec![0.0; shape.output_len()];
        segmenter.run(&input, &mut answer).unwrap();
        let first = answer.clone();
        let scope = RealTimeScope::enter();
        let mut micros = [0; RUNS];
        for time in &mut micros {
            let start = Instant::now();
            segmenter.run(&input, &mut answer).unwrap();
            *time = start.elapsed().as_micros();
        }
        let allocations = scope.allocations();
        drop(scope);
        micros.sort_unstable();
        println!(
            "{}: median {} us, least {} us, {allocations} allocations of the caller in {RUNS} runs",
            segmenter.name(),
            micros[RUNS / 2],
            micros[0]
        );
        assert_eq!(first, answer, "the same input gave another answer");
        if choice == EngineChoice::OnnxRuntime {
            assert_eq!(allocations, 0);
        }
        let pixels = shape.out_width * shape.out_height;
        for pixel in 0..pixels {
            let sum: f32 = (0..shape.classes)
                .map(|class| answer[class * pixels + pixel])
                .sum();
            assert!(
                (sum - 1.0).abs() < 1e-3,
                "the classes of pixel {pixel} add up to {sum}"
            );
        }
        answers.push(answer);
    }
    if let [one, other] = &answers[..] {
        let difference = one
            .iter()
            .zip(other)
            .map(|(one, other)| (one - other).abs())
            .fold(0.0, f32::max);
        println!("largest difference {difference:e}");
        assert!(difference < AGREEMENT, "{difference}");
    }
}
