//! Small dense normal equations, solved in place.
//!
//! In: the lower triangle of a symmetric positive definite matrix, row-major. Out: the solution in place of the right
//! side. Cost n^3 / 6 multiplications, n at most six times [`crate::budget::WINDOW_VIEWS`]. A matrix that is not positive
//! definite (or not finite) is refused, never divided by.

/// Inner product with four running sums, so that it need not wait for each addition.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a4
        .remainder()
        .iter()
        .zip(b4.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in a4.zip(b4) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Replaces each of the right sides (one after the other, `n` long) by its solution; false where `a` is not positive
/// definite.
pub(super) fn solve_cholesky(a: &mut [f64], n: usize, right_sides: &mut [f64]) -> bool {
    for i in 0..n {
        for j in 0..=i {
            let sum = a[i * n + j] - dot(&a[i * n..i * n + j], &a[j * n..j * n + j]);
            if i == j {
                if !(sum > 1e-300 && sum.is_finite()) {
                    return false;
                }
                a[i * n + i] = num_traits::Float::sqrt(sum);
            } else {
                a[i * n + j] = sum / a[j * n + j];
            }
        }
    }
    for x in right_sides.chunks_exact_mut(n) {
        for i in 0..n {
            x[i] = (x[i] - dot(&a[i * n..i * n + i], &x[..i])) / a[i * n + i];
        }
        for i in (0..n).rev() {
            x[i] /= a[i * n + i];
            let solved = x[i];
            for k in 0..i {
                x[k] -= a[i * n + k] * solved;
            }
        }
    }
    right_sides.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solution_satisfies_the_equations(values in prop::collection::vec(-1.0..1.0f64, 49), x in prop::collection::vec(-5.0..5.0f64, 14)) {
            let n = 7;
            let mut a = [0.0; 49];
            for i in 0..n {
                for j in 0..n {
                    a[i * n + j] = (0..n).map(|k| values[i * n + k] * values[j * n + k]).sum::<f64>() + if i == j { 0.1 } else { 0.0 };
                }
            }
            let mut b = [0.0; 14];
            for side in 0..2 {
                for i in 0..n {
                    b[side * n + i] = (0..n).map(|k| a[i * n + k] * x[side * n + k]).sum();
                }
            }
            prop_assert!(solve_cholesky(&mut a, n, &mut b));
            for k in 0..14 {
                prop_assert!((b[k] - x[k]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn indefinite_and_nan_are_refused() {
        assert!(!solve_cholesky(&mut [1.0, 0.0, 2.0, 1.0], 2, &mut [1.0, 1.0]));
        assert!(!solve_cholesky(&mut [f64::NAN], 1, &mut [1.0]));
    }
}
