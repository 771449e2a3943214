//! The problem at half resolution: capacities summed over 2x2 pixels.

use super::GridProblem;

/// Where [`halve`] puts the capacities, `[height.div_ceil(2), width.div_ceil(2)] i32` each.
#[derive(Debug)]
pub struct Halved<'a> {
    /// See [`GridProblem::source`].
    pub source: &'a mut [i32],
    /// See [`GridProblem::sink`].
    pub sink: &'a mut [i32],
    /// See [`GridProblem::right`].
    pub right: &'a mut [i32],
    /// See [`GridProblem::down`].
    pub down: &'a mut [i32],
}

/// Sums `problem` over 2x2 pixels: its energy is that of the full problem for labels that are equal in each block.
pub fn halve(problem: &GridProblem<'_>, half: &mut Halved<'_>) {
    let width = problem.width.div_ceil(2);
    for part in [&mut half.source, &mut half.sink, &mut half.right, &mut half.down] {
        part.fill(0);
    }
    for y in 0..problem.height {
        for x in 0..problem.width {
            let (p, q) = (y * problem.width + x, y / 2 * width + x / 2);
            half.source[q] += problem.source[p];
            half.sink[q] += problem.sink[p];
            if x % 2 == 1 && x + 1 < problem.width {
                half.right[q] += problem.right[p];
            }
            if y % 2 == 1 && y + 1 < problem.height {
                half.down[q] += problem.down[p];
            }
        }
    }
}
