//! Threads and the deadline: camera, frame task, key-frame task, network and publisher in real time; the observer stays on the
//! caller's thread.
//!
//! | hand-over | by | when it is full |
//! |---|---|---|
//! | camera to frame: frames | mailbox | the newest wins, the displaced one is counted |
//! | frame to key-frame: jobs | mailbox | the newest wins; the publisher answers for the displaced one |
//! | key-frame to frame: lessons | mailbox | the newest wins; it holds all that the displaced one taught |
//! | frame and key-frame to publisher: news | ring | never: it has room for everything that circulates |
//! | publisher to observer: publications | ring | not lent, but used again at once, and counted |
//! | frame to observer: frame reports | ring | lost, and counted |
//!
//! Boxes circulate: all are made before the start, and the real-time threads own as many as they need; the observer, which may
//! be as slow as it likes, is lent only what is left. A thread that panics starts its part anew (see [`super::restart`]).

mod assembly;
mod camera;
mod frame;
mod key_frame;
mod observe;
mod publisher;
mod slow;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use freespace::health::Faults;
use freespace::pipeline::{KeyFrameJob, Lesson};
use freespace::port::FrameBuffer;
use freespace::space::Micros;
use freespace::stage::Progress;

use super::allocation::allocations;
use super::handover::{Bell, Mailbox};
use super::memory::MemoryPlan;
use super::restart::Restarts;
use super::rights::{self, Lack, RealTimeConfig, ThreadRole, lock_memory, thread_builder};
use super::{Observer, RunError, RunSummary, Setup, Start};
use crate::clock::MonotonicClock;
use crate::statistics::Drops;
use assembly::Threads;
#[cfg(test)]
pub(in crate::runtime) use observe::LAST_WORD;
pub use slow::SlowStage;

/// What the threads share: hand-overs, progress and counters, none of it behind a lock.
#[derive(Default)]
struct Shared {
    /// Set where the devices are opened; the default one is a recording's.
    clock: MonotonicClock,
    frames: Mailbox<FrameBuffer>,
    jobs: Mailbox<KeyFrameJob>,
    lessons: Mailbox<Lesson>,
    publisher_bell: Bell,
    observer_bell: Bell,
    camera_progress: Progress,
    frame_progress: Progress,
    key_frame_progress: Progress,
    publisher_progress: Progress,
    /// Stamp of the newest frame that the camera gave.
    captured: Newest,
    /// A frame that was displaced was to become a key frame; the next one becomes it.
    key_frame_wanted: AtomicBool,
    /// A thread hangs: no answer can be waited for any more.
    is_given_up: AtomicBool,
    /// The last publication has left.
    is_published: AtomicBool,
    restarts: Restarts,
    counters: Counters,
}

/// The newest stamp that one thread saw, for another to read.
struct Newest(AtomicU64);

impl Default for Newest {
    fn default() -> Self {
        Self(AtomicU64::new(Self::NONE))
    }
}

impl Newest {
    const NONE: u64 = u64::MAX;

    fn set(&self, stamp: Micros) {
        self.0.store(stamp.0, Ordering::Relaxed);
    }

    fn get(&self) -> Option<Micros> {
        let stamp = self.0.load(Ordering::Relaxed);
        (stamp != Self::NONE).then_some(Micros(stamp))
    }
}

/// Counters that several threads add to.
#[derive(Default)]
struct Counters {
    /// Frames that the camera lost, or that were refused.
    lost_frames: AtomicU64,
    /// Frames that newer ones overtook.
    displaced_frames: AtomicU64,
    frames: AtomicU64,
    key_frames: AtomicU64,
    misses: AtomicU64,
    fresh: AtomicU64,
    unobserved: AtomicU64,
    unreported: AtomicU64,
    unanswered: AtomicU64,
    late: AtomicU64,
    rejected_views: AtomicU64,
    page_faults: AtomicU64,
}

impl Counters {
    fn add(counter: &AtomicU64, count: u64) {
        counter.fetch_add(count, Ordering::Relaxed);
    }

    fn drops(&self) -> Drops {
        let count = |counter: &AtomicU64| Some(counter.load(Ordering::Relaxed));
        Drops {
            camera: count(&self.lost_frames),
            hand_over: count(&self.displaced_frames),
            unobserved: count(&self.unobserved),
            unreported: count(&self.unreported),
            unanswered: count(&self.unanswered),
            late: count(&self.late),
            rejected_views: count(&self.rejected_views),
        }
    }
}

/// A live run, all of it made, whose threads have not started.
pub struct LiveRun {
    threads: Threads,
    shared: Arc<Shared>,
    real_time: RealTimeConfig,
    plan: MemoryPlan,
    lacks: Vec<Lack>,
}

impl LiveRun {
    /// Makes everything that a run needs, and asks for its rights.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn prepare(setup: Setup, stop: &Arc<AtomicBool>) -> Result<Self, RunError> {
        let mut setup = setup;
        let shared = Arc::new(Shared {
            clock: setup.clock.clone(),
            ..Shared::default()
        });
        let mut plan = std::mem::take(&mut setup.plan);
        let mut lacks = std::mem::take(&mut setup.lacks);
        let real_time = setup.real_time;
        lacks.extend(rehearse(&real_time)?);
        let standing = Faults::NONE.with(Faults::RIGHTS_LACKING, !lacks.is_empty());
        let threads = Threads::build(setup, standing, stop, &shared, &mut plan)?;
        plan.stacks(&real_time, &ThreadRole::REAL_TIME);
        Ok(Self {
            threads,
            shared,
            real_time,
            plan,
            lacks,
        })
    }

    /// The memory it holds, complete once the memory is locked, or locking was tried.
    pub const fn plan(&mut self) -> &mut MemoryPlan {
        &mut self.plan
    }

    /// Runs until the camera ends or `stop` is set; the first frame sets the clock.
    ///
    /// # Errors
    /// A thread could not be started, hung, or panicked too often.
    pub fn run(self, observer: &mut dyn Observer) -> Result<RunSummary, RunError> {
        let Self {
            mut threads,
            shared,
            real_time,
            mut plan,
            mut lacks,
        } = self;
        if real_time.lock_memory
            && let Err(lack) = lock_memory()
        {
            lacks.push(lack);
            threads.say_always(Faults::RIGHTS_LACKING);
        }
        plan.complete();
        observer.started(&Start {
            plan: &plan,
            lacks: &lacks,
        });
        let allocations_before = allocations();
        let (handles, watching) = threads.start()?;
        watching.run(observer)?;
        let mut is_whole = true;
        for handle in handles {
            is_whole &= handle.join().is_ok();
        }
        // Every step is guarded: a thread that dies all the same does so outside its work, and is no better than one too many.
        if shared.restarts.is_spent() || !is_whole {
            return Err(RunError::PanickedTooOften);
        }
        Ok(shared.summary(allocations() - allocations_before))
    }
}

/// Prepares a run and runs it.
///
/// # Errors
/// A thread could not be started, hung, or panicked too often.
pub fn run_live(
    setup: Setup,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
) -> Result<RunSummary, RunError> {
    LiveRun::prepare(setup, stop)?.run(observer)
}

/// Asks for the rights of each real-time thread on a thread that does nothing else: what is refused.
fn rehearse(real_time: &RealTimeConfig) -> Result<Vec<Lack>, RunError> {
    let mut lacks = Vec::new();
    for role in ThreadRole::REAL_TIME {
        let config = *real_time;
        let thread = thread_builder(role, real_time)
            .spawn(move || rights::enter(role, &config))
            .map_err(RunError::Thread)?;
        // It does nothing that could panic.
        if let Ok(entered) = thread.join() {
            lacks.extend(entered.lacks);
        }
    }
    Ok(lacks)
}

impl Shared {
    /// A thread is gone: the others come to their end, and nobody waits for it. The publisher says the last word, unless it is
    /// the one that is gone.
    fn abandon(&self, is_publisher_gone: bool) {
        self.is_given_up.store(true, Ordering::Relaxed);
        self.frames.close();
        self.jobs.close();
        if is_publisher_gone {
            self.is_published.store(true, Ordering::Release);
        }
        self.publisher_bell.ring();
        self.observer_bell.ring();
    }

    fn summary(&self, allocations_after_start: u64) -> RunSummary {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let drops = self.counters.drops();
        RunSummary {
            frames: count(&self.counters.frames),
            dropped_frames: drops.frames(),
            key_frames: count(&self.counters.key_frames),
            deadline_misses: count(&self.counters.misses),
            fresh: count(&self.counters.fresh),
            drops,
            restarts: self.restarts.count(),
            allocations_after_start,
            page_faults: count(&self.counters.page_faults),
            // Only who installed the signals knows.
            is_cut_short: false,
        }
    }
}
