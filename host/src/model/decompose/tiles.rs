//! Sums of Gaussians over pairs of points, a tile of the matrix at a time.

// Without it `pulp`'s dispatch compiles for the base instruction set.
#![allow(clippy::inline_always)]

use faer::{Mat, MatRef};
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a tile: the unit of parallel work, fixed so that results do not depend on threads.
const ROWS: usize = 128;

/// Points compared under one metric, `‖x_i − Φ x_j‖`, and the Gaussians that use it.
#[derive(Clone)]
pub(super) struct Metric {
    /// Coordinates `x`, one vector per axis.
    pub(super) points: [Vec<f64>; 3],
    /// Which coordinates `Φ` negates.
    pub(super) negates: [bool; 3],
    /// `1/σ²` of each Gaussian.
    pub(super) rates: Vec<f64>,
}

impl Metric {
    /// `‖x_i − Φ x_j‖²`.
    pub(super) fn distance(&self, i: usize, j: usize) -> f64 {
        (0..3).map(|k| (self.points[k][i] - self.image(k, j)).powi(2)).sum()
    }

    /// Coordinate `k` of `Φ x_j`.
    #[inline(always)]
    pub(super) fn image(&self, k: usize, j: usize) -> f64 {
        let x = self.points[k][j];
        if self.negates[k] { -x } else { x }
    }
}

/// Matrices `T_p[i, j] = Σ_a w_pa exp(−rate_a ‖x_i − Φ_a x_j‖²)`.
pub(super) struct Tiles {
    size: usize,
    /// Per band and problem all tiles from left to right.
    kept: Vec<Vec<Vec<f64>>>,
}

impl Tiles {
    /// Evaluates all values.
    pub(super) fn new(metrics: &[Metric], weights: &[&[f64]]) -> Self {
        let n = metrics.first().map_or(0, |metric| metric.points[0].len());
        let band = |top| values(metrics, top..n.min(top + ROWS), 0..n, weights);
        Self { size: n, kept: (0..n).into_par_iter().step_by(ROWS).map(band).collect() }
    }

    /// `T_p X_p` of each `(p, X_p)`, in one sweep.
    pub(super) fn apply(&self, inputs: &[(usize, Mat<f64>)]) -> Vec<Mat<f64>> {
        let n = self.size;
        let bands: Vec<Vec<Mat<f64>>> = (0..n)
            .into_par_iter()
            .step_by(ROWS)
            .map(|top| self.apply_band(top..n.min(top + ROWS), inputs))
            .collect();
        let mut outputs: Vec<Mat<f64>> =
            inputs.iter().map(|(_, x)| Mat::zeros(n, x.ncols())).collect();
        for (b, band) in bands.iter().enumerate() {
            for (output, part) in outputs.iter_mut().zip(band) {
                output.subrows_mut(b * ROWS, part.nrows()).copy_from(part);
            }
        }
        outputs
    }

    fn apply_band(&self, rows: Range<usize>, inputs: &[(usize, Mat<f64>)]) -> Vec<Mat<f64>> {
        let tiles = &self.kept[rows.start / ROWS];
        let product = |(p, x): &(usize, Mat<f64>)| {
            MatRef::from_column_major_slice(&tiles[*p], rows.len(), x.nrows()) * x
        };
        inputs.iter().map(product).collect()
    }
}

/// Values at `rows × columns`, column-major, for each set of weights.
fn values(
    metrics: &[Metric],
    rows: Range<usize>,
    columns: Range<usize>,
    weights: &[&[f64]],
) -> Vec<Vec<f64>> {
    let mut tiles = vec![vec![0.0; rows.len() * columns.len()]; weights.len()];
    let fill = Fill { metrics, rows, columns, weights, tiles: &mut tiles };
    pulp::Arch::new().dispatch(fill);
    tiles
}

/// Column `j` of one matrix.
pub(super) fn column(metrics: &[Metric], weights: &[f64], j: usize) -> Vec<f64> {
    let n = metrics.first().map_or(0, |metric| metric.points[0].len());
    let part = |top| values(metrics, top..n.min(top + ROWS), j..j + 1, &[weights]);
    (0..n).step_by(ROWS).flat_map(|top| part(top).swap_remove(0)).collect()
}

/// Adds the values to tiles of zeros: plain loops that the compiler vectorises for whatever
/// instruction set `pulp` finds at run time.
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
                let [xs, ys, zs] = [0, 1, 2].map(|k| &metric.points[k][self.rows.clone()]);
                let [x, y, z] = [0, 1, 2].map(|k| metric.image(k, j));
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

/// `exp(−t)` for `t ≥ 0`, within 3e-14 relative; `t > 700` counts as 700.
///
/// `exp(−t) = 2^k e^r` with `k` the nearest integer to `−t / ln 2`, `|r| ≤ ½ ln 2`, and eleven
/// terms of the series for `e^r` (the twelfth is 6e-15). No branch, no table: vectorisable.
#[inline(always)]
pub(super) fn exp_of_negative(t: f64) -> f64 {
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
    fn products_match_the_sum_written_out() {
        let n = 300;
        let points = |scale: f64| {
            [7, 8, 9].map(|k| (0..n).map(|i| scale * ((i * k) % 83) as f64).collect::<Vec<_>>())
        };
        let metrics = [
            (1.0, [false; 3], vec![1.0, 0.1]),
            (1.0, [true, false, false], vec![1e-2]),
            (0.01, [false; 3], vec![2.0]),
        ]
        .map(|(scale, negates, rates)| Metric { points: points(scale), negates, rates });
        let weights = [[1.0, 0.5, 0.0, 0.25], [0.2, 1.0, -0.7, 2.0]];
        let value = |p: usize, i: usize, j: usize| -> f64 {
            let [a, b, c] = [0, 1, 2].map(|m: usize| metrics[m].distance(i, j));
            let gaussians = [-a, -0.1 * a, -1e-2 * b, -2.0 * c];
            gaussians.iter().zip(&weights[p]).map(|(t, w)| w * t.exp()).sum()
        };
        let x = Mat::from_fn(n, 2, |i, j| ((i + 3 * j) % 11) as f64 - 5.0);
        let tiles = Tiles::new(&metrics, &[&weights[0], &weights[1]]);
        let found = tiles.apply(&[(1, x.clone()), (0, x.clone())]);
        for (p, found) in [1, 0].into_iter().zip(&found) {
            let expected =
                Mat::from_fn(n, 2, |i, k| (0..n).map(|j| value(p, i, j) * x[(j, k)]).sum::<f64>());
            assert!((found - expected).norm_max() < 1e-9);
            let column = column(&metrics, &weights[p], 17);
            assert!((0..n).all(|i| (column[i] - value(p, i, 17)).abs() < 1e-12));
        }
    }
}
