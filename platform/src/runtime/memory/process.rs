//! What the kernel and the C library say of the process's memory.

use std::fs::File;
use std::io::Read as _;
use std::mem::MaybeUninit;

use crate::runtime::allocation::live_bytes;

/// Memory of the process, from `/proc/self/status`. Zero where the kernel does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ProcessMemory {
    /// Locked in RAM (`VmLck`): whole mappings, touched or not.
    pub locked_bytes: u64,
    /// In RAM (`VmRSS`).
    pub resident_bytes: u64,
    /// Most that was ever in RAM (`VmHWM`).
    pub peak_resident_bytes: u64,
    /// Paged out (`VmSwap`).
    pub swapped_bytes: u64,
    /// Mapped (`VmSize`).
    pub mapped_bytes: u64,
}

impl ProcessMemory {
    /// As it is now. Makes no allocation, but reads a file: not for a real-time thread.
    #[must_use]
    pub fn now() -> Self {
        // The file has about 1.5 kB; what we read stands in its first half.
        let mut buffer = [0_u8; 4096];
        let length = File::open("/proc/self/status")
            .and_then(|mut file| file.read(&mut buffer))
            .unwrap_or(0);
        let text = str::from_utf8(&buffer[..length]).unwrap_or_default();
        Self::parse(text)
    }

    fn parse(status: &str) -> Self {
        let mut memory = Self::default();
        for line in status.lines() {
            let Some((key, value)) = line.split_once(':') else {
                continue;
            };
            let field = match key {
                "VmLck" => &mut memory.locked_bytes,
                "VmRSS" => &mut memory.resident_bytes,
                "VmHWM" => &mut memory.peak_resident_bytes,
                "VmSwap" => &mut memory.swapped_bytes,
                "VmSize" => &mut memory.mapped_bytes,
                _ => continue,
            };
            let kibibytes: u64 = (value.split_whitespace().next())
                .and_then(|number| number.parse().ok())
                .unwrap_or(0);
            *field = kibibytes * 1024;
        }
        memory
    }

    /// How much more is in RAM than was at `earlier`; negative where less is.
    #[must_use]
    pub fn resident_growth_since(&self, earlier: &Self) -> i64 {
        self.resident_bytes.cast_signed() - earlier.resident_bytes.cast_signed()
    }
}

/// Bytes of memory locked in RAM.
#[must_use]
pub fn locked_bytes() -> u64 {
    ProcessMemory::now().locked_bytes
}

/// Page faults of a thread since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PageFaults {
    /// Served from memory.
    pub minor: u64,
    /// Served from disk.
    pub major: u64,
}

impl PageFaults {
    /// Those of the calling thread: one system call, no allocation.
    #[must_use]
    pub fn of_this_thread() -> Self {
        let mut usage = MaybeUninit::<libc::rusage>::zeroed();
        // SAFETY: the call writes one `rusage`, which the pointer has room for.
        let result = unsafe { libc::getrusage(libc::RUSAGE_THREAD, usage.as_mut_ptr()) };
        if result != 0 {
            return Self::default();
        }
        // SAFETY: all bytes were zeroed, a valid `rusage`, before the call wrote to them.
        let usage = unsafe { usage.assume_init() };
        Self {
            minor: u64::try_from(usage.ru_minflt).unwrap_or(0),
            major: u64::try_from(usage.ru_majflt).unwrap_or(0),
        }
    }

    /// Those since `earlier`.
    #[must_use]
    pub const fn since(&self, earlier: &Self) -> Self {
        Self {
            minor: self.minor.saturating_sub(earlier.minor),
            major: self.major.saturating_sub(earlier.major),
        }
    }

    /// Both kinds.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.minor + self.major
    }
}

/// The C library's heap, which Rust's own allocations come from too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct CHeap {
    /// In use, by Rust and by C and C++ libraries.
    pub(super) used_bytes: u64,
    /// Free, and kept.
    pub(super) free_bytes: u64,
}

impl CHeap {
    pub(super) fn now() -> Self {
        // SAFETY: the call takes the allocator's own lock and returns numbers.
        let info = unsafe { libc::mallinfo2() };
        Self {
            used_bytes: (info.uordblks + info.hblkhd) as u64,
            free_bytes: info.fordblks as u64,
        }
    }

    pub(super) const fn mapped_bytes(&self) -> u64 {
        self.used_bytes + self.free_bytes
    }
}

/// Bytes that C and C++ libraries hold of `malloc`: all that is in use but not by Rust.
///
/// The network library makes about 145 small allocations a run and frees them within it, so that between runs this does not
/// grow. It takes the allocator's lock: for the monitor. Zero for ever where the counting allocator is not installed.
#[must_use]
pub fn library_heap_bytes() -> u64 {
    if live_bytes() == 0 {
        return 0;
    }
    CHeap::now().used_bytes.saturating_sub(live_bytes())
}

/// Mappings of the process, as they count for a memory lock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Mappings {
    /// The program's own file.
    pub(super) program_bytes: u64,
    /// The network library's file.
    pub(super) network_library_bytes: u64,
    /// Other files: shared libraries, locales.
    pub(super) other_files_bytes: u64,
    /// What `/dev/shm` holds for other processes too.
    pub(super) shared_bytes: u64,
    /// Mappings without a file: heap, stacks, big blocks.
    pub(super) anonymous_bytes: u64,
}

impl Mappings {
    pub(super) fn now() -> Self {
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
        let program = std::env::current_exe().ok();
        let program = program.as_deref().and_then(std::path::Path::to_str);
        Self::parse(&maps, program.unwrap_or_default())
    }

    fn parse(maps: &str, program: &str) -> Self {
        let mut mappings = Self::default();
        for line in maps.lines() {
            let mut fields = line.split_whitespace();
            let Some(bytes) = fields.next().and_then(bytes_of) else {
                continue;
            };
            // Permissions, offset, device and inode stand between the range and the path.
            let path = fields.nth(4).unwrap_or_default();
            let field = if path.starts_with("[v") {
                // The kernel's own pages (vdso, vvar, vsyscall) are never locked.
                continue;
            } else if !path.starts_with('/') {
                &mut mappings.anonymous_bytes
            } else if path.starts_with("/dev/shm/") {
                &mut mappings.shared_bytes
            } else if path == program {
                &mut mappings.program_bytes
            } else if path.contains("onnxruntime") {
                &mut mappings.network_library_bytes
            } else {
                &mut mappings.other_files_bytes
            };
            *field += bytes;
        }
        mappings
    }
}

/// Length of an address range as `/proc/self/maps` writes it.
fn bytes_of(range: &str) -> Option<u64> {
    let (from, to) = range.split_once('-')?;
    let address = |text| u64::from_str_radix(text, 16).ok();
    address(to)?.checked_sub(address(from)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_words_are_read() {
        let memory = ProcessMemory::parse(
            "Name:\tfreespace\nVmSize:\t  200 kB\nVmLck:\t  100 kB\nVmHWM:\t 90 kB\nVmRSS:\t 80 kB\nVmSwap:\t 0 kB\n",
        );
        assert_eq!(memory.locked_bytes, 102_400);
        assert_eq!(
            (memory.resident_bytes, memory.peak_resident_bytes),
            (81_920, 92_160)
        );
        let later = ProcessMemory {
            resident_bytes: 81_000,
            ..memory
        };
        assert_eq!(later.resident_growth_since(&memory), -920);
        assert!(ProcessMemory::now().resident_bytes > 0);
    }

    #[test]
    fn mappings_are_told_apart() {
        let mappings = Mappings::parse(
            "\
00400000-00402000 r-xp 00000000 08:01 1 /usr/bin/freespace
7f0000000000-7f0000003000 r-xp 00000000 08:01 2 /opt/.runtime/libonnxruntime.so.1.31.1
7f0000003000-7f0000004000 r--p 00000000 08:01 3 /usr/lib/libc.so.6
7f0000005000-7f000000a000 rw-s 00000000 00:1a 4 /dev/shm/grid.data
00500000-00508000 rw-p 00000000 00:00 0 [heap]
7f0000010000-7f0000011000 rw-p 00000000 00:00 0
7fff00000000-7fff00002000 r-xp 00000000 00:00 0 [vdso]
",
            "/usr/bin/freespace",
        );
        assert_eq!(
            mappings,
            Mappings {
                program_bytes: 0x2000,
                network_library_bytes: 0x3000,
                other_files_bytes: 0x1000,
                shared_bytes: 0x5000,
                anonymous_bytes: 0x9000,
            }
        );
    }

    #[test]
    fn a_block_that_a_c_library_keeps_is_seen_apart_from_rusts() {
        // Never touched, so that its size costs nothing.
        const BYTES: usize = 256 << 20;
        let before = library_heap_bytes();
        // SAFETY: the block is freed below and not used but for its address.
        let block = std::hint::black_box(unsafe { libc::malloc(BYTES) });
        let with = library_heap_bytes();
        let ours = std::hint::black_box(Vec::<u8>::with_capacity(BYTES));
        let with_ours = library_heap_bytes();
        drop(ours);
        // SAFETY: the block came from `malloc` above.
        unsafe { libc::free(block) };
        // Other tests allocate beside this one, far smaller blocks.
        let near = |grown: u64| grown.abs_diff(BYTES as u64) < BYTES as u64 / 2;
        assert!(near(with - before), "{before} {with}");
        assert!(near(with_ours - before), "{before} {with_ours}");
    }

    #[test]
    fn a_first_touch_is_a_page_fault() {
        let mut block = vec![0_u8; 64 << 20];
        let before = PageFaults::of_this_thread();
        for page in block.iter_mut().step_by(4096) {
            *page = 1;
        }
        std::hint::black_box(&block);
        assert!(PageFaults::of_this_thread().since(&before).total() > 0);
    }
}
