//! The deadline: what may still start, when refinement ends, and what is published when an answer is late.
//!
//! [`Slices`] turns the table of [`crate::budget::SLICES`] into instants; [`Publisher`] decides what leaves for each key frame,
//! and when. Both are plain arithmetic on the time that they are given.

mod publisher;
mod slices;

pub use publisher::{Announcement, Cause, Due, Publisher, Verdict};
pub use slices::Slices;
