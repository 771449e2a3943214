//! Stacks: every page of ours written to once, so that it is in memory before it is needed; those of a library's threads small.

use std::hint::black_box;
use std::mem::MaybeUninit;

/// Bytes left untouched at the end, for the deepest call's own frame and a signal handler.
const MARGIN: usize = 32 * 1024;

/// Bytes of one call of [`descend`]; the compiler's stack probes touch each page of it.
const STEP: usize = 4096;

/// Touches `bytes` of the calling thread's stack, below where it is now.
///
/// # Errors
/// `ENOMEM` where the stack is smaller than that (what there is has been touched), or why its size cannot be read.
pub(super) fn touch(bytes: usize) -> Result<(), i32> {
    let (left, size) = left()?;
    let wanted = bytes.saturating_sub(size - left);
    descend(wanted.min(left).saturating_sub(MARGIN));
    // A thread's own data and guard come out of its stack: one page less is what it was given.
    if size + STEP < bytes {
        Err(libc::ENOMEM)
    } else {
        Ok(())
    }
}

#[inline(never)]
fn descend(bytes: usize) {
    let page = black_box([0_u8; STEP]);
    if bytes > STEP {
        descend(bytes - STEP);
    }
    // Used after the call, so that the frame stays and the call is no loop.
    black_box(&page);
}

unsafe extern "C" {
    fn pthread_getattr_default_np(attributes: *mut libc::pthread_attr_t) -> libc::c_int;
    fn pthread_setattr_default_np(attributes: *const libc::pthread_attr_t) -> libc::c_int;
}

/// Runs `start`, which starts threads that do not say how big their stack is: they get `bytes` instead of the 8 MB of
/// `ulimit -s`, all of which a memory lock would hold in RAM.
pub(super) fn with_default_size<T>(bytes: usize, start: impl FnOnce() -> T) -> T {
    let before = replace_default_size(bytes);
    let started = start();
    if let Some(before) = before {
        replace_default_size(before);
    }
    started
}

/// The size that was the default; none where it stays as it is, which costs memory and nothing else.
fn replace_default_size(bytes: usize) -> Option<usize> {
    let mut attributes = MaybeUninit::<libc::pthread_attr_t>::uninit();
    // SAFETY: the call initialises the attributes, under the C library's own lock.
    if unsafe { pthread_getattr_default_np(attributes.as_mut_ptr()) } != 0 {
        return None;
    }
    let mut before = 0;
    // SAFETY: the attributes were initialised above; the size is written by the first call; the default is replaced under the
    // C library's own lock; the attributes are not used after the last call.
    let is_set = unsafe {
        let is_set = libc::pthread_attr_getstacksize(attributes.as_ptr(), &raw mut before) == 0
            && libc::pthread_attr_setstacksize(attributes.as_mut_ptr(), bytes) == 0
            && pthread_setattr_default_np(attributes.as_ptr()) == 0;
        libc::pthread_attr_destroy(attributes.as_mut_ptr());
        is_set
    };
    is_set.then_some(before)
}

/// Bytes below here, and in all, of the calling thread's stack.
fn left() -> Result<(usize, usize), i32> {
    let mut attributes = MaybeUninit::<libc::pthread_attr_t>::uninit();
    // SAFETY: the attributes are written by the call, which reads only the calling thread's own descriptor.
    let result = unsafe { libc::pthread_getattr_np(libc::pthread_self(), attributes.as_mut_ptr()) };
    if result != 0 {
        return Err(result);
    }
    let mut low = std::ptr::null_mut();
    let mut size = 0;
    // SAFETY: the call above initialised the attributes; both results are written by the call.
    let result = unsafe { libc::pthread_attr_getstack(attributes.as_ptr(), &raw mut low, &raw mut size) };
    // SAFETY: the attributes were initialised above and are not used again.
    unsafe { libc::pthread_attr_destroy(attributes.as_mut_ptr()) };
    if result != 0 {
        return Err(result);
    }
    let here = std::ptr::from_ref(&size).addr();
    match here.checked_sub(low.addr()) {
        Some(left) if left <= size => Ok((left, size)),
        _ => Err(libc::ENOTSUP),
    }
}
