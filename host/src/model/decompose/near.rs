//! Sums of Gaussians that vanish between most points.
//!
//! Points come in an order of which every block lies close together, so whole blocks are left out.
//! What is left is evaluated anew in every product: eight rows at a time, each value used for all
//! columns. Sums of more than a batch of columns are in double precision.

// Without it `pulp`'s dispatch compiles for the base instruction set.
#![allow(clippy::inline_always)]

use super::columns::{ABREAST, Row, Sum, aligned};
use super::tiles::Metric;
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a block. Chosen, not measured, as are the next up to [`COARSE`].
const ROWS: usize = 8;
/// Columns of a block.
const COLUMNS: usize = 32;
/// Columns whose products are summed in single precision.
const BATCH: usize = 128;
/// Rows and columns of the blocks that [`entries`] counts.
const COARSE: usize = 128;
/// Exponent beyond which a Gaussian counts as zero: it is below 1e-6.
const FAR: f64 = 13.9;

/// Least and greatest coordinate per axis.
type Bounds = [[f64; 2]; 3];

/// Matrices `T_p[i, j] = Σ_a w_pa exp(−rate_a ‖x_i − Φ_a x_j‖²)`, of the values that do not vanish.
pub(super) struct Near {
    metrics: Vec<Metric>,
    /// Per metric the points of the columns, `Φ x`.
    images: Vec<[Vec<f32>; 3]>,
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
        let image =
            |m: &Metric, k: usize| -> Vec<f32> { (0..n).map(|j| m.image(k, j) as f32).collect() };
        let images = metrics.iter().map(|m| [0, 1, 2].map(|k| image(m, k))).collect();
        Self { metrics, images, weights, blocks }
    }

    /// `T_p X` of each field `X`, given with its problem `p`.
    pub(super) fn apply(&self, fields: &[(usize, Vec<Row>)]) -> Vec<Vec<Sum>> {
        let n = fields.first().map_or(0, |(_, x)| x.len());
        if self.metrics.is_empty() {
            return vec![vec![[0.0; ABREAST]; n]; fields.len()];
        }
        // What is multiplied by one value lies together.
        let mut memory = Vec::new();
        let field = aligned(&mut memory, n * fields.len());
        for (j, row) in field.chunks_exact_mut(fields.len()).enumerate() {
            row.iter_mut().zip(fields).for_each(|(to, (_, x))| *to = x[j]);
        }
        let field = &*field;
        let weights: Vec<&[f64]> =
            fields.iter().map(|(p, _)| self.weights[*p].as_slice()).collect();
        let product = |(block, columns): (usize, &Vec<Vec<u32>>)| {
            let mut sums = vec![[[0.0; ABREAST]; ROWS]; weights.len()];
            let first = block * ROWS;
            let sweep =
                Sweep { near: self, columns, first, weights: &weights, field, sums: &mut sums };
            pulp::Arch::new().dispatch(sweep);
            sums
        };
        let sums: Vec<_> = self.blocks.par_iter().enumerate().map(product).collect();
        let rows = |f| sums.iter().flat_map(move |block| block[f]).take(n).collect();
        (0..fields.len()).into_par_iter().map(rows).collect()
    }
}

/// A block of rows of some products.
struct Sweep<'a> {
    near: &'a Near,
    /// Per metric, where blocks of columns start.
    columns: &'a [Vec<u32>],
    /// The first row.
    first: usize,
    /// Of each [`ABREAST`] columns that are multiplied, the weights of their problem.
    weights: &'a [&'a [f64]],
    /// Per point, all columns.
    field: &'a [Row],
    sums: &'a mut [[Sum; ROWS]],
}

impl pulp::WithSimd for Sweep<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Near { metrics, images, .. } = self.near;
        let all = self.weights.len();
        let mut gaussian = 0;
        for ((metric, images), columns) in metrics.iter().zip(images).zip(self.columns) {
            let n = images[0].len();
            // Rows beyond the last are copies of it, and not used.
            let row = |r: usize| (self.first + r).min(n - 1);
            let rows: [[f32; ROWS]; 3] =
                std::array::from_fn(|k| std::array::from_fn(|r| metric.points[k][row(r)] as f32));
            let reach = metric.reach() as f32;
            let (mut near, mut count) = ([0; BATCH], 0);
            for (b, &start) in columns.iter().enumerate() {
                let range = start as usize..n.min(start as usize + COLUMNS);
                let mut squared = [0.0_f32; COLUMNS];
                for (rows, image) in rows.iter().zip(images) {
                    let low = rows.iter().fold(f32::INFINITY, |m, x| least(m, *x));
                    let high = -rows.iter().fold(f32::INFINITY, |m, x| least(m, -*x));
                    for (squared, x) in squared.iter_mut().zip(&image[range.clone()]) {
                        let outside = least(least(x - low, high - x), 0.0);
                        *squared += outside * outside;
                    }
                }
                // What is near the rows' box.
                for (j, squared) in range.zip(&squared) {
                    near[count] = j;
                    count += usize::from(*squared < reach);
                }
                if count + COLUMNS <= BATCH && b + 1 < columns.len() {
                    continue;
                }
                let near = &near[..std::mem::take(&mut count)];
                let mut distances = [[0.0; ROWS]; BATCH];
                for (distances, &j) in distances.iter_mut().zip(near) {
                    let [x, y, z] = [0, 1, 2].map(|k| images[k][j]);
                    *distances = std::array::from_fn(|r| {
                        let [a, b, c] = [rows[0][r] - x, rows[1][r] - y, rows[2][r] - z];
                        a * a + b * b + c * c
                    });
                }
                for (g, rate) in metric.rates.iter().enumerate() {
                    let rate = *rate as f32;
                    let mut values = [[0.0; ROWS]; BATCH];
                    for (values, distances) in values.iter_mut().zip(&distances[..near.len()]) {
                        // What is near another row alone is left out: the matrix is symmetric.
                        *values = std::array::from_fn(|r| {
                            let value = exp_of_negative(rate * distances[r]);
                            if distances[r] < reach { value } else { 0.0 }
                        });
                    }
                    for (f, sums) in self.sums.iter_mut().enumerate() {
                        let field = |k: usize| &self.field[near[k] * all + f];
                        let w = self.weights[f][gaussian + g];
                        add(simd, sums, w, &values[..near.len()], field);
                    }
                }
            }
            gaussian += metric.rates.len();
        }
    }
}

/// The lesser: in one instruction, for it does not care about NaN.
#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `sums += w · valuesᵀ · field`.
#[inline(always)]
fn add<'a, S: pulp::Simd>(
    simd: S,
    sums: &mut [Sum; ROWS],
    w: f64,
    values: &[[f32; ROWS]],
    field: impl Fn(usize) -> &'a Row,
) {
    if w == 0.0 {
        return;
    }
    // As many lanes as a register has, so that a block's sums are in registers.
    for part in 0..ABREAST / S::F32_LANES {
        let mut block = [simd.splat_f32s(0.0); ROWS];
        for (k, values) in values.iter().enumerate() {
            let x = S::as_simd_f32s(field(k)).0[part];
            for (sum, value) in block.iter_mut().zip(values) {
                *sum = simd.mul_add_e_f32s(simd.splat_f32s(*value), x, *sum);
            }
        }
        for (sums, block) in sums.iter_mut().zip(&block) {
            let sums = &mut sums[part * S::F32_LANES..];
            let block: &[f32] = pulp::bytemuck::cast_slice(std::slice::from_ref(block));
            sums.iter_mut().zip(block).for_each(|(sum, x)| *sum += w * f64::from(*x));
        }
    }
}

/// `exp(−t)` for `t ≥ 0`, within 2e-7 relative while `t < 20`; `t > 80` counts as 80.
///
/// As `tiles` does it, with fewer terms.
#[inline(always)]
fn exp_of_negative(t: f32) -> f32 {
    // Adding 1.5·2²³ leaves the nearest integer in the low bits of the sum.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts, the first with trailing zeros so that k·LN2_HI is exact.
    const LN2_HI: f32 = 0.693_359_4;
    const LN2_LO: f32 = -2.121_944_4e-4;
    let x = if t < 80.0 { -t } else { -80.0 };
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = (x - k * LN2_HI) - k * LN2_LO;
    let mut series = 1.0 / 5040.0;
    for c in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        series = series * r + c;
    }
    // The bits of the integer k, moved to the exponent, make 2^k.
    series * f32::from_bits(shifted.to_bits().wrapping_add(127) << 23)
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
    fn exponential_matches_the_standard_library() {
        for i in 0..20_000_u16 {
            let t = f32::from(i) * 1e-3;
            let (got, want) = (f64::from(exp_of_negative(t)), (-f64::from(t)).exp());
            assert!((got / want - 1.0).abs() < 2e-7, "exp(-{t}) = {want}, not {got}");
        }
        assert!(exp_of_negative(1e6) < 1e-30);
    }

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
        let row = |i: usize| std::array::from_fn(|lane| ((i + 3 * lane) % 11) as f32 - 5.0);
        let fields = [1, 0].map(|p| (p, (0..n).map(row).collect::<Vec<Row>>()));
        for ((p, x), found) in fields.iter().zip(near.apply(&fields)) {
            let value = |i: usize, j: usize| -> f64 {
                let [a, b] = [0, 1].map(|m: usize| moved[m].distance(i, j));
                let gaussians = [-a, -0.3 * a, -b];
                gaussians.iter().zip(&weights[*p]).map(|(t, w)| w * t.exp()).sum()
            };
            for (i, found) in found.iter().enumerate() {
                for (lane, found) in found.iter().enumerate() {
                    let expected: f64 = (0..n).map(|j| value(i, j) * f64::from(x[j][lane])).sum();
                    assert!((found - expected).abs() < 1e-3, "{found}, not {expected}");
                }
            }
        }
    }
}
