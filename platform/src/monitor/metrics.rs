//! Metrics in the text format of Prometheus, version 0.0.4.
//!
//! In: a [`State`] and the time. Out: the text of `/metrics`. Invariant: names, units and suffixes by the conventions
//! (`promtool check metrics` accepts them); counters are since the monitor started, those of frames and restarts since the
//! module did, and rest while the module is silent; a gauge of the module is left out while the module is silent, so that no alert
//! reads an old one. Cost: some hundred lines.

use std::fmt::{Display, Write as _};

use freespace::budget::DEADLINE_MICROS;
use freespace::health::Faults;
use freespace::stage::Stage;

use super::snapshot::{blamed, levels};
use super::state::{BUCKETS_MICROS, Header, Now, State};
use crate::statistics::{SCALE, TRACKING};

struct Text(String);

impl Text {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn sample(&mut self, name: &str, value: impl Display) {
        let _ = writeln!(self.0, "{name} {value}");
    }

    /// A sample with a label, whose value is escaped already or needs it not.
    fn labelled(&mut self, name: &str, label: &str, of: impl Display, value: impl Display) {
        let _ = writeln!(self.0, "{name}{{{label}=\"{of}\"}} {value}");
    }

    fn one(&mut self, name: &str, kind: &str, help: &str, value: impl Display) {
        self.family(name, kind, help);
        self.sample(name, value);
    }

    fn by(&mut self, name: &str, help: &str, label: &str, counts: impl Iterator<Item = (&'static str, u64)>) {
        self.family(name, "counter", help);
        for (of, count) in counts {
            self.labelled(name, label, of, count);
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "microseconds of one process's life")]
fn seconds(micros: u64) -> f64 {
    micros as f64 / 1e6
}

/// The text of `/metrics`.
#[must_use]
pub fn render(state: &State, now: Now) -> String {
    let mut text = Text(String::with_capacity(16 << 10));
    let is_live = state.is_live(now);
    text.one(
        "freespace_up",
        "gauge",
        "Whether messages of the module come: 1, or 0.",
        u8::from(is_live),
    );
    text.family(
        "freespace_build_info",
        "gauge",
        "Version of the monitor, in a label.",
    );
    text.labelled("freespace_build_info", "version", env!("CARGO_PKG_VERSION"), 1);
    if let Some(micros) = state.silent_micros(now) {
        text.one(
            "freespace_message_age_seconds",
            "gauge",
            "Time since the last message was handed over.",
            seconds(micros),
        );
    }
    latency(&mut text, state);
    counters(&mut text, state);
    if let Some(last) = state.last.as_ref().filter(|_| is_live) {
        gauges(&mut text, &last.header);
    }
    module(&mut text, state);
    temperatures(&mut text, state, now);
    text.0
}

/// What may stand in a label's value.
fn escaped(value: &str) -> String {
    value
        .replace('\\', "\\\\")
        .replace('"', "\\\"")
        .replace('\n', "\\n")
}

/// Those of the computer, whatever the module does; nothing where there is no sensor.
fn temperatures(text: &mut Text, state: &State, now: Now) {
    const NAME: &str = "freespace_temperature_celsius";
    let zones = state.fresh_temperatures(now).map_or(&[][..], |read| &read.zones);
    if zones.is_empty() {
        return;
    }
    text.family(
        NAME,
        "gauge",
        "Temperature of the computer, by the kernel's sensors.",
    );
    for zone in zones {
        text.labelled(NAME, "zone", escaped(&zone.name), zone.celsius);
    }
}

fn latency(text: &mut Text, state: &State) {
    const NAME: &str = "freespace_capture_to_publish_seconds";
    text.family(NAME, "histogram", "Time from capture to publication.");
    let bucket = format!("{NAME}_bucket");
    let mut below = 0;
    for (end, count) in BUCKETS_MICROS.iter().zip(state.buckets) {
        below += count;
        text.labelled(&bucket, "le", seconds(*end), below);
    }
    let answers = state.latency.count();
    text.labelled(&bucket, "le", "+Inf", answers);
    text.sample(&format!("{NAME}_sum"), seconds(state.latency_sum_micros));
    text.sample(&format!("{NAME}_count"), answers);
}

fn counters(text: &mut Text, state: &State) {
    text.by(
        "freespace_messages_total",
        "Messages read, by quality level.",
        "level",
        levels(state),
    );
    text.by(
        "freespace_deadline_misses_total",
        "Key frames whose answer was not out by the deadline, by what is to blame.",
        "blame",
        blamed(state),
    );
    text.by(
        "freespace_faults_total",
        "Messages that named a fault.",
        "fault",
        (Faults::NAMED.map(|(_, name)| name).into_iter()).zip(state.faults),
    );
    text.one(
        "freespace_messages_lost_total",
        "counter",
        "Messages that the monitor was too slow to read.",
        state.lost,
    );
    text.one(
        "freespace_module_starts_total",
        "counter",
        "Starts of the module that the monitor saw, the first among them.",
        state.starts,
    );
}

fn gauges(text: &mut Text, header: &Header) {
    let mut gauge = |name: &str, help: &str, value: f64| text.one(name, "gauge", help, value);
    gauge(
        "freespace_quality_level",
        "0 full, 1 no refinement, 2 no fresh network, 3 no fresh map, 4 moved, 5 invalid.",
        f64::from(header.level as u8),
    );
    gauge(
        "freespace_deadline_seconds",
        "Time that a key frame has from its capture.",
        seconds(if header.budget_micros > 0 {
            header.budget_micros.into()
        } else {
            DEADLINE_MICROS
        }),
    );
    gauge(
        "freespace_free_distance_meters",
        "Free distance straight ahead from the rear axle.",
        header.free_ahead_m.into(),
    );
    gauge(
        "freespace_speed_meters_per_second",
        "Speed over ground, as the module has it.",
        header.speed_mps.into(),
    );
    gauge(
        "freespace_camera_height_meters",
        "Height of the camera over the road plane.",
        header.plane_offset_m.into(),
    );
    gauge(
        "freespace_plane_inliers",
        "Landmarks on the road plane.",
        header.plane_inliers.into(),
    );
    states(
        text,
        "freespace_scale_source",
        "Source of the metric scale: 1 for the present one.",
        &SCALE,
        header.scale,
    );
    states(
        text,
        "freespace_tracking_state",
        "Source of the pose: 1 for the present one.",
        &TRACKING,
        header.tracking,
    );
    text.family(
        "freespace_fault_active",
        "gauge",
        "Whether the last message names the fault.",
    );
    for (fault, name) in Faults::NAMED {
        let is_active = u8::from(header.faults.contains(fault));
        text.labelled("freespace_fault_active", "fault", name, is_active);
    }
}

fn states(text: &mut Text, name: &str, help: &str, names: &[&str], present: u8) {
    text.family(name, "gauge", help);
    for (number, state) in names.iter().enumerate() {
        text.labelled(name, "state", state, u8::from(number == usize::from(present)));
    }
}

/// What the module's views tell; nothing where it shows none.
fn module(text: &mut Text, state: &State) {
    let Some(view) = &state.view else { return };
    let status = &view.status;
    let mut counter = |name: &str, help: &str, value: u64| text.one(name, "counter", help, value);
    counter(
        "freespace_frames_total",
        "Frames that entered the pipeline.",
        status.frames,
    );
    counter(
        "freespace_frames_dropped_total",
        "Frames lost by the camera, refused, or displaced by newer ones.",
        status.dropped_frames,
    );
    counter(
        "freespace_stage_restarts_total",
        "Parts that panicked and were started anew.",
        status.restarts.into(),
    );
    const NAME: &str = "freespace_stage_duration_seconds";
    text.family(NAME, "summary", "Time in each stage for a key frame.");
    for (stage, total) in Stage::ALL.into_iter().zip(state.stages) {
        let name = stage.name();
        text.labelled(&format!("{NAME}_sum"), "stage", name, seconds(total.micros));
        text.labelled(&format!("{NAME}_count"), "stage", name, total.runs);
    }
}
