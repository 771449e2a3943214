//! The same for C, and for whatever can call C: `include/freespace.h` describes it.
//!
//! Invariant: no panic crosses into C; a reader that was opened is closed once. A code is 0, [`NOTHING`], or an error's.

use core::ffi::{CStr, c_char, c_int};
use core::ptr;
use core::time::Duration;
use std::panic::{AssertUnwindSafe, catch_unwind};

use freespace::emit::SharedMessage;

use crate::error::ReaderError;
use crate::reader::{Message, Reader, monotonic_now};
use crate::service::DEFAULT_NAME;

/// It worked.
pub const OK: c_int = 0;
/// No message came in time.
pub const NOTHING: c_int = 1;
/// A pointer is null, or a name is no text.
pub const BAD_ARGUMENT: c_int = -7;

const fn code(error: ReaderError) -> c_int {
    match error {
        ReaderError::NoModule => -1,
        ReaderError::BadName => -2,
        ReaderError::TooManyReaders => -3,
        ReaderError::WrongLayout => -4,
        ReaderError::NotPermitted => -5,
        ReaderError::Failed => -6,
    }
}

/// Codes by name, with what each says, for the header.
pub const CODES: [(&str, c_int, &str); 9] = [
    ("OK", OK, "it worked"),
    ("NOTHING", NOTHING, "no message came in time, or a signal came"),
    (
        "NO_MODULE",
        -1,
        "nobody publishes under this name: start the module, or correct the name",
    ),
    ("BAD_NAME", -2, "this is no name of a service"),
    (
        "TOO_MANY_READERS",
        -3,
        "no room for another reader: raise max_readers in [shared_memory]",
    ),
    (
        "WRONG_LAYOUT",
        -4,
        "the module publishes another layout: build both from one version",
    ),
    (
        "NOT_PERMITTED",
        -5,
        "the shared memory may not be opened: run as the module's user",
    ),
    (
        "FAILED",
        -6,
        "the shared memory failed: look at the room in /dev/shm, open the reader anew",
    ),
    (
        "BAD_ARGUMENT",
        BAD_ARGUMENT,
        "a pointer is null, or a name is no text",
    ),
];

/// A reader as C holds it.
pub struct CReader {
    reader: Reader,
    held: Option<Message>,
}

fn guarded(work: impl FnOnce() -> Result<c_int, ReaderError>) -> c_int {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(done)) => done,
        Ok(Err(error)) => code(error),
        Err(_) => code(ReaderError::Failed),
    }
}

/// Opens a reader; a null name is `freespace/grid`.
///
/// # Safety
/// `name` is null or a C string; `reader` is null or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn freespace_reader_open(name: *const c_char, reader: *mut *mut CReader) -> c_int {
    if reader.is_null() {
        return BAD_ARGUMENT;
    }
    let name = if name.is_null() {
        Ok(DEFAULT_NAME)
    } else {
        // SAFETY: not null, so the caller's C string.
        unsafe { CStr::from_ptr(name) }.to_str()
    };
    let Ok(name) = name else {
        return BAD_ARGUMENT;
    };
    guarded(|| {
        let opened = CReader {
            reader: Reader::open(name)?,
            held: None,
        };
        // SAFETY: not null, so the caller's to be written to.
        unsafe { reader.write(Box::into_raw(Box::new(opened))) };
        Ok(OK)
    })
}

/// Waits for a message; the pointer is good until the next call with this reader.
///
/// # Safety
/// `reader` is null or an open reader that no other thread uses; `message` is null or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn freespace_reader_next(
    reader: *mut CReader,
    timeout_micros: u64,
    message: *mut *const SharedMessage,
) -> c_int {
    // SAFETY: null or an open reader, this thread's alone.
    let (Some(reader), false) = (unsafe { reader.as_mut() }, message.is_null()) else {
        return BAD_ARGUMENT;
    };
    // SAFETY: not null, so the caller's to be written to.
    unsafe { message.write(ptr::null()) };
    guarded(|| {
        reader.held = None;
        let timeout = Duration::from_micros(timeout_micros);
        reader.held = reader.reader.next(timeout)?;
        let Some(held) = &reader.held else {
            return Ok(NOTHING);
        };
        // SAFETY: not null, so the caller's to be written to.
        unsafe { message.write(ptr::from_ref::<SharedMessage>(held)) };
        Ok(OK)
    })
}

/// Closes a reader; null is none.
///
/// # Safety
/// `reader` is null, or came from [`freespace_reader_open`] and was not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn freespace_reader_close(reader: *mut CReader) {
    if reader.is_null() {
        return;
    }
    guarded(|| {
        // SAFETY: it came from `Box::into_raw`, once.
        drop(unsafe { Box::from_raw(reader) });
        Ok(OK)
    });
}

/// Microseconds from the capture of a message until now.
///
/// # Safety
/// `message` is null or a message that is held.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn freespace_age_micros(message: *const SharedMessage) -> u64 {
    // SAFETY: null or a message that is held.
    let message = unsafe { message.as_ref() };
    message.map_or(u64::MAX, |message| message.age_micros(monotonic_now()))
}

/// Free distance straight ahead, metres: the least of the sectors within `half_rad` of it; 0 where the grid is not to be used.
///
/// # Safety
/// `message` is null or a message that is held.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn freespace_free_ahead_m(message: *const SharedMessage, half_rad: f32) -> f32 {
    // SAFETY: null or a message that is held.
    let message = unsafe { message.as_ref() };
    message.map_or(0.0, |message| message.free_ahead_m(half_rad))
}
