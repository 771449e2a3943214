//! Tests of the devices as a whole.
