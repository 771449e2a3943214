//! One thread, one step after the other: the same input gives the same output, byte for byte.

use std::time::Instant;

use freespace::pipeline::{EmitTask, FrameTask, KeyFrameJob, KeyFrameOutput, KeyFrameTask, Lesson, Pace};
use freespace::port::{CameraAnswer, FrameBuffer};

use super::allocation::{RealTimeScope, allocations};
use super::{
    FrameReport, InlineNetwork, KeyFrameReport, Observer, RunSummary, Setup, WHEEL_LOOKAHEAD_MICROS,
};
use crate::clock::MonotonicClock;

/// Runs until the camera ends.
///
/// The clock serves to measure only: nothing is decided by it.
pub fn run_in_lockstep(setup: Setup, observer: &mut dyn Observer) -> RunSummary {
    let Setup { config, mut devices } = setup;
    let clock = MonotonicClock::default();
    let mut network = InlineNetwork::new(devices.segmenter, &config, &devices.tiles);
    let mut frame_task = FrameTask::new(&config);
    let mut key_frame_task = KeyFrameTask::new(&config, Pace::Reproducible);
    let mut job = KeyFrameJob::new(config.camera.width, config.camera.height);
    let mut output = KeyFrameOutput::new(&config);
    let mut lesson = Lesson::new();
    let mut emit = EmitTask::new(&config.camera, &config.slices);
    let mut buffer = FrameBuffer::default();
    let mut summary = RunSummary::default();
    let allocations_before = allocations();
    loop {
        match devices.camera.next_frame(&mut buffer) {
            CameraAnswer::End => break,
            CameraAnswer::Lost => {
                summary.dropped_frames += 1;
                continue;
            }
            CameraAnswer::Frame => {}
        }
        let begin = Instant::now();
        let stepped = {
            let _scope = RealTimeScope::enter();
            if let Some(wheels) = &mut devices.wheels {
                let until = buffer.stamp.plus(WHEEL_LOOKAHEAD_MICROS);
                wheels.readings_until(until, &mut |reading| frame_task.wheel(reading));
            }
            frame_task.step(&buffer.raw(), buffer.key_frame_wanted, &mut job, &clock)
        };
        let Ok(outcome) = stepped else {
            summary.dropped_frames += 1;
            continue;
        };
        summary.frames += 1;
        observer.frame(&FrameReport {
            index: buffer.index,
            stamp: buffer.stamp,
            outcome,
        });
        if !outcome.is_key_frame {
            continue;
        }
        {
            let _scope = RealTimeScope::enter();
            key_frame_task.step(&job, &mut network, &clock, &mut output, &mut lesson);
            // On this replay's own clock the work takes no time: the message leaves at its capture.
            let publish = output.stamp;
            emit.step(&mut output, publish, &clock);
            frame_task.learn(&lesson);
        }
        summary.key_frames += 1;
        let latency_micros = u64::try_from(begin.elapsed().as_micros()).unwrap_or(u64::MAX);
        observer.key_frame(&KeyFrameReport {
            index: buffer.index,
            job: Some(&job),
            output: &output,
            latency_micros,
            is_miss: false,
        });
        FrameTask::recycle(&mut job);
    }
    summary.allocations_after_start = allocations() - allocations_before;
    summary
}
