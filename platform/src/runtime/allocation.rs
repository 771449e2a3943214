//! Counts heap allocations, apart those of threads that declared themselves real-time, and the bytes that live.
//!
//! In: every request to the global allocator, once [`CountingAllocator`] is installed as `#[global_allocator]`.
//! Out: [`allocations`], the count made inside a [`RealTimeScope`] by any thread; [`total_allocations`];
//! [`RealTimeScope::allocations`], that of one scope; and [`live_bytes`], for the memory plan. Invariant: the counters never
//! allocate, lock or panic. Cost: two relaxed atomic additions a request, and one read of a thread-local cell; nothing where
//! no one allocates.
//! A growing `realloc` counts as an allocation, for it may move. What a C or C++ library takes from `malloc` is not seen here.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};

static TOTAL: AtomicU64 = AtomicU64::new(0);
static REAL_TIME: AtomicU64 = AtomicU64::new(0);
static LIVE_BYTES: AtomicU64 = AtomicU64::new(0);

thread_local! {
    // Const-initialised and without a destructor, so that touching them inside the allocator allocates nothing.
    static SCOPES: Cell<u32> = const { Cell::new(0) };
    static ON_THIS_THREAD: Cell<u64> = const { Cell::new(0) };
}

/// The system allocator with counters.
#[derive(Clone, Copy, Debug, Default)]
pub struct CountingAllocator;

#[inline]
fn count() {
    TOTAL.fetch_add(1, Ordering::Relaxed);
    // `try_with` fails only for a thread being torn down, which is past its real-time work.
    let is_real_time = SCOPES.try_with(|scopes| scopes.get() > 0).unwrap_or(false);
    if is_real_time {
        REAL_TIME.fetch_add(1, Ordering::Relaxed);
        // The same holds here.
        let _ = ON_THIS_THREAD.try_with(|own| own.set(own.get().wrapping_add(1)));
    }
}

#[inline]
fn gained(block: *mut u8, bytes: usize) -> *mut u8 {
    if !block.is_null() {
        LIVE_BYTES.fetch_add(bytes as u64, Ordering::Relaxed);
    }
    block
}

#[inline]
fn lost(bytes: usize) {
    LIVE_BYTES.fetch_sub(bytes as u64, Ordering::Relaxed);
}

// SAFETY: every request goes unchanged to `System`, which keeps the contract; the counters touch no allocated memory.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps `alloc`'s contract, handed on unchanged.
        gained(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps `alloc_zeroed`'s contract, handed on unchanged.
        gained(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count();
        // SAFETY: `block` came from `System` through this allocator; the caller keeps the rest of `realloc`'s contract.
        let moved = gained(unsafe { System.realloc(block, layout, new_size) }, new_size);
        if !moved.is_null() {
            lost(layout.size());
        }
        moved
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: `block` came from `System` through this allocator with this layout.
        unsafe { System.dealloc(block, layout) }
        lost(layout.size());
    }
}

/// Allocations made inside real-time scopes since the program started, all threads together.
///
/// Zero for ever where [`CountingAllocator`] is not installed; see [`is_installed`].
#[must_use]
pub fn allocations() -> u64 {
    REAL_TIME.load(Ordering::Relaxed)
}

/// All allocations of the program since it started.
#[must_use]
pub fn total_allocations() -> u64 {
    TOTAL.load(Ordering::Relaxed)
}

/// Bytes of the heap that Rust holds now, as they were asked for. Zero for ever where [`CountingAllocator`] is not installed.
#[must_use]
pub fn live_bytes() -> u64 {
    LIVE_BYTES.load(Ordering::Relaxed)
}

/// Whether the program counts: a zero of [`allocations`] means something only then.
#[must_use]
pub fn is_installed() -> bool {
    let before = total_allocations();
    drop(std::hint::black_box(Box::new(0_u8)));
    total_allocations() != before
}

/// Runs `work` as if outside every scope: for what is real-time on a thread of its own only.
pub fn outside_scopes<T>(work: impl FnOnce() -> T) -> T {
    let scopes = SCOPES.with(|scopes| scopes.replace(0));
    let result = work();
    SCOPES.with(|now| now.set(scopes));
    result
}

/// While it lives, the allocations of its thread are counted as real-time ones. Scopes nest.
#[derive(Debug)]
pub struct RealTimeScope {
    own_before: u64,
    // The scope belongs to the thread that opened it.
    not_send: PhantomData<*const ()>,
}

impl RealTimeScope {
    /// Declares the calling thread real-time until the scope is dropped.
    #[must_use = "the thread is real-time only while the scope lives"]
    pub fn enter() -> Self {
        SCOPES.with(|scopes| scopes.set(scopes.get().saturating_add(1)));
        Self {
            own_before: ON_THIS_THREAD.with(Cell::get),
            not_send: PhantomData,
        }
    }

    /// Allocations of this thread since the scope was entered.
    #[must_use]
    pub fn allocations(&self) -> u64 {
        ON_THIS_THREAD.with(Cell::get).wrapping_sub(self.own_before)
    }
}

impl Drop for RealTimeScope {
    fn drop(&mut self) {
        SCOPES.with(|scopes| scopes.set(scopes.get().saturating_sub(1)));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[global_allocator]
    static COUNTING: CountingAllocator = CountingAllocator;

    fn allocate() {
        drop(std::hint::black_box(vec![1_u8; 64]));
    }

    #[test]
    fn only_real_time_scopes_count() {
        assert!(is_installed());
        allocate();
        let scope = RealTimeScope::enter();
        assert_eq!(scope.allocations(), 0);
        allocate();
        assert_eq!(scope.allocations(), 1);
        let inner = RealTimeScope::enter();
        allocate();
        assert_eq!(inner.allocations(), 1);
        drop(inner);
        allocate();
        assert_eq!(scope.allocations(), 3);
        drop(scope);
        allocate();
        assert_eq!(RealTimeScope::enter().allocations(), 0);
    }

    #[test]
    fn another_thread_is_not_counted_unless_it_asks() {
        let scope = RealTimeScope::enter();
        let before = allocations();
        std::thread::scope(|threads| {
            let counted = threads.spawn(|| {
                let scope = RealTimeScope::enter();
                allocate();
                scope.allocations()
            });
            assert_eq!(counted.join().unwrap(), 1);
            let quiet = threads.spawn(|| {
                allocate();
                ON_THIS_THREAD.with(Cell::get)
            });
            assert_eq!(quiet.join().unwrap(), 0);
        });
        assert!(allocations() > before);
        drop(scope);
    }

    #[test]
    fn live_bytes_follow_what_is_held() {
        // Other tests allocate beside this one: the blocks are far bigger than theirs.
        const BYTES: u64 = 256 << 20;
        let near = |before: u64, grown: u64| live_bytes().abs_diff(before + grown) < BYTES / 2;
        let before = live_bytes();
        let mut block: Vec<u8> = Vec::with_capacity(1 << 28);
        assert!(near(before, BYTES));
        block.reserve_exact(1 << 29);
        assert!(near(before, 2 * BYTES));
        drop(block);
        assert!(near(before, 0));
    }

    #[test]
    fn growing_counts_as_an_allocation() {
        let mut values: Vec<u64> = Vec::with_capacity(1);
        let scope = RealTimeScope::enter();
        values.push(1);
        assert_eq!(scope.allocations(), 0);
        values.reserve_exact(1000);
        assert_eq!(scope.allocations(), 1);
    }
}
