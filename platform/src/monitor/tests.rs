#![allow(clippy::unwrap_used, reason = "tests")]

use freespace::emit::{FreeSpaceMessage, Header, Publication, SharedMessage};
use freespace::grid::Grid;
use freespace::health::{Blame, Faults, QualityLevel, ScaleState, TrackingState};
use freespace::space::Micros;
use freespace::stage::Stage;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::*;
use crate::view::{View, ViewStatus};

/// A module that publishes each half second, without shared memory.
pub(super) struct Stream {
    shared: Box<SharedMessage>,
    grid: Grid,
    sequence: u64,
    pub(super) now: Now,
    pub(super) state: State,
}

impl Stream {
    pub(super) fn new() -> Self {
        let mut grid = Grid::new(40, 24, 0.5);
        // Road on the plane straight ahead, an obstacle at its end, and nothing known to the sides.
        for row in 0..40 {
            for column in 8..16 {
                let cell = row * 24 + column;
                grid.occupancy[cell] = if row < 30 { 5 } else { 95 };
                grid.reason[cell] = if row < 30 { 1 } else { 2 };
                grid.age[cell] = 0;
            }
        }
        Self {
            shared: Box::new(SharedMessage::EMPTY),
            grid,
            sequence: 0,
            now: Now {
                monotonic: Micros(1_000_000),
                unix_ms: 1_700_000_000_000,
            },
            state: State::new("freespace/grid"),
        }
    }

    pub(super) fn good() -> Header {
        Header {
            level: QualityLevel::Full,
            used_micros: 42_000,
            budget_micros: 500_000,
            scale: ScaleState::Wheels,
            tracking: TrackingState::Good,
            speed_mps: 9.5,
            sector_first_rad: -0.8,
            sector_rad: 0.05,
            free_m: [15.0; 32],
            plane_offset_m: 1.4,
            ..Header::default()
        }
    }

    /// The next message.
    pub(super) fn publish(&mut self, header: Header) {
        self.now.monotonic.0 += 500_000;
        self.now.unix_ms += 500;
        let header = Header {
            sequence: self.sequence,
            ..header
        };
        self.sequence += 1;
        let mut bytes = vec![0; FreeSpaceMessage::encoded_len(self.grid.occupancy.len())];
        let publication = Publication {
            header,
            grid: &self.grid,
        };
        publication.encode_into(&mut bytes).unwrap();
        let message = FreeSpaceMessage::decode(&bytes).unwrap();
        self.shared.fill(&message, self.now.monotonic);
        self.state.link(Ok(()));
        self.state.message(&self.shared, self.now);
    }

    pub(super) fn show(&mut self) {
        self.state.view(View {
            status: ViewStatus {
                sequence: self.sequence - 1,
                stage_micros: [1000, 2000, 5000, 4000, 20_000, 6000, 3000, 500],
                frames: 30,
                dropped_frames: 2,
                ..ViewStatus::default()
            },
            picture: b"jpeg".to_vec(),
        });
    }

    /// The view of a key frame that a fallback answered.
    pub(super) fn show_without_picture(&mut self) {
        self.state.view(View {
            status: ViewStatus {
                sequence: self.sequence - 1,
                ..ViewStatus::default()
            },
            picture: Vec::new(),
        });
    }

    /// The module counts from 0 anew.
    pub(super) fn restart(&mut self) {
        self.sequence = 0;
    }

    pub(super) fn snapshot(&self) -> Snapshot {
        Snapshot::of(&self.state, self.now)
    }

    /// The computer's sensors as they are now.
    pub(super) fn warm(&mut self, zones: &[(&str, f64)]) {
        let zones = zones.iter().map(|(name, celsius)| Zone {
            name: (*name).to_owned(),
            celsius: *celsius,
        });
        self.state.temperatures(Temperatures {
            zones: zones.collect(),
            at: self.now.monotonic,
            ..Temperatures::default()
        });
    }

    /// A drive with a network that was too late, and an instant without an answer.
    pub(super) fn with_misses() -> Self {
        let mut stream = Self::new();
        for _ in 0..8 {
            stream.publish(Self::good());
        }
        stream.publish(Header {
            level: QualityLevel::NoFreshNetwork,
            used_micros: 231_000,
            faults: Faults::NETWORK_LATE,
            blame: Some(Blame::Stage(Stage::Segmentation)),
            ..Self::good()
        });
        stream.publish(Header {
            level: QualityLevel::Moved,
            used_micros: 400_000,
            faults: Faults::DEADLINE_MISSED | Faults::CAMERA_SILENT,
            blame: Some(Blame::Camera),
            scale: ScaleState::Held,
            tracking: TrackingState::DeadReckoning,
            ..Self::good()
        });
        stream.show();
        stream.warm(&[("acpitz", 27.8), ("x86_pkg_temp", 61.0)]);
        stream
    }
}

#[test]
fn misses_levels_and_devices_are_those_that_the_messages_name() {
    let snapshot = Stream::with_misses().snapshot();
    assert_eq!(snapshot.link, Link::Live);
    assert_eq!((snapshot.totals.messages, snapshot.totals.misses), (10, 1));
    let by = &snapshot.totals.misses_by_blame;
    assert_eq!((by.len(), by[0].name, by[0].count), (1, "camera", 1));
    let levels: Vec<_> = (snapshot.totals.levels.iter())
        .map(|level| (level.name, level.count))
        .collect();
    assert_eq!(levels, [("full", 8), ("no_fresh_network", 1), ("moved", 1)]);
    let message = snapshot.message.unwrap();
    assert_eq!(
        (message.camera, message.wheels, message.can, message.scale),
        ("silent", "good", "no fault", "held")
    );
    assert_eq!(snapshot.misses[0].sequence, 9);
    assert_eq!(snapshot.latency.bins[4], 8);
    assert_eq!(snapshot.history[9].stages_ms.as_ref().unwrap()[4], 20.0);
    assert_eq!(snapshot.history[8].stages_ms, None);
}

#[test]
fn a_module_that_falls_silent_is_never_shown_as_live() {
    let mut stream = Stream::with_misses();
    stream.now.monotonic.0 += 1_900_000;
    assert_eq!(stream.snapshot().link, Link::Live);
    stream.now.monotonic.0 += 200_000;
    let snapshot = stream.snapshot();
    assert_eq!(snapshot.link, Link::Silent);
    assert!(snapshot.reason.unwrap().contains("publishes nothing"));
    let metrics = render_metrics(&stream.state, stream.now);
    assert!(metrics.contains("freespace_up 0\n") && !metrics.contains("freespace_free_distance_meters"));
    assert!(metrics.contains("freespace_deadline_misses_total{blame=\"camera\"} 1\n"));
    let message = snapshot.message.unwrap();
    assert_eq!((message.camera, message.free_ahead_m), ("unknown", 0.0));
    // The last word, as the module says it: no answer, and no miss.
    stream.publish(Header {
        level: QualityLevel::Invalid,
        faults: Faults::SHUTTING_DOWN | Faults::DEADLINE_MISSED,
        ..Stream::good()
    });
    let snapshot = stream.snapshot();
    assert_eq!(snapshot.link, Link::Ended);
    assert_eq!((snapshot.totals.messages, snapshot.totals.misses), (11, 1));
    assert_eq!((snapshot.latency.count, snapshot.history.len()), (10, 10));
    assert_eq!(snapshot.message.unwrap().camera, "unknown");
}

#[test]
fn gaps_and_starts_are_told_apart_and_a_message_read_twice_counts_once() {
    let mut stream = Stream::new();
    stream.publish(Stream::good());
    stream.sequence += 3;
    stream.publish(Stream::good());
    let again = stream.shared.clone();
    stream.state.message(&again, stream.now);
    let totals = stream.snapshot().totals;
    assert_eq!((totals.messages, totals.lost, totals.starts), (2, 3, 1));
    stream.sequence = 0;
    stream.publish(Stream::good());
    let totals = stream.snapshot().totals;
    assert_eq!((totals.messages, totals.lost, totals.starts), (3, 3, 2));
}

#[test]
fn what_is_kept_has_a_bound() {
    let mut stream = Stream::new();
    for _ in 0..3 * HISTORY {
        stream.publish(Header {
            level: QualityLevel::Invalid,
            ..Stream::good()
        });
    }
    let snapshot = stream.snapshot();
    assert_eq!((snapshot.history.len(), snapshot.misses.len()), (HISTORY, MISSES));
    assert_eq!(snapshot.totals.misses, 3 * HISTORY as u64);
}

#[test]
fn a_message_of_a_later_version_is_not_relied_on() {
    let mut stream = Stream::new();
    stream.publish(Stream::good());
    let mut strange = stream.shared.clone();
    (strange.sequence, strange.level, strange.blame, strange.scale) = (1, 77, 99, 99);
    strange.speed_mps = f32::NAN;
    stream.state.message(&strange, stream.now);
    let message = stream.snapshot().message.unwrap();
    assert_eq!(
        (message.level, message.blame, message.scale, message.speed_mps),
        ("invalid", None, "unknown", 0.0)
    );
}

#[test]
fn the_text_keeps_its_lines() {
    let text = render_plain(&Stream::with_misses().snapshot());
    for line in [
        "link                live",
        "level               moved",
        "faults              camera_silent deadline_missed",
        "blame               camera",
        "used_ms             400.0",
        "misses_by_blame     camera=1",
        "levels              full=8 no_fresh_network=1 moved=1",
        "dropped_frames      2",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}\n{text}");
    }
    let waiting = render_plain(&Stream::new().snapshot());
    assert!(waiting.contains("link                waiting\nreason              nobody publishes"));
}

fn screen(stream: &Stream, size: (u16, u16), layer: Layer) -> String {
    let mut terminal = Terminal::new(TestBackend::new(size.0, size.1)).unwrap();
    terminal
        .draw(|frame| draw(frame, &stream.state, stream.now, layer, "http://127.0.0.1:8642"))
        .unwrap();
    terminal.backend().to_string()
}

#[test]
fn the_terminal_shows_state_misses_and_the_budget() {
    let screen = screen(&Stream::with_misses(), (100, 32), Layer::Occupancy);
    for word in [
        "LIVE",
        "key frame 9",
        "moved",
        "400 of 500 ms",
        "camera    silent",
        "scale held",
        "budget 500 ms",
        "Misses: 1",
        "camera 1",
        "2 of 30 frames",
        "q end",
        "▀",
    ] {
        assert!(screen.contains(word), "{word}\n{screen}");
    }
}

#[test]
fn a_terminal_of_the_usual_size_shows_the_last_misses() {
    let screen = screen(&Stream::with_misses(), (80, 24), Layer::Occupancy);
    for word in [
        "by stage  camera 1",
        "levels    full 8",
        "400 ms  moved  camera",
        "budget 500 ms",
    ] {
        assert!(screen.contains(word), "{word}\n{screen}");
    }
}

#[test]
fn the_terminal_colours_free_occupied_and_unknown_apart() {
    use ratatui::style::Color;
    let stream = Stream::with_misses();
    let mut terminal = Terminal::new(TestBackend::new(100, 32)).unwrap();
    terminal
        .draw(|frame| draw(frame, &stream.state, stream.now, Layer::Occupancy, ""))
        .unwrap();
    let buffer = terminal.backend().buffer();
    let of = |colour: Color| {
        let cells = buffer.content().iter().filter(|cell| cell.symbol() == "▀");
        cells
            .filter(|cell| cell.fg == colour || cell.bg == colour)
            .count()
    };
    let (free, occupied) = (Color::Rgb(66, 178, 104), Color::Rgb(200, 60, 60));
    assert!(of(free) > 20 && of(occupied) > 5 && of(Color::Rgb(60, 64, 72)) > 50);
    assert!(of(Color::Rgb(250, 250, 120)) > 3, "the boundary is drawn");
}

#[test]
fn any_size_of_terminal_is_drawn() {
    for stream in [Stream::with_misses(), Stream::new()] {
        for size in [(1, 1), (20, 5), (40, 12), (300, 90)] {
            for layer in [Layer::Occupancy, Layer::Reason, Layer::Age] {
                let _ = screen(&stream, size, layer);
            }
        }
    }
}

#[test]
fn buckets_of_the_histogram_add_up() {
    let stream = Stream::with_misses();
    let text = render_metrics(&stream.state, stream.now);
    let value = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        line.unwrap().trim().parse::<f64>().unwrap()
    };
    let bucket = |end: &str| {
        value(&format!(
            "freespace_capture_to_publish_seconds_bucket{{le=\"{end}\"}}"
        ))
    };
    assert_eq!(
        (bucket("0.04"), bucket("0.05"), bucket("0.25"), bucket("+Inf")),
        (0.0, 8.0, 9.0, 10.0)
    );
    let sum = value("freespace_capture_to_publish_seconds_sum");
    assert!((sum - (8.0 * 0.042 + 0.231 + 0.4)).abs() < 1e-9, "{sum}");
}

#[test]
fn temperatures_are_shown_everywhere_and_labels_escaped() {
    let mut stream = Stream::with_misses();
    let text = render_plain(&stream.snapshot());
    assert!(text.contains("temperature_c       61.0 x86_pkg_temp\n"), "{text}");
    let terminal = screen(&stream, (100, 32), Layer::Occupancy);
    assert!(
        terminal.contains("heat      61 C x86_pkg_temp, 28 C acpitz"),
        "{terminal}"
    );
    let json = serde_json::to_value(stream.snapshot()).unwrap();
    assert_eq!(
        json["temperatures"][0],
        serde_json::json!({"zone": "acpitz", "celsius": 27.8})
    );
    assert!(json["temperature_note"].is_null());
    stream.warm(&[("a \"zone\" of\nC:\\", 40.5)]);
    let metrics = render_metrics(&stream.state, stream.now);
    let wanted = "freespace_temperature_celsius{zone=\"a \\\"zone\\\" of\\nC:\\\\\"} 40.5\n";
    assert!(metrics.contains(wanted), "{metrics}");
}

#[test]
fn a_computer_without_sensors_says_so_and_old_temperatures_are_not_shown() {
    let mut stream = Stream::with_misses();
    stream.warm(&[]);
    let note = stream.snapshot().temperature_note.unwrap();
    assert!(note.contains("shows no sensor in /sys/class/thermal"), "{note}");
    assert!(screen(&stream, (120, 32), Layer::Occupancy).contains("heat      this computer shows no sensor"));
    assert!(!render_metrics(&stream.state, stream.now).contains("temperature"));
    stream.warm(&[("soc", 50.0)]);
    stream.now.monotonic.0 += 11_000_000;
    let snapshot = stream.snapshot();
    assert!(snapshot.temperatures.is_empty());
    assert!(snapshot.temperature_note.unwrap().contains("has not answered"));
    assert!(!render_metrics(&stream.state, stream.now).contains("temperature"));
    assert_eq!(Stream::new().snapshot().temperature_note.unwrap(), "not read yet");
}
