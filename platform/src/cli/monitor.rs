//! `freespace monitor`: watches a module of this computer through shared memory.

use std::io::{self, IsTerminal as _, Write as _};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use clap::Args;
use freespace_reader::service::DEFAULT_NAME;

use super::Failure;
use crate::bad_input::BadInput;
use crate::monitor::{
    Now, SENSORS, ServeError, Server, Shared, Snapshot, State, follow, lock, measure, render_plain,
    run_terminal,
};
use crate::runtime::supervision::stop_on_signals;

/// How long `--once` waits for a message: several key frames.
const ONCE_WAIT: Duration = Duration::from_secs(5);
/// After how long it is said that a message is waited for.
const UNTOLD_WAIT: Duration = Duration::from_millis(700);
/// How long it waits, then, for a view: it comes with the next key frame.
const VIEW_WAIT: Duration = Duration::from_millis(1200);
/// Between two looks at the state.
const LOOK: Duration = Duration::from_millis(50);

/// Where the page is, unless told otherwise.
const LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8642);

/// Arguments of `freespace monitor`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  freespace monitor
  freespace monitor --listen                    # page and metrics on http://127.0.0.1:8642
  freespace monitor --once --plain              # exit code 1 where no module publishes

It reads shared memory and the computer's temperatures only, and needs no rights but those of the module's user.")]
pub struct MonitorArgs {
    /// Name of the module's service: `name` in its `[shared_memory]`.
    #[arg(long, value_name = "NAME", default_value = DEFAULT_NAME)]
    pub name: String,
    /// Serve a web page and /metrics; of this computer alone where no address is given. There is no log-in: whoever reaches
    /// the address sees the camera.
    #[arg(long, value_name = "ADDR:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8642")]
    pub listen: Option<SocketAddr>,
    /// Print one snapshot and end.
    #[arg(long, conflicts_with = "listen")]
    pub once: bool,
    /// Print text in place of the terminal view, a snapshot a message.
    #[arg(long)]
    pub plain: bool,
    /// Print snapshots as JSON, one a line.
    #[arg(long, conflicts_with = "plain")]
    pub json: bool,
}

/// Watches until a key, SIGTERM or SIGINT.
///
/// # Errors
/// An address that cannot be listened on; with `--once`, no module that publishes.
pub fn run(args: &MonitorArgs) -> Result<(), Failure> {
    let failed = |error: io::Error| Failure::unmet(format!("the monitor could not be started: {error}"));
    let stop = Arc::new(AtomicBool::new(false));
    stop_on_signals(&stop).map_err(failed)?;
    let state: Shared = Arc::new(Mutex::new(State::new(&args.name)));
    let _follower = follow(&args.name, Arc::clone(&state)).map_err(failed)?;
    let _thermometer = measure(Path::new(SENSORS), Arc::clone(&state)).map_err(failed)?;
    if args.once {
        return once(args, &state, &stop);
    }
    let server = args.listen.map(|address| serve(address, &state)).transpose()?;
    let note = server
        .as_ref()
        .map(|server| format!("http://{}", server.address()))
        .unwrap_or_default();
    let is_text = args.plain || args.json || !io::stdout().is_terminal();
    if !is_text {
        return run_terminal(&state, &note, &stop).map_err(failed);
    }
    if !note.is_empty() {
        eprintln!("freespace monitor: {note}");
    }
    let is_quiet = !args.plain && !args.json && server.is_some();
    print_each(args, &state, &stop, is_quiet).map_err(failed)
}

fn serve(address: SocketAddr, state: &Shared) -> Result<Server, Failure> {
    Server::start(address, Arc::clone(state)).map_err(|error| match error {
        ServeError::Listen { .. } => BadInput::new(
            error.to_string(),
            format!("give --listen another address of this computer, or port, such as {LISTEN}"),
        )
        .into(),
        ServeError::Start(_) => Failure::unmet(error.to_string()),
    })
}

/// Prints one snapshot.
fn once(args: &MonitorArgs, state: &Shared, stop: &AtomicBool) -> Result<(), Failure> {
    let has_message = || lock(state).messages() > 0;
    let mut is_seen = wait(UNTOLD_WAIT, stop, has_message);
    if !is_seen && !stop.load(Ordering::Relaxed) {
        let longest = ONCE_WAIT.as_secs();
        eprintln!(
            "freespace monitor: waiting for a message of {}, {longest} s at most",
            args.name
        );
        is_seen = wait(ONCE_WAIT.saturating_sub(UNTOLD_WAIT), stop, has_message);
    }
    if is_seen {
        wait(VIEW_WAIT, stop, || lock(state).has_view());
    }
    let snapshot = Snapshot::of(&lock(state), Now::read());
    print(args, &snapshot).map_err(|error| Failure::unmet(format!("standard output: {error}")))?;
    match snapshot.reason {
        Some(reason) => Err(Failure::unmet(format!("{}: {reason}", args.name))),
        None => Ok(()),
    }
}

fn wait(longest: Duration, stop: &AtomicBool, is_there: impl Fn() -> bool) -> bool {
    let begin = Instant::now();
    while begin.elapsed() < longest && !stop.load(Ordering::Relaxed) {
        if is_there() {
            return true;
        }
        std::thread::sleep(LOOK);
    }
    is_there()
}

/// Prints a snapshot a message until `stop`, or nothing where the page is all that is wanted.
fn print_each(args: &MonitorArgs, state: &Shared, stop: &AtomicBool, is_quiet: bool) -> io::Result<()> {
    let mut printed = 0;
    if !is_quiet && !wait(UNTOLD_WAIT, stop, || lock(state).messages() > 0) {
        eprintln!("freespace monitor: waiting for a message of {}", args.name);
    }
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(LOOK);
        let messages = lock(state).messages();
        if !is_quiet && messages != printed {
            printed = messages;
            let snapshot = Snapshot::of(&lock(state), Now::read());
            match print(args, &snapshot) {
                // Whoever read has read enough.
                Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return Ok(()),
                result => result?,
            }
        }
    }
    Ok(())
}

fn print(args: &MonitorArgs, snapshot: &Snapshot) -> io::Result<()> {
    let mut out = io::stdout().lock();
    if args.json {
        serde_json::to_writer(&mut out, snapshot)?;
        return writeln!(out);
    }
    let end = if args.once { "" } else { "\n" };
    write!(out, "{}{end}", render_plain(snapshot))?;
    out.flush()
}
