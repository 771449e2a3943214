//! Watches a run: counts it, tells the service manager and whoever reads standard error.

use std::time::Instant;

use super::calm::Calm;
use super::progress::Progress;
use super::view::ViewFeed;
use crate::cli::memory_watch::MemoryWatch;
use crate::cli::service::Service;
use crate::cli::terminal;
use crate::runtime::{self, FrameReport, KeyFrameReport, Observer, RunSummary, Start, Status, Trace};
use crate::sink::recording::RunCounts;
use crate::statistics::{DriveStatistics, Publication};

/// What a device has to tell, a line at a time, and which of its parts tells it.
pub(in crate::cli) type DeviceEvents = Box<dyn FnMut() -> Option<(usize, String)>>;

/// A device that is listened to.
struct Device {
    events: DeviceEvents,
    /// Of each part its own: one that flaps must not hide what another one tells.
    calm: Vec<Calm>,
}

impl Device {
    /// The next line to be told now.
    fn next_line(&mut self, now: Instant) -> Option<String> {
        while let Some((part, line)) = (self.events)() {
            let told = match self.calm.get_mut(part) {
                Some(calm) => calm.take(line, now),
                None => Some(line),
            };
            if told.is_some() {
                return told;
            }
        }
        self.calm.iter_mut().find_map(|calm| calm.due(now))
    }
}

/// Counts a run; its memory does not grow with it.
pub(in crate::cli) struct Watch {
    statistics: DriveStatistics,
    tracked_frames: u64,
    progress: Progress,
    service: Service,
    memory: Option<MemoryWatch>,
    devices: Vec<Device>,
    view: Option<ViewFeed>,
}

impl Watch {
    /// Of a run whose numbers go to `statistics`, which are empty so far.
    pub(in crate::cli) fn new(progress: Progress, statistics: DriveStatistics) -> Self {
        Self {
            statistics,
            tracked_frames: 0,
            progress,
            service: Service::from_environment(),
            memory: None,
            devices: Vec::new(),
            view: None,
        }
    }

    /// Passes on what a device of so many parts tells.
    pub(in crate::cli) fn listen(&mut self, parts: usize, events: DeviceEvents) {
        let calm = (0..parts).map(|_| Calm::new(Instant::now())).collect();
        self.devices.push(Device { events, calm });
    }

    /// Whether frames come at the pace of their stamps.
    pub(in crate::cli) const fn is_timed(&self) -> bool {
        self.statistics.is_timed()
    }

    /// Shows the run to a monitor.
    pub(in crate::cli) fn show(&mut self, view: Option<ViewFeed>) {
        self.view = view;
    }

    fn tell(&mut self, line: &str) {
        self.progress.interrupt();
        terminal::tell(format_args!("{line}"));
        if let Some(view) = &mut self.view {
            view.line(line);
        }
    }

    /// The run in numbers, once it is over.
    pub(in crate::cli) fn finish(mut self, summary: &RunSummary) -> (RunCounts, DriveStatistics) {
        self.tell_last_device_events();
        self.progress.end();
        self.statistics.set_drops(summary.drops);
        let counts = RunCounts {
            key_frames: summary.key_frames,
            deadline_misses: summary.deadline_misses,
            frames: summary.frames,
            tracked_frames: self.tracked_frames,
            dropped_frames: summary.dropped_frames,
            allocations_after_start: runtime::allocation::is_installed()
                .then_some(summary.allocations_after_start),
            peak_rss_mb: peak_rss_mb(),
            memory: (self.memory.as_ref()).map(|memory| memory.finish(summary.page_faults)),
            restarts: summary.restarts,
            is_cut_short: summary.is_cut_short,
        };
        (counts, self.statistics)
    }

    fn tell_device_events(&mut self) {
        let now = Instant::now();
        for device in 0..self.devices.len() {
            while let Some(line) = self.devices[device].next_line(now) {
                self.tell(&line);
            }
        }
    }

    fn tell_last_device_events(&mut self) {
        self.tell_device_events();
        for device in std::mem::take(&mut self.devices) {
            for line in device.calm.into_iter().filter_map(|mut calm| calm.last()) {
                self.tell(&line);
            }
        }
    }
}

impl Observer for Watch {
    fn started(&mut self, start: &Start<'_>) {
        self.service.started(start);
        self.memory = Some(MemoryWatch::new(start.plan));
    }

    fn frame(&mut self, report: &FrameReport) {
        use freespace::health::TrackingState;
        // The first frame has nothing to be tracked against: its pose is the origin.
        let is_tracked =
            report.outcome.estimate.state != TrackingState::DeadReckoning || self.tracked_frames == 0;
        self.tracked_frames += u64::from(is_tracked);
        self.statistics.frame(report.outcome.estimate.state);
        self.statistics.frame_micros(report.outcome.micros);
        self.progress.frame(report.index);
    }

    fn publication(&mut self, publication: &Publication) {
        self.statistics.publication(publication);
        self.progress.publication(publication);
    }

    fn key_frame(&mut self, report: &KeyFrameReport<'_>) {
        if let Some(view) = &mut self.view {
            view.key_frame(report);
        }
    }

    #[expect(clippy::cast_precision_loss, reason = "seconds")]
    fn trace(&mut self, trace: &Trace) {
        self.tell(&format!("{:.3} s: {}", trace.at.0 as f64 * 1e-6, trace.event));
    }

    fn status(&mut self, status: &Status) {
        self.statistics.set_drops(status.drops);
        self.service.status(status, &self.statistics);
        if let Some(view) = &mut self.view {
            view.status(status);
        }
        self.tell_device_events();
        if let Some(memory) = &mut self.memory {
            memory.look();
        }
    }
}

/// Largest resident memory, as the kernel counts it.
fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes / 1024.0)
}
