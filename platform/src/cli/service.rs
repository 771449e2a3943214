//! What the world outside is told of a live run: at start on standard error, while it runs through the service manager.

use super::terminal;
use crate::runtime::rights::Lack;
use crate::runtime::supervision::{Notifier, Watchdog};
use crate::runtime::{Start, Status};
use crate::statistics::DriveStatistics;

/// Looks between two status lines: a second and more.
const LOOKS: u32 = 25;

pub(super) struct Service {
    notifier: Option<Notifier>,
    watchdog: Watchdog,
    is_ready: bool,
    looks: u32,
}

impl Service {
    /// The service manager that the environment names, if any.
    pub(super) fn from_environment() -> Self {
        let notifier = Notifier::from_environment();
        if let Err(error) = &notifier {
            terminal::tell(format_args!(
                "the service manager of NOTIFY_SOCKET cannot be reached: {error}"
            ));
        }
        Self {
            notifier: notifier.ok(),
            watchdog: Watchdog::from_environment(),
            is_ready: false,
            looks: 0,
        }
    }

    /// Tells what is lacking, and what memory is held.
    pub(super) fn started(&self, start: &Start<'_>) {
        for line in lacking(start.lacks) {
            terminal::tell(format_args!("{line}"));
        }
        terminal::tell_over(format_args!("memory held from now on\n{}", start.plan));
    }

    /// Ready with the first answer; the watchdog is fed with fresh ones only.
    pub(super) fn status(&mut self, status: &Status, statistics: &DriveStatistics) {
        let Some(notifier) = &self.notifier else { return };
        if !self.is_ready && status.fresh > 0 {
            notifier.ready();
            self.is_ready = true;
        }
        self.watchdog.feed(status.fresh, notifier);
        self.looks += 1;
        if self.looks == LOOKS {
            self.looks = 0;
            notifier.status(format_args!(
                "{}, {} restarts",
                statistics.status(),
                status.restarts
            ));
        }
    }
}

/// What is lacking, a line for each fix.
fn lacking(lacks: &[Lack]) -> Vec<String> {
    let mut by_fix: Vec<(&str, Vec<String>)> = Vec::new();
    for lack in lacks {
        match by_fix.iter_mut().find(|(fix, _)| *fix == lack.fix()) {
            Some((_, of_this_fix)) => of_this_fix.push(lack.to_string()),
            None => by_fix.push((lack.fix(), vec![lack.to_string()])),
        }
    }
    let line = |(fix, lacks): (&str, Vec<String>)| format!("lacking: {}; {fix}", lacks.join("; "));
    by_fix.into_iter().map(line).collect()
}

impl Drop for Service {
    fn drop(&mut self) {
        if let Some(notifier) = &self.notifier {
            notifier.stopping();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::rights::{Right, ThreadRole};

    #[test]
    fn what_has_one_fix_is_one_line() {
        let lack = |right, thread| Lack {
            right,
            thread,
            errno: 1,
        };
        let lines = lacking(&[
            lack(Right::Priority, Some(ThreadRole::Frame)),
            lack(Right::MemoryLock, None),
            lack(Right::Priority, Some(ThreadRole::Publisher)),
        ]);
        assert_eq!(lines.len(), 2, "{lines:?}");
        assert!(
            lines[0].contains("frame: ") && lines[0].contains("publisher: "),
            "{lines:?}"
        );
        assert_eq!(lines[0].matches("CAP_SYS_NICE").count(), 1, "{lines:?}");
    }
}
