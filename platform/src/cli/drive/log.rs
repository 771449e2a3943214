//! The recording of a drive in MCAP, where one was asked for.

use std::time::{Duration, Instant};

use freespace::pipeline::PipelineConfig;

use super::{Watch, layout};
use crate::bad_input::{BadInput, read_text};
use crate::cli::{Failure, McapArgs, Pace};
use crate::config::Config;
use crate::runtime::memory::MemoryPlan;
use crate::runtime::{Devices, Observer};
use crate::sink::mcap::{DriveRecorder, Losses, Noted, RecordingPlan, Split};

/// A drive that is recorded, or is not.
pub(in crate::cli) struct DriveLog {
    recorder: Option<DriveRecorder>,
    begun: Instant,
}

impl DriveLog {
    /// Makes what `args` ask for; what it has to tell goes through `watch`.
    ///
    /// # Errors
    /// A drive that is not at its own pace, or a file that is there already or cannot be written.
    pub(in crate::cli) fn open(
        args: &McapArgs,
        pace: Pace,
        config: &Config,
        pipeline: &PipelineConfig,
        plan: &mut MemoryPlan,
        watch: &mut Watch,
    ) -> Result<Self, Failure> {
        let Some(path) = &args.mcap else {
            return Ok(Self {
                recorder: None,
                begun: Instant::now(),
            });
        };
        if pace == Pace::Fast {
            return Err(BadInput::new(
                "--mcap is given with --pace fast: a recording keeps the pace of the drive, for it must not hold it up",
                "leave --pace out, or --mcap",
            )
            .into());
        }
        let config_text = read_text(
            &config.path,
            "give the path of a TOML file, such as config/kitti.toml",
        )?;
        let what = RecordingPlan {
            path,
            split: Split {
                bytes: args.split_mb.map(|megabytes| megabytes.saturating_mul(1_000_000)),
                after: args.split_s.map(Duration::from_secs),
            },
            pipeline,
            layout: layout(&pipeline.grid),
            config_path: &config.path,
            config_text,
        };
        let mut recorder = plan.measure("recording", || DriveRecorder::open(what))?;
        if let Some(lines) = recorder.take_lines() {
            watch.listen(1, Box::new(move || Some((0, lines.try_recv().ok()?))));
        }
        Ok(Self {
            recorder: Some(recorder),
            begun: Instant::now(),
        })
    }

    /// The same devices, what they give recorded.
    pub(in crate::cli) fn tap(&mut self, devices: Devices) -> Devices {
        let Some(recorder) = &mut self.recorder else {
            return devices;
        };
        Devices {
            camera: recorder.tap_camera(devices.camera),
            wheels: devices.wheels.map(|wheels| recorder.tap_wheels(wheels)),
            ..devices
        }
    }

    /// The same observer, what it sees recorded.
    pub(in crate::cli) fn noted<'a>(&'a self, observer: &'a mut dyn Observer) -> Noted<'a> {
        match &self.recorder {
            Some(recorder) => recorder.noted(observer),
            None => Noted::not(observer),
        }
    }

    /// Ends the recording, and tells what it came to.
    #[expect(clippy::cast_precision_loss, reason = "megabytes")]
    pub(in crate::cli) fn finish(self) {
        let Some(recorder) = self.recorder else { return };
        let path = recorder.path().to_owned();
        let counts = recorder.finish();
        let megabytes = counts.written_bytes as f64 * 1e-6;
        let losses = counts.losses();
        let lacks = if losses == Losses::default() {
            "nothing is missing".to_owned()
        } else {
            format!("not recorded: {losses}")
        };
        crate::cli::terminal::tell(format_args!(
            "{}: {} frames, {megabytes:.1} MB, {:.1} MB/s; {lacks}",
            path.display(),
            counts.frames,
            megabytes / self.begun.elapsed().as_secs_f64().max(1e-3),
        ));
    }
}
