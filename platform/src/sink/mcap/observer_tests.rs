#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::mpsc::sync_channel;

use freespace::crf::CrfConfig;
use freespace::deadline::Slices;
use freespace::frame::{BrownConrady, Lens};
use freespace::grid::GridConfig;
use freespace::map::MapConfig;
use freespace::pipeline::{Cadence, FrameOutcome, PipelineConfig};
use freespace::priors::PriorsConfig;
use freespace::segmentation::ColourConfig;
use freespace::space::{Micros, Mount, Pose};
use freespace::track::{FrameEstimate, TrackConfig};

use super::*;
use crate::runtime::Event;
use crate::runtime::memory::MemoryPlan;

/// What was seen, in its order.
#[derive(Default)]
struct Seen(Vec<&'static str>);

impl Observer for Seen {
    fn started(&mut self, _: &Start<'_>) {
        self.0.push("started");
    }

    fn frame(&mut self, _: &FrameReport) {
        self.0.push("frame");
    }

    fn publication(&mut self, _: &Publication) {
        self.0.push("publication");
    }

    fn key_frame(&mut self, _: &KeyFrameReport<'_>) {
        self.0.push("key_frame");
    }

    fn trace(&mut self, _: &Trace) {
        self.0.push("trace");
    }

    fn last_word(&mut self, _: &KeyFrameOutput) {
        self.0.push("last_word");
    }

    fn status(&mut self, _: &Status) {
        self.0.push("status");
    }
}

fn pipeline() -> PipelineConfig {
    PipelineConfig {
        camera: Camera {
            lens: Lens::BrownConrady(BrownConrady {
                fx: 80.0,
                fy: 80.0,
                cx: 80.0,
                cy: 60.0,
                ..BrownConrady::default()
            }),
            width: 160,
            height: 120,
            mount: Mount {
                height_m: 1.4,
                ahead_m: 0.0,
                left_m: 0.0,
                pitch_rad: 0.0,
                yaw_rad: 0.0,
                roll_rad: 0.0,
            },
        },
        working_size: (160, 120),
        wheels: None,
        cadence: Cadence::OnDemand,
        slices: Slices::default(),
        track: TrackConfig::default(),
        map: MapConfig::default(),
        priors: PriorsConfig::default(),
        colour: ColourConfig::default(),
        crf: CrfConfig::default(),
        grid: GridConfig::default(),
    }
}

fn output(config: &PipelineConfig) -> Box<KeyFrameOutput> {
    let mut output = KeyFrameOutput::new(config);
    let frame = CanFrame {
        id: 0x123,
        extended: false,
        data: heapless::Vec::from_slice(&[0xab, 0xcd]).unwrap(),
    };
    output.can_frames.push(frame).unwrap();
    output
}

/// Shows an observer one of everything.
fn show_all(observer: &mut dyn Observer, output: &KeyFrameOutput) {
    observer.started(&Start {
        plan: &MemoryPlan::new(),
        lacks: &[],
    });
    observer.frame(&FrameReport {
        index: 0,
        stamp: Micros(1),
        outcome: FrameOutcome {
            estimate: FrameEstimate {
                stamp: Micros(1),
                world_from_camera: Pose::identity(),
                state: freespace::health::TrackingState::Good,
                tracks: 0,
                inliers: 0,
                travel: None,
            },
            fault: None,
            is_key_frame: false,
            micros: 1,
        },
        learnt: None,
    });
    observer.publication(&Publication::of(output));
    observer.key_frame(&KeyFrameReport {
        index: 0,
        job: None,
        output,
    });
    observer.trace(&Trace {
        at: Micros(1),
        event: Event::JobDisplaced(1),
    });
    observer.status(&Status::default());
    observer.last_word(output);
}

const ALL: [&str; 7] = [
    "started",
    "frame",
    "publication",
    "key_frame",
    "trace",
    "status",
    "last_word",
];

#[test]
fn everything_is_handed_on_and_the_last_word_is_noted_too() {
    let pipeline = pipeline();
    let output = output(&pipeline);
    let mut seen = Seen::default();
    show_all(&mut Noted::not(&mut seen), &output);
    assert_eq!(seen.0, ALL);
    let (notes, noted) = sync_channel(100);
    let (rows, columns, cell_m) = pipeline.grid.size();
    let taker = NoteTaker {
        notes,
        counters: Arc::default(),
        camera: pipeline.camera,
        layout: GridLayout {
            rows,
            columns,
            cell_m: f64::from(cell_m),
            origin_in_vehicle_m: [0.0, 0.0],
        },
    };
    let mut seen = Seen::default();
    let mut observer = Noted {
        taker: Some(&taker),
        inner: &mut seen,
        unreported: 0,
    };
    show_all(&mut observer, &output);
    // What never came to the observer is not in the recording, which says so.
    let status = |unreported| {
        let mut status = Status::default();
        status.drops.unreported = Some(unreported);
        status
    };
    for unreported in [2, 2, 5] {
        observer.status(&status(unreported));
    }
    assert_eq!(taker.counters.losses().dropped_messages, 5);
    assert_eq!(seen.0[..ALL.len()], ALL);
    let last: Note = noted.try_iter().last().unwrap();
    assert_eq!(last.topic, Topic::CanOut);
    assert!(String::from_utf8(last.data).unwrap().contains("\"ABCD\""));
}
