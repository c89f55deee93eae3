//! A metric: the precision of a normal approximation to the posterior, factorised.
//!
//! `A = UᵀU` of all unknowns shapes what is proposed: `u = U⁻¹ z` of independent normal `z` is a draw of the
//! approximation.

use crate::least_squares::{Group, row_words, stride};
use crate::math;

/// The upper triangular factor `U`, rows of groups of lanes.
pub struct Metric<'m> {
    n: usize,
    factor: &'m mut [Group],
}

impl<'m> Metric<'m> {
    /// A factor of `n` unknowns, as Cholesky's method leaves it; `None` if it is shorter.
    pub(crate) fn new(n: usize, factor: &'m mut [Group]) -> Option<Self> {
        Some(Self { n, factor: factor.get_mut(..n * stride(n))? })
    }

    /// The factor's numbers, row by row, filled up to whole lanes.
    pub(super) fn numbers(&self) -> &[f32] {
        self.factor.as_flattened()
    }

    /// Takes the numbers of another; `false`, and nothing changes, if there are not as many.
    pub(super) fn take(&mut self, numbers: &[f32]) -> bool {
        let factor = self.factor.as_flattened_mut();
        let alike = factor.len() == numbers.len();
        if alike {
            factor.copy_from_slice(numbers);
        }
        alike
    }

    fn row(&self, i: usize) -> &[f32] {
        let stride = stride(self.n);
        let row = self.factor.get(i * stride..(i + 1) * stride).unwrap_or_default();
        row.as_flattened().get(i..self.n).unwrap_or_default()
    }

    /// Solves `U x = z`, in place.
    pub fn solve(&self, z: &mut [f32]) {
        for i in (0..self.n).rev() {
            let Some((pivot, row)) = self.row(i).split_first() else { return };
            let Some((x, solved)) = z.get_mut(i..).and_then(<[f32]>::split_first_mut) else {
                return;
            };
            *x = (*x - dot(row, solved)) / pivot;
        }
    }

    /// Solves `Uᵀ x = z`, in place.
    pub fn solve_transposed(&self, z: &mut [f32]) {
        for i in 0..self.n {
            let Some((pivot, row)) = self.row(i).split_first() else { return };
            let Some((x, rest)) = z.get_mut(i..).and_then(<[f32]>::split_first_mut) else { return };
            *x /= pivot;
            for (z, u) in rest.iter_mut().zip(row) {
                *z -= *x * u;
            }
        }
    }

    /// Makes it `UᵀVᵀV U`, given the factor `V` of another.
    pub(super) fn change(&mut self, change: &Metric<'_>) {
        let (n, width) = (self.n, row_words(self.n));
        let factor = self.factor.as_flattened_mut();
        for i in 0..n {
            let Some((pivot, others)) = change.row(i).split_first() else { return };
            let Some((above, below)) = factor.split_at_mut_checked((i + 1) * width) else { return };
            let row = above.get_mut(i * width..).unwrap_or_default();
            for x in &mut *row {
                *x *= pivot;
            }
            for (k, (other, below)) in others.iter().zip(below.chunks_exact(width)).enumerate() {
                // What is left of the diagonal is not the factor's.
                let from = i + 1 + k;
                let below = below.get(from..n).unwrap_or_default();
                for (x, b) in row.iter_mut().skip(from).zip(below) {
                    *x += other * b;
                }
            }
        }
    }

    /// `U v`, in place.
    pub(crate) fn multiply(&self, v: &mut [f32]) {
        for i in 0..self.n {
            let Some(rest) = v.get_mut(i..) else { return };
            let x = dot(self.row(i), rest);
            if let Some(first) = rest.first_mut() {
                *first = x;
            }
        }
    }

    /// `½ ln|A|`, the sum of the logarithms of the pivots.
    pub fn ln_pivots(&self) -> f64 {
        let pivot = |i| self.row(i).first().map_or(1.0, |&x| f64::from(x));
        (0..self.n).map(|i| math::ln(pivot(i))).sum()
    }

    /// Variances of the unknowns in Laplace's approximation, the diagonal of `A⁻¹`, in the order and
    /// units of [`crate::search::unknowns`]. Both slices are as long as there are unknowns.
    pub fn variances(&self, scratch: &mut [f32], variances: &mut [f32]) {
        variances.fill(0.0);
        for k in 0..self.n {
            // Column k of U⁻¹, nothing below its k-th entry.
            scratch.fill(0.0);
            let Some(one) = scratch.get_mut(k) else { return };
            *one = 1.0;
            self.solve(scratch);
            for (variance, x) in variances.iter_mut().zip(&*scratch) {
                *variance += x * x;
            }
        }
    }
}

/// Sum of products, sixteen lanes side by side.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a, a_rest) = a.as_chunks::<16>();
    let (b, b_rest) = b.as_chunks::<16>();
    let mut sums = [0.0_f32; 16];
    for (a, b) in a.iter().zip(b) {
        for l in 0..16 {
            sums[l] += a[l] * b[l];
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Engine;
    use crate::least_squares::{System, matrix_words, system_words};
    use crate::rng::Rng;
    use std::vec;
    use std::vec::Vec;

    const N: usize = 37;

    #[test]
    fn solutions_and_variances_are_the_matrixs() {
        let mut rng = Rng::new(4, 0);
        let mut memory = vec![0.0; system_words(N)];
        let engine = Engine::PORTABLE.normal_equations;
        let mut system = System::new(N, engine, &mut memory).unwrap();
        let mut matrix = vec![vec![0.0_f64; N]; N];
        for _ in 0..3 * N {
            let row: Vec<f32> = (0..N).map(|_| rng.normal_sd(1.0)).collect();
            system.add_row(&row, 0.5, 0.0);
            for (i, a) in row.iter().enumerate() {
                for (j, b) in row.iter().enumerate() {
                    matrix[i][j] += 0.5 * f64::from(a * b);
                }
            }
        }
        let mut factor = vec![0.0; matrix_words(N)];
        system.solve_damped(0.0, |_| 0.0, &mut factor, &mut [0.0; N]).unwrap();
        let metric = Metric::new(N, factor.as_chunks_mut().0).unwrap();
        let z: Vec<f32> = (0..N).map(|_| rng.normal_sd(1.0)).collect();
        // A⁻¹ z = U⁻¹ U⁻ᵀ z.
        let inverse = |z: &[f32]| {
            let mut x = z.to_vec();
            metric.solve_transposed(&mut x);
            metric.solve(&mut x);
            x
        };
        let x = inverse(&z);
        for (row, z) in matrix.iter().zip(&z) {
            let product: f64 = row.iter().zip(&x).map(|(a, x)| a * f64::from(*x)).sum();
            assert!((product - f64::from(*z)).abs() < 1e-4, "{product} {z}");
        }
        let (mut scratch, mut variances) = ([0.0; N], [0.0; N]);
        metric.variances(&mut scratch, &mut variances);
        // Gauss's elimination: the determinant is the product of the pivots.
        let mut ln_determinant = 0.0;
        for k in 0..N {
            ln_determinant += matrix[k][k].ln();
            for i in k + 1..N {
                let factor = matrix[i][k] / matrix[k][k];
                let (above, below) = matrix.split_at_mut(i);
                for (x, u) in below[0].iter_mut().zip(&above[k]) {
                    *x -= factor * u;
                }
            }
        }
        assert!((2.0 * metric.ln_pivots() - ln_determinant).abs() < 1e-4);
        for (i, variance) in variances.into_iter().enumerate() {
            let mut one = [0.0; N];
            one[i] = 1.0;
            let expected = inverse(&one)[i];
            assert!((variance - expected).abs() < 1e-4 * expected, "{i}: {variance} {expected}");
        }
    }
}
