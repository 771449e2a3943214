//! Proof that the core needs no standard library: this static library brings its own panic handler and allocator, and a
//! second panic handler, which std would bring, is an error of the compiler (`duplicate lang item`).
#![no_std]

extern crate alloc;

use core::alloc::{GlobalAlloc, Layout};

struct NoHeap;

// SAFETY: returning null is how an allocator reports that it has no memory.
unsafe impl GlobalAlloc for NoHeap {
    unsafe fn alloc(&self, _layout: Layout) -> *mut u8 {
        core::ptr::null_mut()
    }

    unsafe fn dealloc(&self, _pointer: *mut u8, _layout: Layout) {}
}

#[global_allocator]
static HEAP: NoHeap = NoHeap;

#[panic_handler]
fn panic(_info: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// Pulls the core in.
#[unsafe(no_mangle)]
pub extern "C" fn freespace_mount_height_mm(height_m: f64) -> f64 {
    let mount = freespace::space::Mount {
        height_m,
        ahead_m: 0.0,
        left_m: 0.0,
        pitch_rad: 0.0,
        yaw_rad: 0.0,
        roll_rad: 0.0,
    };
    mount.plane_in_camera().offset_m * 1000.0
}
