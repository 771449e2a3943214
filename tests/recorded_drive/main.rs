//! Drives recorded in MCAP: nothing is lost between a drive and its replay, and a recording that goes wrong does no harm.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod files;
mod killed;
mod python;
mod replay;
mod rig;
#[path = "../simulated/mod.rs"]
mod simulated;
