//! Five-point relative pose: the essential matrices that five bearing pairs allow.
//!
//! In: five pairs of bearings, `first . E second = 0`. Out: at most ten essential matrices. Cost: one elimination of 10 x 20
//! and the real roots of a polynomial of degree ten, about ten microseconds. Degenerate samples give no or useless
//! matrices; whoever scores them notices. Source: Nister, *An efficient solution to the five-point relative pose problem*
//! (PAMI 2004); names of rows and columns as in its section 3.2, the roots are bracketed by those of the derivatives.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "a NaN must fail the comparison")]

use nalgebra::{Matrix3, SVector, Vector3};

/// Coefficients of x, y, z, 1.
type Linear = [f64; 4];
type Quadratic = [f64; 10];
type Cubic = [f64; 20];

/// Exponents of x, y, z.
type Exponents = [u8; 3];
const LINEAR: [Exponents; 4] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]];
const QUADRATIC: [Exponents; 10] = [
    [2, 0, 0],
    [0, 2, 0],
    [0, 0, 2],
    [1, 1, 0],
    [1, 0, 1],
    [0, 1, 1],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [0, 0, 0],
];
/// Nister's order: the first ten are eliminated.
const CUBIC: [Exponents; 20] = [
    [3, 0, 0],
    [0, 3, 0],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
    [2, 0, 0],
    [0, 2, 1],
    [0, 2, 0],
    [1, 1, 1],
    [1, 1, 0],
    [1, 0, 2],
    [1, 0, 1],
    [1, 0, 0],
    [0, 1, 2],
    [0, 1, 1],
    [0, 1, 0],
    [0, 0, 3],
    [0, 0, 2],
    [0, 0, 1],
    [0, 0, 0],
];

/// Where the product of monomial `i` of `a` and `j` of `b` stands in `product`.
const fn product_table<const A: usize, const B: usize, const P: usize>(
    a: &[Exponents; A],
    b: &[Exponents; B],
    product: &[Exponents; P],
) -> [[usize; B]; A] {
    let mut table = [[0; B]; A];
    let (mut i, mut j, mut k);
    i = 0;
    while i < A {
        j = 0;
        while j < B {
            k = 0;
            while k < P {
                let p = product[k];
                if a[i][0] + b[j][0] == p[0] && a[i][1] + b[j][1] == p[1] && a[i][2] + b[j][2] == p[2] {
                    table[i][j] = k;
                }
                k += 1;
            }
            j += 1;
        }
        i += 1;
    }
    table
}

const LINEAR_BY_LINEAR: [[usize; 4]; 4] = product_table(&LINEAR, &LINEAR, &QUADRATIC);
const QUADRATIC_BY_LINEAR: [[usize; 4]; 10] = product_table(&QUADRATIC, &LINEAR, &CUBIC);

fn add_product(a: &Linear, b: &Linear, factor: f64, out: &mut Quadratic) {
    for i in 0..4 {
        for j in 0..4 {
            out[LINEAR_BY_LINEAR[i][j]] += factor * a[i] * b[j];
        }
    }
}

fn add_cubic(a: &Quadratic, b: &Linear, out: &mut Cubic) {
    for i in 0..10 {
        for j in 0..4 {
            out[QUADRATIC_BY_LINEAR[i][j]] += a[i] * b[j];
        }
    }
}

/// Essential matrices of five bearing pairs.
pub(super) fn essential_matrices(
    first: &[Vector3<f64>; 5],
    second: &[Vector3<f64>; 5],
) -> heapless::Vec<Matrix3<f64>, 10> {
    let mut found = heapless::Vec::new();
    let Some(basis) = null_space(first, second) else {
        return found;
    };
    let mut rows = constraints(&basis);
    if !eliminate(&mut rows) {
        return found;
    }
    let b = [
        reduced_row(&rows[4], &rows[5]),
        reduced_row(&rows[6], &rows[7]),
        reduced_row(&rows[8], &rows[9]),
    ];
    let determinant = determinant(&b);
    for z in real_roots(&determinant) {
        let Some((x, y)) = unknowns(&b, z) else { continue };
        let e = basis[0] * x + basis[1] * y + basis[2] * z + basis[3];
        let norm = e.norm();
        if norm > 1e-12 && norm.is_finite() {
            // Ten roots at most, so there is always room.
            let _ = found.push(e / norm);
        }
    }
    found
}

/// Four orthonormal matrices that span the solutions of the five epipolar constraints.
fn null_space(first: &[Vector3<f64>; 5], second: &[Vector3<f64>; 5]) -> Option<[Matrix3<f64>; 4]> {
    let mut basis = [SVector::<f64, 9>::zeros(); 9];
    for k in 0..5 {
        let row = SVector::<f64, 9>::from_fn(|i, _| first[k][i / 3] * second[k][i % 3]);
        basis[k] = orthogonal(row, &basis[..k]);
        let norm = basis[k].norm();
        if !(norm > 1e-9) {
            return None;
        }
        basis[k] /= norm;
    }
    for k in 5..9 {
        // The unit vector that the basis spans least.
        let mut best = SVector::<f64, 9>::zeros();
        for axis in 0..9 {
            let mut unit = SVector::<f64, 9>::zeros();
            unit[axis] = 1.0;
            let candidate = orthogonal(unit, &basis[..k]);
            if candidate.norm_squared() > best.norm_squared() {
                best = candidate;
            }
        }
        basis[k] = best.normalize();
    }
    let matrix = |v: &SVector<f64, 9>| Matrix3::from_fn(|r, c| v[3 * r + c]);
    Some([
        matrix(&basis[5]),
        matrix(&basis[6]),
        matrix(&basis[7]),
        matrix(&basis[8]),
    ])
}

/// What of `v` lies outside the span of `basis`; twice, against cancellation.
fn orthogonal(mut v: SVector<f64, 9>, basis: &[SVector<f64, 9>]) -> SVector<f64, 9> {
    for _ in 0..2 {
        for b in basis {
            v -= b * b.dot(&v);
        }
    }
    v
}

/// `det E = 0` and `2 E E' E - trace(E E') E = 0` as cubics in x, y, z.
fn constraints(basis: &[Matrix3<f64>; 4]) -> [Cubic; 10] {
    let e = |r: usize, c: usize| -> Linear {
        [
            basis[0][(r, c)],
            basis[1][(r, c)],
            basis[2][(r, c)],
            basis[3][(r, c)],
        ]
    };
    let mut rows = [[0.0; 20]; 10];
    let mut eet = [[[0.0; 10]; 3]; 3];
    for i in 0..3 {
        for k in 0..3 {
            for j in 0..3 {
                add_product(&e(i, j), &e(k, j), 1.0, &mut eet[i][k]);
            }
        }
    }
    let mut half_trace = [0.0; 10];
    for m in 0..10 {
        half_trace[m] = 0.5 * (eet[0][0][m] + eet[1][1][m] + eet[2][2][m]);
    }
    for i in 0..3 {
        for m in 0..10 {
            eet[i][i][m] -= half_trace[m];
        }
    }
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                add_cubic(&eet[i][k], &e(k, j), &mut rows[3 * i + j]);
            }
        }
    }
    for j in 0..3 {
        let (b, c) = ((j + 1) % 3, (j + 2) % 3);
        let mut cofactor = [0.0; 10];
        add_product(&e(1, b), &e(2, c), 1.0, &mut cofactor);
        add_product(&e(1, c), &e(2, b), -1.0, &mut cofactor);
        add_cubic(&cofactor, &e(0, j), &mut rows[9]);
    }
    rows
}

/// Gauss-Jordan with partial pivoting over the first ten columns.
fn eliminate(rows: &mut [Cubic; 10]) -> bool {
    for column in 0..10 {
        let mut pivot = column;
        for r in column..10 {
            if rows[r][column].abs() > rows[pivot][column].abs() {
                pivot = r;
            }
        }
        let size = rows[pivot][column];
        if !(size.abs() > 1e-12) {
            return false;
        }
        rows.swap(column, pivot);
        for value in &mut rows[column][column..] {
            *value /= size;
        }
        let pivot_row = rows[column];
        for r in 0..10 {
            let factor = rows[r][column];
            if r != column && factor != 0.0 {
                for c in column..20 {
                    rows[r][c] -= factor * pivot_row[c];
                }
            }
        }
    }
    true
}

/// Row `e - z f`: polynomials in z, lowest power first, before x, y and 1.
fn reduced_row(e: &Cubic, f: &Cubic) -> [[f64; 5]; 3] {
    let (e, f) = (&e[10..], &f[10..]);
    [
        [e[2], e[1] - f[2], e[0] - f[1], -f[0], 0.0],
        [e[5], e[4] - f[5], e[3] - f[4], -f[3], 0.0],
        [e[9], e[8] - f[9], e[7] - f[8], e[6] - f[7], -f[6]],
    ]
}

fn determinant(b: &[[[f64; 5]; 3]; 3]) -> [f64; 11] {
    let mut sum = [0.0; 11];
    for (i, j, k, sign) in [
        (0, 1, 2, 1.0),
        (1, 2, 0, 1.0),
        (2, 0, 1, 1.0),
        (0, 2, 1, -1.0),
        (1, 0, 2, -1.0),
        (2, 1, 0, -1.0),
    ] {
        // Permutation of the columns x, y, 1 over the rows.
        let mut pair = [0.0; 9];
        for p in 0..5 {
            for q in 0..5 {
                pair[p + q] += b[0][i][p] * b[1][j][q];
            }
        }
        for p in 0..9 {
            for q in 0..5 {
                // Degrees 3, 3 and 4 only: what would land beyond ten is zero.
                if p + q <= 10 {
                    sum[p + q] += sign * pair[p] * b[2][k][q];
                }
            }
        }
    }
    sum
}

fn evaluate(p: &[f64], z: f64) -> f64 {
    p.iter().rev().fold(0.0, |sum, c| sum * z + c)
}

/// Real roots, those beyond one as inverses of the reversed polynomial's.
fn real_roots(p: &[f64; 11]) -> heapless::Vec<f64, 10> {
    let mut roots = heapless::Vec::new();
    for z in roots_within_one(p) {
        let _ = roots.push(z);
    }
    let mut reversed = *p;
    reversed.reverse();
    for inverse in roots_within_one(&reversed) {
        // A root of exactly one was found already.
        if inverse.abs() > 1e-9 && inverse.abs() < 1.0 {
            let _ = roots.push(1.0 / inverse);
        }
    }
    roots
}

/// Roots in [-1, 1]: between neighbouring roots of the derivative a polynomial crosses zero once at most.
fn roots_within_one(p: &[f64; 11]) -> heapless::Vec<f64, 10> {
    let mut roots: heapless::Vec<f64, 10> = heapless::Vec::new();
    for degree in 1..=10 {
        let mut derivative = *p;
        let mut length = 11;
        for _ in degree..10 {
            for k in 1..length {
                derivative[k - 1] = derivative[k] * k as f64;
            }
            length -= 1;
        }
        let polynomial = &derivative[..=degree];
        let mut next = heapless::Vec::new();
        let mut low = -1.0;
        for high in roots.iter().copied().chain([1.0]) {
            if let Some(root) = crossing(polynomial, low, high) {
                let _ = next.push(root);
            }
            low = high;
        }
        roots = next;
    }
    roots
}

/// The zero in (low, high]: Newton's method, kept inside the bracket by bisection.
fn crossing(p: &[f64], mut low: f64, mut high: f64) -> Option<f64> {
    let (at_low, at_high) = (evaluate(p, low), evaluate(p, high));
    if !(at_low * at_high < 0.0) {
        return (at_high == 0.0).then_some(high);
    }
    let mut z = 0.5 * (low + high);
    for _ in 0..60 {
        let (mut value, mut slope) = (0.0, 0.0);
        for c in p.iter().rev() {
            slope = slope * z + value;
            value = value * z + c;
        }
        if (value < 0.0) == (at_low < 0.0) {
            low = z;
        } else {
            high = z;
        }
        let newton = z - value / slope;
        let next = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
        if (next - z).abs() < 1e-14 {
            return Some(next);
        }
        z = next;
    }
    Some(z)
}

/// x and y where the three rows vanish at z: the cross product of the two rows that are least parallel.
fn unknowns(b: &[[[f64; 5]; 3]; 3], z: f64) -> Option<(f64, f64)> {
    let row = |r: usize| Vector3::from_fn(|c, _| evaluate(&b[r][c], z));
    let rows = [row(0), row(1), row(2)];
    let mut best = Vector3::zeros();
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        let (a, b) = (rows[i].try_normalize(1e-12), rows[j].try_normalize(1e-12));
        if let (Some(a), Some(b)) = (a, b) {
            let cross = a.cross(&b);
            if cross.norm_squared() > best.norm_squared() {
                best = cross;
            }
        }
    }
    (best.z.abs() > 1e-12).then(|| (best.x / best.z, best.y / best.z))
}

#[cfg(test)]
mod tests {
    use super::super::two_view::Pcg;
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn true_essential_matrix_is_among_the_solutions() {
        let mut random = Pcg::new(11);
        let mut recovered = 0;
        for _ in 0..1000 {
            let mut even = |size: f64| (2.0 * random.unit() - 1.0) * size;
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(even(0.3), even(0.3), even(0.3)));
            let t = Vector3::new(even(1.0), even(1.0), even(1.0));
            let mut first = [Vector3::zeros(); 5];
            let mut second = [Vector3::zeros(); 5];
            for k in 0..5 {
                let in_first = Vector3::new(even(5.0), even(3.0), 12.0 + even(8.0));
                first[k] = in_first / in_first.z;
                let in_second = rotation.inverse() * (in_first - t);
                second[k] = in_second / in_second.z;
            }
            let truth = t.cross_matrix() * rotation.to_rotation_matrix().matrix();
            let truth = truth / truth.norm();
            let nearest = essential_matrices(&first, &second)
                .iter()
                .map(|e| (e - truth).norm().min((e + truth).norm()))
                .fold(f64::MAX, f64::min);
            recovered += usize::from(nearest < 1e-4);
        }
        // Double roots and nearly degenerate samples lose digits.
        assert!(recovered >= 980, "{recovered} of 1000");
    }
}
