//! The service manager's socket: ready, alive, how it goes, ending.
//!
//! In: `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID` of the environment, read once. Out: datagrams of the protocol of
//! sd_notify(3). Invariant: the watchdog is fed by publications alone, so that a program that runs but publishes nothing is
//! restarted. Cost: one datagram a call, no allocation; it never waits: where the manager's queue is full the message is lost,
//! and the next one tells the same. Without a service manager each call does nothing.

use std::env;
use std::fmt::{self, Write as _};
use std::io;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

/// Bytes of a status line that are kept.
pub const STATUS_BYTES: usize = 240;

/// The way to the service manager, where there is one.
#[derive(Debug)]
pub struct Notifier {
    socket: Option<UnixDatagram>,
}

impl Notifier {
    /// The manager that the environment names; none without one.
    ///
    /// # Errors
    /// The environment names a socket that cannot be reached.
    pub fn from_environment() -> io::Result<Self> {
        match env::var("NOTIFY_SOCKET") {
            Ok(name) if !name.is_empty() => Self::connected(&name),
            _ => Ok(Self { socket: None }),
        }
    }

    /// The manager at a socket's path, or its abstract name after an `@`.
    ///
    /// # Errors
    /// No one listens there.
    pub fn connected(name: &str) -> io::Result<Self> {
        let address = match name.strip_prefix('@') {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(name)?,
        };
        let socket = UnixDatagram::unbound()?;
        socket.connect_addr(&address)?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket: Some(socket) })
    }

    /// Whether a service manager listens.
    #[must_use]
    pub const fn is_supervised(&self) -> bool {
        self.socket.is_some()
    }

    /// The first answer was published.
    pub fn ready(&self) {
        self.send("READY=1");
    }

    /// The run ends in order.
    pub fn stopping(&self) {
        self.send("STOPPING=1");
    }

    /// One line for `systemctl status`; what is longer than [`STATUS_BYTES`] is cut, and a line break ends it.
    pub fn status(&self, text: fmt::Arguments<'_>) {
        let mut line = Line(heapless::String::new());
        // A line cut short is an error of the formatter, and is sent as it is.
        let _ = line.write_str("STATUS=").and_then(|()| line.write_fmt(text));
        let end = line.0.find('\n').unwrap_or(line.0.len());
        self.send(&line.0[..end]);
    }

    fn send(&self, message: &str) {
        if let Some(socket) = &self.socket {
            // Lost where the manager is gone or its queue is full; there is no one else to tell.
            let _ = socket.send(message.as_bytes());
        }
    }
}

/// Keeps as much of what is written as there is room for.
struct Line(heapless::String<{ STATUS_BYTES + "STATUS=".len() }>);

impl fmt::Write for Line {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            self.0.push(character).map_err(|_| fmt::Error)?;
        }
        Ok(())
    }
}

/// Feeds the service manager's watchdog with fresh output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Watchdog {
    timeout: Option<Duration>,
    fed_at: u64,
}

impl Watchdog {
    /// A watchdog with the timeout of the environment; none where the manager watches no one, or another process.
    #[must_use]
    pub fn from_environment() -> Self {
        let of = |name| env::var(name).ok();
        Self::with(of("WATCHDOG_USEC").as_deref(), of("WATCHDOG_PID").as_deref())
    }

    fn with(micros: Option<&str>, pid: Option<&str>) -> Self {
        let is_ours = pid.is_none_or(|pid| pid.parse() == Ok(std::process::id()));
        let timeout = micros
            .and_then(|micros| micros.parse().ok())
            .filter(|micros| is_ours && *micros > 0)
            .map(Duration::from_micros);
        Self { timeout, fed_at: 0 }
    }

    /// Time without fresh output after which the manager restarts the program.
    #[must_use]
    pub const fn timeout(&self) -> Option<Duration> {
        self.timeout
    }

    /// Feeds it where `fresh` is more than at the last call; whether it was fed.
    ///
    /// `fresh` counts publications that carry new content: neither moved nor invalid ones.
    pub fn feed(&mut self, fresh: u64, notifier: &Notifier) -> bool {
        if fresh <= self.fed_at {
            return false;
        }
        self.fed_at = fresh;
        if self.timeout.is_none() {
            return false;
        }
        notifier.send("WATCHDOG=1");
        true
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn manager() -> (UnixDatagram, Notifier) {
        let name = format!(
            "freespace-test-{}-{:?}",
            std::process::id(),
            std::thread::current().id()
        );
        let socket = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        socket.set_nonblocking(true).unwrap();
        (socket, Notifier::connected(&format!("@{name}")).unwrap())
    }

    fn heard(socket: &UnixDatagram) -> Option<String> {
        let mut buffer = [0; 512];
        let length = socket.recv(&mut buffer).ok()?;
        Some(String::from_utf8_lossy(&buffer[..length]).into_owned())
    }

    #[test]
    fn the_manager_hears_what_it_understands() {
        let (socket, notifier) = manager();
        notifier.ready();
        notifier.status(format_args!("{} of {} deadlines met\nREADY=0", 59, 60));
        notifier.status(format_args!("{}", "\u{e4}".repeat(STATUS_BYTES)));
        notifier.stopping();
        assert_eq!(heard(&socket).unwrap(), "READY=1");
        // A line break would begin another assignment.
        assert_eq!(heard(&socket).unwrap(), "STATUS=59 of 60 deadlines met");
        let cut = heard(&socket).unwrap();
        assert_eq!(
            (cut.len(), cut.chars().last()),
            (STATUS_BYTES + 7, Some('\u{e4}'))
        );
        assert_eq!(heard(&socket).unwrap(), "STOPPING=1");
    }

    #[test]
    fn the_watchdog_is_fed_by_fresh_output_alone() {
        let (socket, notifier) = manager();
        let mut watchdog = Watchdog::with(Some("3000000"), None);
        assert_eq!(watchdog.timeout(), Some(Duration::from_secs(3)));
        let fed = [0, 1, 1, 2, 2, 2, 5].map(|fresh| watchdog.feed(fresh, &notifier));
        assert_eq!(fed, [false, true, false, true, false, false, true]);
        for _ in 0..3 {
            assert_eq!(heard(&socket).unwrap(), "WATCHDOG=1");
        }
        assert_eq!(heard(&socket), None);
    }

    #[test]
    fn a_watchdog_of_another_process_or_of_none_is_left_alone() {
        let (socket, notifier) = manager();
        let own = std::process::id().to_string();
        assert!(Watchdog::with(Some("5"), Some(&own)).timeout().is_some());
        for (micros, pid) in [
            (Some("5"), Some("1")),
            (None, None),
            (Some("0"), None),
            (Some("x"), None),
        ] {
            let mut watchdog = Watchdog::with(micros, pid);
            assert!(!watchdog.feed(1, &notifier), "{micros:?} {pid:?}");
        }
        assert_eq!(heard(&socket), None);
    }

    #[test]
    fn a_manager_that_does_not_listen_is_not_waited_for() {
        let (socket, notifier) = manager();
        for _ in 0..10_000 {
            notifier.ready();
        }
        drop(socket);
        notifier.ready();
        assert!(Notifier::connected("@freespace-test-nobody").is_err());
    }
}
