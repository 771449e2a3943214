//! Stage 8, emit: the free-space message and its CAN frames.
