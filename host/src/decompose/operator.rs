//! Exact products of kernel matrices with blocks of vectors, a tile of the kernel at a time.
//!
//! Problem `p` is the symmetric matrix `K_p[i, j] = c_i c_j Σ_a w_a exp(−‖x_i − Φ_a x_j‖²/σ_a²)`.
//! All problems share the points and the Gaussians `a`; they differ in weights `w` and scales
//! `c`. So one sweep evaluates each Gaussian once and serves them all.

// Without it `pulp`'s dispatch compiles for the base instruction set.
#![allow(clippy::inline_always)]

use faer::{Accum, Mat, MatRef, Par, linalg::matmul::matmul};
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a tile: the unit of parallel work, fixed so that results do not depend on threads.
const ROWS: usize = 128;
/// Columns of a tile, which at 256 KiB stays in the second-level cache.
const COLUMNS: usize = 256;

/// Kernel matrices up to this many bytes in all are evaluated once and kept; larger ones are
/// evaluated again in every product, so that memory stays linear in the number of points.
const KEPT_BYTES: usize = 2 << 30;

/// Points compared under one metric, and the Gaussians that use it.
pub(super) struct Metric {
    /// Coordinates `x`, one vector per axis.
    pub(super) from: [Vec<f64>; 3],
    /// Coordinates `Φ x`.
    pub(super) to: [Vec<f64>; 3],
    /// `1/σ²` of each Gaussian.
    pub(super) rates: Vec<f64>,
}

/// One kernel matrix over the points.
pub(super) struct Weights {
    /// `w`, one per Gaussian: all of the first metric, then of the second …
    pub(super) gaussians: Vec<f64>,
    /// `c`, one per point.
    pub(super) scales: Vec<f64>,
}

/// A family of kernel matrices over the same points.
pub(super) struct Operator {
    metrics: Vec<Metric>,
    problems: Vec<Weights>,
    /// Per problem and band of rows all tiles from left to right, if they are kept.
    kept: Option<Vec<Vec<Vec<f64>>>>,
}

impl Operator {
    pub(super) fn new(metrics: Vec<Metric>, problems: Vec<Weights>) -> Self {
        let mut operator = Self { metrics, problems, kept: None };
        let n = operator.size();
        if n * n * operator.problems.len() * size_of::<f64>() <= KEPT_BYTES {
            let weights: Vec<&[f64]> =
                operator.problems.iter().map(|p| p.gaussians.as_slice()).collect();
            let band = |top| operator.tiles(top..n.min(top + ROWS), 0..n, &weights);
            operator.kept = Some((0..n).into_par_iter().step_by(ROWS).map(band).collect());
        }
        operator
    }

    /// Number of points: rows and columns of each matrix.
    pub(super) fn size(&self) -> usize {
        self.problems.first().map_or(0, |p| p.scales.len())
    }

    /// Trace of matrix `problem`.
    pub(super) fn trace(&self, problem: usize) -> f64 {
        let Weights { gaussians, scales } = &self.problems[problem];
        let diagonal = |i: usize| -> f64 {
            let rates = self.metrics.iter().flat_map(|m| m.rates.iter().map(move |r| (m, r)));
            rates.zip(gaussians).map(|((m, rate), w)| w * (-rate * m.distance(i, i)).exp()).sum()
        };
        (0..self.size()).map(|i| scales[i] * scales[i] * diagonal(i)).sum()
    }

    /// Columns a block should have for products to be efficient: where the kernel is evaluated
    /// anew each time, enough for the multiplications to outweigh that.
    pub(super) fn block_width(&self) -> usize {
        if self.kept.is_some() { 48 } else { 128 }
    }

    /// `K_p X_p` for each `(p, X_p)` of `inputs`, in one sweep over the kernel.
    pub(super) fn apply(&self, inputs: &[(usize, MatRef<'_, f64>)]) -> Vec<Mat<f64>> {
        let n = self.size();
        let scales = |p: usize| &self.problems[p].scales;
        let scaled: Vec<Mat<f64>> = inputs
            .iter()
            .map(|&(p, x)| Mat::from_fn(n, x.ncols(), |i, j| scales(p)[i] * x[(i, j)]))
            .collect();
        let bands: Vec<Vec<Mat<f64>>> = (0..n)
            .into_par_iter()
            .step_by(ROWS)
            .map(|top| self.apply_band(top..n.min(top + ROWS), inputs, &scaled))
            .collect();
        let output = |(k, &(p, x)): (usize, &(usize, MatRef<'_, f64>))| {
            let value = |i: usize, j: usize| bands[i / ROWS][k][(i % ROWS, j)];
            Mat::from_fn(n, x.ncols(), |i, j| scales(p)[i] * value(i, j))
        };
        inputs.iter().enumerate().map(output).collect()
    }

    /// Some rows of the products, not scaled yet.
    fn apply_band(
        &self,
        rows: Range<usize>,
        inputs: &[(usize, MatRef<'_, f64>)],
        scaled: &[Mat<f64>],
    ) -> Vec<Mat<f64>> {
        let n = self.size();
        let mut outputs: Vec<_> =
            scaled.iter().map(|x| Mat::zeros(rows.len(), x.ncols())).collect();
        let multiply = |output: &mut Mat<f64>, tile: &[f64], x: MatRef<'_, f64>| {
            let tile = MatRef::from_column_major_slice(tile, rows.len(), x.nrows());
            matmul(output, Accum::Add, tile, x, 1.0, Par::Seq);
        };
        if let Some(kept) = &self.kept {
            let tiles = &kept[rows.start / ROWS];
            for ((output, x), (p, _)) in outputs.iter_mut().zip(scaled).zip(inputs) {
                multiply(output, &tiles[*p], x.as_ref());
            }
        } else {
            let weights: Vec<&[f64]> =
                inputs.iter().map(|(p, _)| self.problems[*p].gaussians.as_slice()).collect();
            for left in (0..n).step_by(COLUMNS) {
                let columns = left..n.min(left + COLUMNS);
                let tiles = self.tiles(rows.clone(), columns.clone(), &weights);
                for ((output, x), tile) in outputs.iter_mut().zip(scaled).zip(&tiles) {
                    multiply(output, tile, x.subrows(left, columns.len()));
                }
            }
        }
        outputs
    }

    /// Kernel values at `rows × columns`, column-major, for each set of weights.
    fn tiles(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        weights: &[&[f64]],
    ) -> Vec<Vec<f64>> {
        let mut tiles = vec![vec![0.0; rows.len() * columns.len()]; weights.len()];
        pulp::Arch::new().dispatch(Fill {
            metrics: &self.metrics,
            rows,
            columns,
            weights,
            tiles: &mut tiles,
        });
        tiles
    }
}

/// Adds the kernel values to tiles of zeros: plain loops that the compiler vectorises for
/// whatever instruction set `pulp` finds at run time.
struct Fill<'a> {
    metrics: &'a [Metric],
    rows: Range<usize>,
    columns: Range<usize>,
    weights: &'a [&'a [f64]],
    tiles: &'a mut [Vec<f64>],
}

impl pulp::WithSimd for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let count = self.rows.len();
        let (mut distances, mut values) = ([0.0; ROWS], [0.0; ROWS]);
        let (distances, values) = (&mut distances[..count], &mut values[..count]);
        for (column, j) in self.columns.enumerate() {
            let mut gaussian = 0;
            for metric in self.metrics {
                let [xs, ys, zs] = [0, 1, 2].map(|k| &metric.from[k][self.rows.clone()]);
                let [x, y, z] = [0, 1, 2].map(|k| metric.to[k][j]);
                for (((d, a), b), c) in distances.iter_mut().zip(xs).zip(ys).zip(zs) {
                    *d = (a - x) * (a - x) + (b - y) * (b - y) + (c - z) * (c - z);
                }
                for rate in &metric.rates {
                    for (value, d) in values.iter_mut().zip(distances.iter()) {
                        *value = exp_of_negative(rate * d);
                    }
                    for (tile, w) in self.tiles.iter_mut().zip(self.weights) {
                        let tile = &mut tile[column * count..][..count];
                        add_multiple(tile, w[gaussian], values);
                    }
                    gaussian += 1;
                }
            }
        }
    }
}

/// `sum += w · values`, on a slice each so that the compiler sees they do not overlap.
#[inline(always)]
fn add_multiple(sum: &mut [f64], w: f64, values: &[f64]) {
    for (s, v) in sum.iter_mut().zip(values) {
        *s += w * v;
    }
}

impl Metric {
    /// `‖x_i − Φ x_j‖²`.
    fn distance(&self, i: usize, j: usize) -> f64 {
        (0..3).map(|k| (self.from[k][i] - self.to[k][j]).powi(2)).sum()
    }
}

/// `exp(−t)` for `t ≥ 0`, within 3e-14 relative; `t > 700` counts as 700.
///
/// `exp(−t) = 2^k e^r` with `k` the nearest integer to `−t / ln 2`, `|r| ≤ ½ ln 2`, and eleven
/// terms of the series for `e^r` (the twelfth is 6e-15). No branch, no table: vectorisable.
#[inline(always)]
fn exp_of_negative(t: f64) -> f64 {
    // Adding 1.5·2⁵² leaves the nearest integer in the low bits of the sum.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    // ln 2 in two parts, the first with trailing zeros so that k·LN2_HI is exact (fdlibm).
    const LN2_HI: f64 = 6.931_471_803_691_238e-1;
    const LN2_LO: f64 = 1.908_214_929_270_587_7e-10;
    let x = if t < 700.0 { -t } else { -700.0 };
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = (x - k * LN2_HI) - k * LN2_LO;
    let mut series = 1.0 / 39_916_800.0;
    for c in [
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ] {
        series = series * r + c;
    }
    // The bits of the integer k, moved to the exponent, make 2^k.
    series * f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_matches_the_standard_library() {
        for i in 0..700_000 {
            let t = f64::from(i) * 1e-3;
            let (got, want) = (exp_of_negative(t), (-t).exp());
            assert!((got / want - 1.0).abs() < 3e-14, "exp(-{t}) = {want}, not {got}");
        }
        assert!(exp_of_negative(1e6) < 1e-300);
    }

    #[test]
    fn products_match_the_sum_written_out_kept_or_not() {
        let n = 300;
        let coordinate = |k: usize, sign: f64| -> Vec<f64> {
            (0..n).map(|i| sign * ((i * (k + 7)) % 83) as f64).collect()
        };
        let metric = |signs: [f64; 3], rates: &[f64]| Metric {
            from: [0, 1, 2].map(|k| coordinate(k, 1.0)),
            to: [0, 1, 2].map(|k| coordinate(k, signs[k])),
            rates: rates.to_vec(),
        };
        let metrics = vec![metric([1.0; 3], &[1e-3, 0.1]), metric([-1.0, 1.0, 1.0], &[1e-2])];
        let problem = |gaussians: [f64; 3]| Weights {
            gaussians: gaussians.to_vec(),
            scales: (0..n).map(|i| [1.0, 0.5, 0.0][i % 3]).collect(),
        };
        let problems = vec![problem([1.0, 0.5, 0.0]), problem([0.2, 1.0, -0.7])];
        let mut operator = Operator::new(metrics, problems);
        let x = Mat::from_fn(n, 2, |i, j| ((i + 3 * j) % 11) as f64 - 5.0);

        let value = |p: usize, i: usize, j: usize| -> f64 {
            let Weights { gaussians: w, scales: c } = &operator.problems[p];
            let [a, b] = [0, 1].map(|m| operator.metrics[m].distance(i, j));
            let sum = w[0] * (-1e-3 * a).exp() + w[1] * (-0.1 * a).exp() + w[2] * (-1e-2 * b).exp();
            c[i] * c[j] * sum
        };
        let expected = [1, 0].map(|p| {
            Mat::from_fn(n, 2, |i, k| (0..n).map(|j| value(p, i, j) * x[(j, k)]).sum::<f64>())
        });
        for p in 0..2 {
            let trace: f64 = (0..n).map(|i| value(p, i, i)).sum();
            assert!((operator.trace(p) - trace).abs() < 1e-9);
        }
        let inputs = [(1, x.as_ref()), (0, x.as_ref())];
        let kept = operator.apply(&inputs);
        operator.kept = None;
        for products in [kept, operator.apply(&inputs)] {
            for (product, expected) in products.iter().zip(&expected) {
                assert!((product - expected).norm_max() < 1e-9);
            }
        }
    }
}
