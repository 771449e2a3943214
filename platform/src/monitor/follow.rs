//! Follows a module: a thread that reads its messages and views into a shared state.
//!
//! In: the service's name. Out: a [`State`] behind a lock, which nobody of the module waits for. Invariant: it never gives up:
//! a module that is absent, ends, or is started anew is looked for again, at most [`RETRY`] later.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use freespace_reader::{Reader, ReaderError};

use super::state::{Now, State};
use crate::view::ViewReader;

/// Between two looks for a module.
const RETRY: Duration = Duration::from_millis(500);
/// Longest wait for a message; the time to end is noticed after it.
const WAIT: Duration = Duration::from_millis(100);
/// A service that says nothing for this long may have been replaced by another of its name: it is opened anew.
const REOPEN: Duration = Duration::from_secs(5);

/// A state that views read while it is written.
pub type Shared = Arc<Mutex<State>>;

/// The state, for a short look; a thread that panicked left counts, which are whole.
pub fn lock(state: &Shared) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread that follows; it ends when this is dropped.
pub struct Follower {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Starts to follow the module that publishes under `name`.
///
/// # Errors
/// The system gave no thread.
pub fn follow(name: &str, state: Shared) -> io::Result<Follower> {
    let stop = Arc::new(AtomicBool::new(false));
    let body = Body {
        name: name.to_owned(),
        state,
        stop: Arc::clone(&stop),
    };
    let thread = std::thread::Builder::new()
        .name("follow".to_owned())
        .spawn(move || body.run())?;
    Ok(Follower {
        stop,
        thread: Some(thread),
    })
}

impl Drop for Follower {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Body {
    name: String,
    state: Shared,
    stop: Arc<AtomicBool>,
}

impl Body {
    fn run(&self) {
        while !self.is_stopped() {
            let ended = self.read().err();
            if let Some(error) = ended {
                lock(&self.state).link(Err(error));
                std::thread::sleep(RETRY);
            }
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Reads until the time to end, or until the service should be opened anew.
    fn read(&self) -> Result<(), ReaderError> {
        let mut reader = Reader::open(&self.name)?;
        lock(&self.state).link(Ok(()));
        let mut views = None;
        let mut heard = Instant::now();
        while !self.is_stopped() && heard.elapsed() < REOPEN {
            if let Some(message) = reader.next(WAIT)? {
                heard = Instant::now();
                lock(&self.state).message(&message, Now::read());
                // A module without views is looked at once a message.
                views = views.or_else(|| ViewReader::open(&self.name).ok());
            }
            views = views.filter(|views| self.look(views));
        }
        Ok(())
    }

    /// Takes the newest view; `false` where the views are to be opened anew.
    fn look(&self, views: &ViewReader) -> bool {
        match views.newest() {
            Ok(Some(view)) => lock(&self.state).view(view),
            Ok(None) => {}
            Err(_) => return false,
        }
        true
    }
}
