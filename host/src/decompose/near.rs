//! Sums of Gaussians that vanish between most points.
//!
//! Points come in an order of which every block lies close together, so whole blocks are left out.
//! What is left is evaluated anew in every product: eight rows at a time, each value used for all
//! columns.

// Without it `pulp`'s dispatch compiles for the base instruction set.
#![allow(clippy::inline_always)]

use super::lanes::{LANES, Lanes, aligned, gathered};
use super::tiles::{Metric, exp_of_negative};
use faer::Mat;
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a block.
const ROWS: usize = LANES;
/// Columns of a block.
const COLUMNS: usize = 32;
/// Rows and columns of the blocks that [`entries`] counts.
const COARSE: usize = 128;
/// Exponent beyond which a Gaussian counts as zero: it is below 1e-6.
const FAR: f64 = 13.9;

/// Least and greatest coordinate per axis.
type Bounds = [[f64; 2]; 3];

/// Matrices `T_p[i, j] = Σ_a w_pa exp(−rate_a ‖x_i − Φ_a x_j‖²)`, of the values that do not vanish.
pub(super) struct Near {
    metrics: Vec<Metric>,
    /// Per problem the `w`, one per Gaussian: all of the first metric, then of the second …
    weights: Vec<Vec<f64>>,
    /// Per block of rows and metric, the first columns of the blocks where not all vanishes.
    blocks: Vec<Vec<Vec<u32>>>,
}

impl Near {
    /// The matrices; points are in an order as [`order`] makes it.
    pub(super) fn new(metrics: Vec<Metric>, weights: Vec<Vec<f64>>) -> Self {
        let n = metrics.first().map_or(0, |metric| metric.points[0].len());
        let columns: Vec<Vec<Bounds>> = metrics.iter().map(|m| bounds(m, COLUMNS)).collect();
        let near = |metric: usize, rows: Range<usize>| -> Vec<u32> {
            let rows = extent(&metrics[metric], rows);
            let tests = columns[metric].iter().zip((0..).step_by(COLUMNS));
            let near = tests.filter(|(columns, _)| !metrics[metric].vanishes(&rows, columns));
            near.map(|(_, first)| first).collect()
        };
        let block = |first: usize| {
            (0..metrics.len()).map(|m| near(m, first..n.min(first + ROWS))).collect()
        };
        let blocks = (0..n).into_par_iter().step_by(ROWS).map(block).collect();
        Self { metrics, weights, blocks }
    }

    /// Adds `T_p X_p` to the output of each `(p, X_p)`.
    pub(super) fn apply(&self, inputs: &[(usize, Mat<f64>)], outputs: &mut [Mat<f64>]) {
        if self.metrics.is_empty() {
            return;
        }
        let columns: Vec<(usize, usize)> = inputs
            .iter()
            .enumerate()
            .flat_map(|(k, (_, x))| (0..x.ncols()).step_by(LANES).map(move |first| (k, first)))
            .collect();
        let weights: Vec<&[f64]> =
            columns.iter().map(|&(k, _)| self.weights[inputs[k].0].as_slice()).collect();
        let fields: Vec<Vec<Lanes>> = columns
            .iter()
            .map(|&(k, first)| {
                let x = &inputs[k].1;
                gathered(x.subcols(first, LANES.min(x.ncols() - first)))
            })
            .collect();
        // What is multiplied by one value lies together.
        let n = fields.first().map_or(0, Vec::len);
        let mut memory = Vec::new();
        let field = aligned(&mut memory, n * fields.len());
        for (j, row) in field.chunks_exact_mut(fields.len()).enumerate() {
            row.iter_mut().zip(&fields).for_each(|(to, x)| *to = x[j]);
        }
        let field = &*field;
        drop(fields);
        let product = |(block, near): (usize, &Vec<Vec<u32>>)| {
            let mut sums = vec![[[0.0; LANES]; ROWS]; weights.len()];
            pulp::Arch::new().dispatch(Sweep {
                metrics: &self.metrics,
                columns: near,
                first: block * ROWS,
                weights: &weights,
                field,
                sums: &mut sums,
            });
            sums
        };
        let sums: Vec<_> = self.blocks.par_iter().enumerate().map(product).collect();
        for (c, (k, first)) in columns.into_iter().enumerate() {
            for (lane, column) in outputs[k].col_iter_mut().skip(first).take(LANES).enumerate() {
                let values = sums.iter().flat_map(|block| block[c].iter().map(|row| row[lane]));
                column.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
            }
        }
    }
}

/// A block of rows of some products.
struct Sweep<'a> {
    metrics: &'a [Metric],
    /// Per metric, where blocks of columns start.
    columns: &'a [Vec<u32>],
    /// The first row.
    first: usize,
    /// Of each [`LANES`] columns that are multiplied, the weights of their problem.
    weights: &'a [&'a [f64]],
    /// Per point, all columns.
    field: &'a [Lanes],
    sums: &'a mut [[Lanes; ROWS]],
}

impl pulp::WithSimd for Sweep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let mut gaussian = 0;
        for (metric, columns) in self.metrics.iter().zip(self.columns) {
            let n = metric.points[0].len();
            // Rows beyond the last are copies of it, and not used.
            let row = |r: usize| (self.first + r).min(n - 1);
            let rows: [[f64; ROWS]; 3] =
                std::array::from_fn(|k| std::array::from_fn(|r| metric.points[k][row(r)]));
            let reach = metric.reach();
            for &start in columns {
                let start = start as usize;
                // Of the block those columns that are near some row.
                let (mut near, mut count) = ([0; COLUMNS], 0);
                let mut distances = [[0.0; ROWS]; COLUMNS];
                for j in start..n.min(start + COLUMNS) {
                    let [x, y, z] = [0, 1, 2].map(|k| metric.image(k, j));
                    let squared: [f64; ROWS] = std::array::from_fn(|r| {
                        let [a, b, c] = [rows[0][r] - x, rows[1][r] - y, rows[2][r] - z];
                        a * a + b * b + c * c
                    });
                    near[count] = j;
                    distances[count] = squared;
                    let nearest =
                        squared.iter().fold(f64::INFINITY, |m, d| if *d < m { *d } else { m });
                    count += usize::from(nearest < reach);
                }
                for (g, rate) in metric.rates.iter().enumerate() {
                    let mut values = [[0.0; ROWS]; COLUMNS];
                    for (values, distances) in values.iter_mut().zip(&distances[..count]) {
                        // Not from the block's columns that are near another row alone: the
                        // matrix is symmetric.
                        *values = std::array::from_fn(|r| {
                            let value = exp_of_negative(rate * distances[r]);
                            if distances[r] < reach { value } else { 0.0 }
                        });
                    }
                    let all = self.weights.len();
                    for (f, sums) in self.sums.iter_mut().enumerate() {
                        let field = |k: usize| &self.field[near[k] * all + f];
                        add(sums, self.weights[f][gaussian + g], &values[..count], field);
                    }
                }
            }
            gaussian += metric.rates.len();
        }
    }
}

/// `sums += w · valuesᵀ · field`.
#[inline(always)]
fn add<'a>(
    sums: &mut [Lanes; ROWS],
    w: f64,
    values: &[[f64; ROWS]],
    field: impl Fn(usize) -> &'a Lanes,
) {
    if w == 0.0 {
        return;
    }
    let mut block = [[0.0; LANES]; ROWS];
    for (k, values) in values.iter().enumerate() {
        let x = field(k);
        for (sum, value) in block.iter_mut().zip(values) {
            *sum = std::array::from_fn(|lane| value.mul_add(x[lane], sum[lane]));
        }
    }
    for (sum, block) in sums.iter_mut().zip(&block) {
        *sum = std::array::from_fn(|lane| w.mul_add(block[lane], sum[lane]));
    }
}

impl Metric {
    /// Whether all Gaussians vanish between the points of two boxes.
    fn vanishes(&self, rows: &Bounds, columns: &Bounds) -> bool {
        let squared: f64 = (0..3)
            .map(|k| {
                let [low, high] = columns[k];
                let [low, high] = if self.negates[k] { [-high, -low] } else { [low, high] };
                (low - rows[k][1]).max(rows[k][0] - high).max(0.0).powi(2)
            })
            .sum();
        squared > self.reach()
    }

    /// Squared distance beyond which all Gaussians vanish.
    fn reach(&self) -> f64 {
        FAR / self.rates.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

fn extent(metric: &Metric, range: Range<usize>) -> Bounds {
    std::array::from_fn(|k| {
        let ends = |[low, high]: [f64; 2], x: &f64| [low.min(*x), high.max(*x)];
        metric.points[k][range.clone()].iter().fold([f64::INFINITY, f64::NEG_INFINITY], ends)
    })
}

fn bounds(metric: &Metric, step: usize) -> Vec<Bounds> {
    let n = metric.points[0].len();
    (0..n).step_by(step).map(|first| extent(metric, first..n.min(first + step))).collect()
}

/// About how many values of some metrics do not vanish.
pub(super) fn entries(metrics: &[Metric]) -> usize {
    let near = |metric: &Metric| {
        let boxes = bounds(metric, COARSE);
        let near = |rows: &Bounds| boxes.iter().filter(|b| !metric.vanishes(rows, b)).count();
        boxes.iter().map(near).sum::<usize>()
    };
    metrics.iter().map(near).sum::<usize>() * COARSE * COARSE
}

/// Points in an order of which every block lies close together, under the metric whose Gaussians
/// are the narrowest for its extent.
pub(super) fn order(metrics: &[Metric]) -> Vec<usize> {
    let all: Vec<usize> = (0..metrics.first().map_or(0, |m| m.points[0].len())).collect();
    let narrowness = |metric: &&Metric| {
        let rate = metric.rates.iter().copied().fold(0.0, f64::max);
        widest(&metric.points, &all).1.powi(2) * rate
    };
    let metric = metrics.iter().max_by(|a, b| narrowness(a).total_cmp(&narrowness(b)));
    let mut order = all.clone();
    if let Some(metric) = metric {
        bisect(&metric.points, &mut order);
    }
    order
}

/// Divides points across their widest axis, and again, down to the rows of a block.
fn bisect(points: &[Vec<f64>; 3], order: &mut [usize]) {
    if order.len() <= ROWS {
        return;
    }
    let (axis, _) = widest(points, order);
    let block = (order.len().next_power_of_two() / 2).min(COARSE);
    let middle = (order.len() / 2).next_multiple_of(block);
    if middle == order.len() {
        return;
    }
    let at = |&i: &usize| points[axis][i];
    order.select_nth_unstable_by(middle, |i, j| at(i).total_cmp(&at(j)).then(i.cmp(j)));
    let (low, high) = order.split_at_mut(middle);
    rayon::join(|| bisect(points, low), || bisect(points, high));
}

/// The axis along which some points extend furthest, and how far.
fn widest(points: &[Vec<f64>; 3], some: &[usize]) -> (usize, f64) {
    let extent = |axis: usize| {
        let ends = |[low, high]: [f64; 2], x: f64| [low.min(x), high.max(x)];
        let of = some.iter().map(|&i| points[axis][i]);
        let [low, high] = of.fold([f64::INFINITY, f64::NEG_INFINITY], ends);
        (axis, high - low)
    };
    let wider = |a: (usize, f64), b: (usize, f64)| if b.1 > a.1 { b } else { a };
    (1..3).map(extent).fold(extent(0), wider)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_all_values() {
        let n = 1003;
        let scatter = |k: usize| (0..n).map(move |i| (i * k % 997) as f64 / 40.0 - 9.0);
        let points = [3, 5, 8].map(|k| scatter(k).collect::<Vec<f64>>());
        let metrics = [([false; 3], vec![1.0, 0.3]), ([true, false, false], vec![1.0])]
            .map(|(negates, rates)| Metric { points: points.clone(), negates, rates });
        let order = order(&metrics);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..n), "every point once");
        let moved = metrics.map(|metric| Metric {
            points: metric.points.map(|x| order.iter().map(|&i| x[i]).collect()),
            ..metric
        });
        let all: usize = moved.iter().map(|_| n * n).sum();
        assert!(entries(&moved) < all, "far blocks are left out");
        let weights = [vec![1.0, 0.0, -0.5], vec![0.2, 1.0, 0.7]];
        let near = Near::new(moved.to_vec(), weights.to_vec());
        let kept: usize = near.blocks.iter().flatten().map(|b| b.len() * ROWS * COLUMNS).sum();
        assert!(kept < all / 4, "{kept} of {all}");
        let inputs = [(1, 11), (0, 3)].map(|(p, columns)| {
            (p, Mat::from_fn(n, columns, |i, j| ((i + 3 * j) % 11) as f64 - 5.0))
        });
        let mut found = [11, 3].map(|columns| Mat::zeros(n, columns));
        near.apply(&inputs, &mut found);
        for ((p, x), found) in inputs.iter().zip(&found) {
            let value = |i: usize, j: usize| -> f64 {
                let [a, b] = [0, 1].map(|m: usize| moved[m].distance(i, j));
                let gaussians = [-a, -0.3 * a, -b];
                gaussians.iter().zip(&weights[*p]).map(|(t, w)| w * t.exp()).sum()
            };
            let expected = Mat::from_fn(n, x.ncols(), |i, k| {
                (0..n).map(|j| value(i, j) * x[(j, k)]).sum::<f64>()
            });
            assert!((found - &expected).norm_max() < 1e-3, "{:e}", (found - &expected).norm_max());
        }
    }
}
