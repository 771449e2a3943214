//! The network, timed as a run would run it.

use std::io;
use std::time::Instant;

use super::Check;
use crate::runtime::rights::{RealTimeConfig, ThreadRole, enter, thread_builder};
use crate::segmenter::Segmenter;

/// How long the network takes for a key frame.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct NetworkTiming {
    /// Half of the runs took less.
    pub median_ms: f64,
    /// The slowest.
    pub max_ms: f64,
}

/// Runs timed; the first ones are the warm-up's.
const RUNS: usize = 30;

/// Runs the network as a live run does, on a thread of its role, `tiles` times for a key frame; `slice_micros` is what it has.
///
/// # Errors
/// The thread could not be started.
pub fn network(
    segmenter: &mut dyn Segmenter,
    tiles: usize,
    slice_micros: u64,
    config: &RealTimeConfig,
) -> io::Result<(Check, Option<NetworkTiming>)> {
    const NAME: &str = "network";
    let engine = segmenter.name().to_owned();
    let timing = std::thread::scope(|scope| {
        let thread = thread_builder(ThreadRole::Network, config).spawn_scoped(scope, || {
            let _ = enter(ThreadRole::Network, config);
            time(segmenter, tiles)
        })?;
        // An engine that panics is one that does not answer.
        Ok::<_, io::Error>(thread.join().ok().flatten())
    })?;
    let Some(timing) = timing else {
        return Ok((
            Check::fails(
                NAME,
                format!("{engine}: gives no answer"),
                "run scripts/fetch-onnxruntime.sh, or give another model in [network]",
            ),
            None,
        ));
    };
    Ok((judge(NAME, &engine, timing, slice_micros), Some(timing)))
}

#[expect(clippy::cast_precision_loss, reason = "milliseconds")]
fn judge(name: &'static str, engine: &str, timing: NetworkTiming, slice_micros: u64) -> Check {
    let slice_ms = slice_micros as f64 * 1e-3;
    let seen = format!(
        "{:.1} ms a key frame (slowest of {RUNS}: {:.1}) of at most {slice_ms:.0}; {engine}",
        timing.median_ms, timing.max_ms
    );
    if timing.median_ms > slice_ms {
        return Check::fails(
            name,
            seen,
            "fewer tiles or a smaller model in [network]; scripts/fetch-onnxruntime.sh fetches the faster engine",
        );
    }
    if !engine.starts_with("ONNX Runtime") {
        return Check::warning(
            name,
            seen,
            "scripts/fetch-onnxruntime.sh fetches the faster engine, which allocates nothing",
        );
    }
    if timing.max_ms > slice_ms {
        return Check::warning(
            name,
            seen,
            "stop what else runs on these cores, or bind the threads to cores",
        );
    }
    Check::ok(name, seen)
}

fn time(segmenter: &mut dyn Segmenter, tiles: usize) -> Option<NetworkTiming> {
    let input = vec![0.0; segmenter.shape().input_len()];
    let mut output = vec![0.0; segmenter.shape().output_len()];
    let mut times_ms = Vec::with_capacity(RUNS);
    for _ in 0..RUNS {
        let begin = Instant::now();
        for _ in 0..tiles {
            segmenter.run(&input, &mut output).ok()?;
        }
        times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    Some(NetworkTiming {
        median_ms: times_ms[RUNS / 2],
        max_ms: times_ms[RUNS - 1],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::State;

    #[test]
    fn a_network_is_judged_by_its_slice_and_its_engine() {
        let judge = |engine, median_ms, max_ms| {
            judge("network", engine, NetworkTiming { median_ms, max_ms }, 170_000).state
        };
        assert_eq!(judge("ONNX Runtime 1.31.1", 12.0, 14.0), State::Ok);
        assert_eq!(judge("ONNX Runtime 1.31.1", 12.0, 171.0), State::Warning);
        assert_eq!(
            judge("rten (ONNX Runtime is not available)", 42.0, 50.0),
            State::Warning
        );
        assert_eq!(judge("ONNX Runtime 1.31.1", 171.0, 180.0), State::Fails);
    }
}
