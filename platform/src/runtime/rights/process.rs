//! What the whole process asks for: an allocator that keeps what it has, and memory that stays in RAM.

use rustix::mm::{MlockAllFlags, mlockall, munlockall};

use super::lack::{Lack, Right};

/// Blocks of at least this size get pages of their own while all is being constructed, and give them back when freed: what was
/// needed only to start does not stay in the heap.
const OWN_PAGES_FROM: libc::c_int = 1 << 20;

/// Free heap that is locked beside what is in use, so that what libraries take later meets no page fault: a heap that grows
/// after the lock is counted as locked, but its new pages were seen (Linux 6.18) to fault at their first touch all the same.
const SPARE_BYTES: usize = 1 << 20;

/// One heap for all threads, and big blocks apart from it; call it first in `main`, before any thread.
///
/// A heap of its own would reserve 64 MB of address space for each thread, all of it counted as locked.
///
/// # Errors
/// The C library's malloc is another one.
pub fn settle_allocator() -> Result<(), Lack> {
    set_all(&[(libc::M_ARENA_MAX, 1), (libc::M_MMAP_THRESHOLD, OWN_PAGES_FROM)])
}

/// Locks all memory of the process, what it has and what it will have, and from then on lets no freed memory leave.
///
/// Call it when all is constructed and before the threads start, for their stacks are then in memory from the start. It also
/// gives back what is free, and keeps some spare: the memory plan is complete after it, not before.
///
/// # Errors
/// The limit is too low and `CAP_IPC_LOCK` is missing: the process runs on, its memory not locked.
pub fn lock_memory() -> Result<(), Lack> {
    // SAFETY: `malloc_trim` touches only memory that is free in the allocator, under the allocator's own lock.
    unsafe { libc::malloc_trim(0) };
    let kept = set_all(&[(libc::M_MMAP_MAX, 0), (libc::M_TRIM_THRESHOLD, libc::c_int::MAX)]);
    // The heap grows by one block, which stays with it when it is freed.
    drop(std::hint::black_box(Vec::<u8>::with_capacity(SPARE_BYTES)));
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE)
        .map_err(|error| Lack::of_process(Right::MemoryLock, error.raw_os_error()))?;
    kept
}

/// Undoes the lock.
///
/// # Errors
/// The kernel refuses.
pub fn unlock_memory() -> Result<(), Lack> {
    munlockall().map_err(|error| Lack::of_process(Right::MemoryLock, error.raw_os_error()))
}

fn set_all(settings: &[(libc::c_int, libc::c_int)]) -> Result<(), Lack> {
    for (parameter, value) in settings {
        // SAFETY: the call takes the allocator's own lock and stores a number.
        if unsafe { libc::mallopt(*parameter, *value) } != 1 {
            return Err(Lack::of_process(Right::Allocator, 0));
        }
    }
    Ok(())
}
