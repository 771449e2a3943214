//! The hardware-in-the-loop rig.
