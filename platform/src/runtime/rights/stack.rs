//! A stack that is in memory before it is needed: every page of it is written to once.

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
