//! Stage 7, grid: road pixels to metres, fused over time.
