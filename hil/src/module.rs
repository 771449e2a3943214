//! The program under test: started as a service would start it, told to end as a service would be told.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

/// How long the program is given to end: what its unit gives it, and a recording's page besides.
const TO_END: Duration = Duration::from_secs(5);
const TO_END_RECORDED: Duration = Duration::from_secs(30);

/// Where the program is and what it is run with.
#[derive(Clone, Debug)]
pub(crate) struct Installation {
    pub(crate) program: PathBuf,
    pub(crate) config: PathBuf,
}

/// What a drive is recorded into.
#[derive(Clone, Debug)]
pub(crate) struct Log {
    /// Folder for pictures, grids and report.
    pub(crate) folder: PathBuf,
    /// File for all that came and left.
    pub(crate) mcap: Option<PathBuf>,
}

/// The running program; killed when dropped.
#[derive(Debug)]
pub(crate) struct Module {
    child: Child,
    log: PathBuf,
    to_end: Duration,
}

impl Module {
    /// Starts `freespace run`; its two outputs go to `log`.
    pub(crate) fn start(
        installation: &Installation,
        record: Option<&Log>,
        log: &Path,
    ) -> std::io::Result<Self> {
        let output = File::options().create(true).append(true).open(log)?;
        let mut command = Command::new(&installation.program);
        command.arg("run").arg("--config").arg(&installation.config);
        if let Some(record) = record {
            command.arg("--record").arg(&record.folder);
            if let Some(mcap) = &record.mcap {
                command.arg("--mcap").arg(mcap);
            }
        }
        command
            .stdin(Stdio::null())
            .stderr(output.try_clone()?)
            .stdout(output);
        Ok(Self {
            child: command.spawn()?,
            log: log.to_owned(),
            to_end: if record.is_some() { TO_END_RECORDED } else { TO_END },
        })
    }

    /// Whether it runs.
    pub(crate) fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    pub(crate) fn signal(&self, signal: Signal) {
        if let Some(pid) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            // It may have ended already: waiting tells.
            let _ = kill_process(pid, signal);
        }
    }

    /// Tells it to end, and how it did; none where it does not end in time.
    pub(crate) fn end(mut self) -> Option<ExitStatus> {
        self.signal(Signal::TERM);
        self.wait(self.to_end)
    }

    /// Waits for its end.
    pub(crate) fn wait(&mut self, at_most: Duration) -> Option<ExitStatus> {
        let begin = Instant::now();
        while begin.elapsed() < at_most {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Some(status);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        None
    }

    /// Its resident memory, kB.
    pub(crate) fn resident_kb(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
        line.split_whitespace().nth(1)?.parse().ok()
    }

    /// The end of what it printed.
    pub(crate) fn last_words(&self) -> String {
        let text = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(5)..].join(" | ")
    }
}

impl Drop for Module {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
