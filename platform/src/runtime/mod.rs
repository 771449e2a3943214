//! What the running program stands on: threads, memory, allocations.

pub mod allocation;
