//! The memory plan: what the process will hold for as long as it runs, by component, known before the first frame.
//!
//! In: the constructors themselves, run through [`MemoryPlan::measure`] (Rust's heap, by the counting allocator) and
//! [`MemoryPlan::measure_library`] (the heap of a C library, and its mappings); the stacks, from the configuration; the
//! mapped files, from the kernel. Out: a table, and a total that [`locked_bytes`] must meet within [`TOLERANCE`]. Invariant:
//! each byte stands in one row, and the rows add up to what a memory lock counts: whole mappings, touched or not. Cost: once,
//! at start. For later: [`ProcessMemory`] (growth), [`PageFaults`] (of one thread), [`library_heap_bytes`] (does not grow).

mod process;

pub use process::{PageFaults, ProcessMemory, library_heap_bytes, locked_bytes};

use std::fmt;

use process::{CHeap, Mappings};

use super::allocation::live_bytes;
use super::rights::{RealTimeConfig, ThreadRole};

/// How far the locked memory may lie from the plan, as a part of it.
pub const TOLERANCE: f64 = 0.1;

/// What kind of memory a row of the plan is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PartKind {
    /// A component's blocks on the heap.
    Heap,
    /// A C library's blocks and mappings.
    Library,
    /// Stacks of the threads.
    Stack,
    /// Files mapped: program and libraries.
    File,
    /// Memory that readers map too.
    Shared,
    /// What was freed at start and stays, and what has no other row.
    Rest,
}

/// One row of the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Part {
    /// Component.
    pub name: &'static str,
    /// Kind.
    pub kind: PartKind,
    /// Bytes it holds.
    pub bytes: u64,
}

/// The plan, filled as components are constructed.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct MemoryPlan {
    parts: Vec<Part>,
}

/// What grew while something was constructed.
#[derive(Clone, Copy)]
struct Growth {
    heap: CHeap,
    outside_bytes: u64,
}

impl Growth {
    fn begin() -> Self {
        let heap = CHeap::now();
        Self {
            heap,
            outside_bytes: outside_heap(&Mappings::now(), &heap),
        }
    }

    fn library_bytes(self) -> u64 {
        let now = Self::begin();
        let heap = now.heap.used_bytes.saturating_sub(self.heap.used_bytes);
        heap + now.outside_bytes.saturating_sub(self.outside_bytes)
    }
}

/// Mappings without a file that the heap is not made of: stacks, and what libraries map themselves.
const fn outside_heap(mappings: &Mappings, heap: &CHeap) -> u64 {
    mappings.anonymous_bytes.saturating_sub(heap.mapped_bytes())
}

impl MemoryPlan {
    /// An empty plan.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Constructs a component, and notes what it holds of the heap. Other threads must not allocate meanwhile.
    ///
    /// Rows of the same name add up. Measures do not nest.
    pub fn measure<T>(&mut self, name: &'static str, make: impl FnOnce() -> T) -> T {
        let before = live_bytes();
        let made = make();
        let bytes = live_bytes().saturating_sub(before);
        self.add(name, PartKind::Heap, bytes);
        made
    }

    /// Constructs and warms up what a C library does, and notes all that it holds: its blocks, its threads, its mappings.
    pub fn measure_library<T>(&mut self, name: &'static str, make: impl FnOnce() -> T) -> T {
        let before = Growth::begin();
        let made = make();
        self.add(name, PartKind::Library, before.library_bytes());
        made
    }

    /// Adds the stacks of threads that are yet to start, each with its guard page.
    pub fn stacks(&mut self, config: &RealTimeConfig, roles: &[ThreadRole]) {
        let bytes = (roles.iter())
            .map(|role| u64::from(config.of(*role).stack_kib) * 1024 + 4096)
            .sum();
        self.add("stacks of the threads", PartKind::Stack, bytes);
    }

    /// Adds what no constructor showed: mapped files, the rest of the heap, mappings of their own. Call it when all is
    /// constructed and locked, and before the threads start.
    pub fn complete(&mut self) {
        let mappings = Mappings::now();
        let heap = CHeap::now();
        let in_use = heap.used_bytes + outside_heap(&mappings, &heap);
        let unmeasured =
            in_use.saturating_sub(self.bytes_of(PartKind::Heap) + self.bytes_of(PartKind::Library));
        self.add("program", PartKind::File, mappings.program_bytes);
        self.add(
            "network library, its file",
            PartKind::File,
            mappings.network_library_bytes,
        );
        self.add("other libraries", PartKind::File, mappings.other_files_bytes);
        if mappings.shared_bytes > 0 {
            self.add(
                "shared memory for readers",
                PartKind::Shared,
                mappings.shared_bytes,
            );
        }
        self.add("everything else in use", PartKind::Rest, unmeasured);
        self.add("freed at start, kept", PartKind::Rest, heap.free_bytes);
    }

    fn add(&mut self, name: &'static str, kind: PartKind, bytes: u64) {
        match self.parts.iter_mut().find(|part| part.name == name) {
            Some(part) => part.bytes += bytes,
            None => self.parts.push(Part { name, kind, bytes }),
        }
    }

    /// Sum of the rows of a kind.
    #[must_use]
    pub fn bytes_of(&self, kind: PartKind) -> u64 {
        (self.parts.iter())
            .filter(|part| part.kind == kind)
            .map(|part| part.bytes)
            .sum()
    }

    /// The rows, in the order in which they were added.
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Sum of all rows.
    #[must_use]
    pub fn total_bytes(&self) -> u64 {
        self.parts.iter().map(|part| part.bytes).sum()
    }

    /// Whether so many locked bytes are what was planned.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "a ratio of sizes")]
    pub fn agrees_with(&self, locked_bytes: u64) -> bool {
        let planned = self.total_bytes() as f64;
        (locked_bytes as f64 - planned).abs() <= TOLERANCE * planned
    }
}

impl fmt::Display for MemoryPlan {
    #[expect(clippy::cast_precision_loss, reason = "megabytes")]
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut line =
            |name: &str, bytes: u64| writeln!(formatter, "  {name:<28}{:>9.2} MB", bytes as f64 * 1e-6);
        for part in &self.parts {
            line(part.name, part.bytes)?;
        }
        line("total", self.total_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Never touched, so that its size costs nothing.
    fn block(bytes: usize) -> Vec<u8> {
        std::hint::black_box(Vec::with_capacity(bytes))
    }

    #[test]
    fn a_component_is_charged_what_it_keeps() {
        let mut plan = MemoryPlan::new();
        let kept = plan.measure("map", || {
            let scratch = block(1 << 28);
            let kept = block(1 << 29);
            drop(scratch);
            kept
        });
        let also = plan.measure("map", || block(1 << 29));
        let [part] = plan.parts() else {
            unreachable!("rows of one name add up");
        };
        // Other tests allocate beside this one, far smaller blocks.
        assert!(part.bytes.abs_diff(1 << 30) < 1 << 27, "{}", part.bytes);
        drop((kept, also));
    }

    #[test]
    fn a_plan_is_met_within_its_tolerance_only() {
        let mut plan = MemoryPlan::new();
        plan.add("map", PartKind::Heap, 80_000_000);
        plan.add("program", PartKind::File, 20_000_000);
        assert!(plan.agrees_with(91_000_000) && plan.agrees_with(109_000_000));
        assert!(!plan.agrees_with(89_000_000) && !plan.agrees_with(111_000_000));
        let table = plan.to_string();
        assert!(table.contains("map") && table.ends_with("100.00 MB\n"), "{table}");
    }
}
