//! ONNX Runtime's memory arena, grown by what is asked of it instead of to the next power of two.
//!
//! In: the library's environment. Out: the allocator that its sessions share. Cost: once, before the first session. Source:
//! `OrtApi::CreateArenaCfgV2`, `OrtApi::CreateAndRegisterAllocator`.

use std::ptr::null_mut;

use ort::AsPointer as _;
use ort::environment::Environment;
use ort::memory::{AllocationDevice, AllocatorType, MemoryInfo, MemoryType};
use ort::sys::{OrtArenaCfg, OrtStatusPtr};

/// Grow by the block that is asked for (`kSameAsRequested`).
const SAME_AS_REQUESTED: usize = 1;

/// Registers the arena with the environment; sessions use it where they are made `with_env_allocators`.
///
/// # Errors
/// What the library refused, by the name of its function.
pub(super) fn register(environment: &mut Environment) -> Result<(), &'static str> {
    let keys = [c"arena_extend_strategy".as_ptr()];
    let values = [SAME_AS_REQUESTED];
    let mut arena: *mut OrtArenaCfg = null_mut();
    let info = MemoryInfo::new(
        AllocationDevice::CPU,
        0,
        AllocatorType::Arena,
        MemoryType::Default,
    )
    .map_err(|_| "CreateMemoryInfo")?;
    let api = ort::api();
    // SAFETY: keys and values are as many as is said, and live until the call returns; it writes one pointer.
    let made = unsafe { (api.CreateArenaCfgV2)(keys.as_ptr(), values.as_ptr(), keys.len(), &raw mut arena) };
    is_ok(made).then_some(()).ok_or("CreateArenaCfgV2")?;
    // SAFETY: environment and memory info are the library's own, alive here; the arena's settings were made above.
    let registered = unsafe { (api.CreateAndRegisterAllocator)(environment.ptr_mut(), info.ptr(), arena) };
    // SAFETY: made above, used for the last time.
    unsafe { (api.ReleaseArenaCfg)(arena) };
    is_ok(registered)
        .then_some(())
        .ok_or("CreateAndRegisterAllocator")
}

/// Whether a call went well; a status that says otherwise is released.
fn is_ok(status: OrtStatusPtr) -> bool {
    if status.0.is_null() {
        return true;
    }
    // SAFETY: a status is the caller's to release, once.
    unsafe { (ort::api().ReleaseStatus)(status.0) };
    false
}
