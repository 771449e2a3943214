//! One suite for every wheel port, one for every sink on CAN: the simulated, those of logs, and a real interface.
//!
//! The interface is named by `FREESPACE_TEST_CAN`, such as `vcan0` (up, mtu 72); without it the real ones are skipped by name.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod e2e;
mod interface;
mod rig;
mod sinks;
mod wheels;
