//! Products of kernel matrices with blocks of vectors.
//!
//! Problem `p` is the symmetric matrix `K_p[i, j] = c_i c_j Σ_a w_a exp(−‖x_i − Φ_a x_j‖²/σ_a²)`.
//! All problems share the points and the Gaussians `a`; they differ in weights `w` and scales `c`.
//!
//! Of few points the values are evaluated once and kept (`tiles`). Of many, n² values are too many
//! for memory and time, but no Gaussian needs them: a short one vanishes between most points
//! (`near`), a wide one goes by way of a grid (`grid`). Both are right to 1e-6 of its largest
//! value; [`Operator::error`] measures what comes of that.

use super::columns::{ABREAST, Row, Sum, gathered};
use super::grid::{self, Grid, Workspace};
use super::near::{self, Near};
use super::tiles::{self, Metric, Tiles};
use faer::{Mat, MatRef};
use rayon::prelude::*;

/// Kernel matrices up to this many bytes in all are evaluated once and kept. Chosen, not measured.
pub(super) const KEPT_BYTES: usize = 2 << 30;

/// Rows of the exact matrices that products are compared with. Chosen, not measured.
const CHECKED: usize = 256;
/// So many at once.
const CHECKED_TOGETHER: usize = 16;

/// What one entry of a Gaussian costs, its evaluation shared by some 32 columns, and what spreading
/// a value to one node of a grid does, in multiplications of a matrix product.
const EVALUATION: f64 = 1.5;
const SPREADING: f64 = 1.0;

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
    products: Products,
}

enum Products {
    Kept(Tiles),
    Split(Split),
}

/// Gaussian by Gaussian.
struct Split {
    /// Points in the order products have them, near ones together.
    order: Vec<usize>,
    near: Near,
    smooth: Vec<Smooth>,
}

/// At most [`ABREAST`] columns of an input.
struct Columns {
    input: usize,
    first: usize,
    count: usize,
}

/// Gaussians that are smooth over the points, and their mirror images, by one grid.
struct Smooth {
    /// Which weights are theirs.
    gaussians: Vec<[Option<usize>; 2]>,
    grid: Grid,
}

impl Operator {
    /// The matrices; of their values at most `kept_bytes` are kept.
    pub(super) fn new(metrics: Vec<Metric>, problems: Vec<Weights>, kept_bytes: usize) -> Self {
        let n = problems.first().map_or(0, |p| p.scales.len());
        let weights: Vec<&[f64]> = problems.iter().map(|p| p.gaussians.as_slice()).collect();
        let products = if n * n * problems.len() * size_of::<f64>() <= kept_bytes {
            Products::Kept(Tiles::new(&metrics, &weights))
        } else {
            Products::Split(Split::new(&metrics, &weights))
        };
        Self { metrics, problems, products }
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

    /// Columns a block should have for products to be efficient.
    pub(super) fn block_width(&self) -> usize {
        if self.is_exact() { 48 } else { 32 }
    }

    /// Whether products are exact but for rounding.
    pub(super) fn is_exact(&self) -> bool {
        matches!(self.products, Products::Kept(_))
    }

    /// `K_p X_p` for each `(p, X_p)` of `inputs`.
    pub(super) fn apply(&self, inputs: &[(usize, MatRef<'_, f64>)]) -> Vec<Mat<f64>> {
        match &self.products {
            Products::Kept(tiles) => {
                let scaled = |&(p, x): &(usize, MatRef<'_, f64>)| (p, self.scaled(p, x));
                let inputs: Vec<(usize, Mat<f64>)> = inputs.iter().map(scaled).collect();
                let products = inputs.iter().zip(tiles.apply(&inputs));
                products.map(|((p, _), product)| self.scaled(*p, product.as_ref())).collect()
            }
            Products::Split(split) => split.apply(&self.problems, inputs),
        }
    }

    fn scaled(&self, problem: usize, x: MatRef<'_, f64>) -> Mat<f64> {
        let scales = &self.problems[problem].scales;
        Mat::from_fn(x.nrows(), x.ncols(), |i, j| scales[i] * x[(i, j)])
    }

    /// By column of `x`, how far `product`, which is [`Self::apply`]'s, is from the exact product:
    /// the norm of their difference, estimated from 256 of its entries.
    pub(super) fn error(
        &self,
        problem: usize,
        x: MatRef<'_, f64>,
        product: MatRef<'_, f64>,
    ) -> Vec<f64> {
        let n = self.size();
        let rows: Vec<usize> = (0..n).step_by(n.div_ceil(CHECKED).max(1)).collect();
        let Weights { gaussians, scales } = &self.problems[problem];
        let parts = rows.par_chunks(CHECKED_TOGETHER).map(|rows| {
            let mut exact = Mat::zeros(n, rows.len());
            for (row, &i) in exact.col_iter_mut().zip(rows) {
                let values = tiles::column(&self.metrics, gaussians, i);
                for ((entry, value), scale) in row.iter_mut().zip(values).zip(scales) {
                    *entry = scales[i] * scale * value;
                }
            }
            let exact = exact.transpose() * x;
            let square =
                |(r, &i): (usize, &usize), k| -> f64 { (exact[(r, k)] - product[(i, k)]).powi(2) };
            let sum = |k| rows.iter().enumerate().map(|row| square(row, k)).sum();
            (0..x.ncols()).map(sum).collect::<Vec<f64>>()
        });
        let parts: Vec<Vec<f64>> = parts.collect();
        let share = n as f64 / rows.len() as f64;
        let norm = |k: usize| (share * parts.iter().map(|part| part[k]).sum::<f64>()).sqrt();
        (0..x.ncols()).map(norm).collect()
    }
}

impl Split {
    fn new(metrics: &[Metric], weights: &[&[f64]]) -> Self {
        let order = near::order(metrics);
        let moved: Vec<Metric> = metrics
            .iter()
            .map(|metric| Metric {
                points: metric.points.each_ref().map(|x| order.iter().map(|&i| x[i]).collect()),
                ..metric.clone()
            })
            .collect();
        let (wide, narrow): (Vec<Both<'_>>, Vec<Both<'_>>) =
            both_sides(&moved).into_iter().partition(Both::suits_grid);
        let mut short: Vec<usize> =
            narrow.iter().flat_map(|both| both.gaussians).flatten().collect();
        short.sort_unstable();
        let smooth = grouped(wide).iter().map(|group| Smooth::new(group)).collect();
        let part = |weights: &&[f64]| short.iter().map(|&a| weights[a]).collect();
        let near = Near::new(restricted(&moved, &short), weights.iter().map(part).collect());
        Self { order, near, smooth }
    }

    fn apply(&self, problems: &[Weights], inputs: &[(usize, MatRef<'_, f64>)]) -> Vec<Mat<f64>> {
        let parts: Vec<Columns> = (0..inputs.len())
            .flat_map(|input| {
                let all = inputs[input].1.ncols();
                let part = move |first| Columns { input, first, count: ABREAST.min(all - first) };
                (0..all).step_by(ABREAST).map(part)
            })
            .collect();
        let field = |part: &Columns| {
            let (p, x) = inputs[part.input];
            (p, gathered(x.subcols(part.first, part.count), &self.order, &problems[p].scales))
        };
        let fields: Vec<(usize, Vec<Row>)> = parts.par_iter().map(field).collect();

        let mut sums = self.near.apply(&fields);
        let smooth = |workspace: &mut Workspace, (sums, field): (&mut Vec<Sum>, _)| {
            let (p, x): &(usize, Vec<Row>) = field;
            for smooth in &self.smooth {
                smooth.apply(x, &problems[*p].gaussians, sums, workspace);
            }
        };
        sums.par_iter_mut().zip(&fields).for_each_init(Workspace::default, smooth);
        drop(fields);

        let columns = |(columns, sums): (&Columns, &Vec<Sum>)| -> Mat<f64> {
            let scales = &problems[inputs[columns.input].0].scales;
            let mut product = Mat::zeros(sums.len(), columns.count);
            for (lane, mut column) in product.col_iter_mut().enumerate() {
                for (sum, &i) in sums.iter().zip(&self.order) {
                    column[i] = scales[i] * sum[lane];
                }
            }
            product
        };
        let done: Vec<Mat<f64>> = parts.par_iter().zip(&sums).map(columns).collect();
        let mut outputs: Vec<Mat<f64>> =
            inputs.iter().map(|(_, x)| Mat::zeros(x.nrows(), x.ncols())).collect();
        for (part, done) in parts.iter().zip(&done) {
            outputs[part.input].subcols_mut(part.first, part.count).copy_from(done);
        }
        outputs
    }
}

impl Smooth {
    /// A group whose narrowest comes first.
    fn new(group: &[Both<'_>]) -> Self {
        let rates: Vec<f64> = group.iter().map(|both| both.rate).collect();
        Self {
            gaussians: group.iter().map(|both| both.gaussians).collect(),
            grid: Grid::new(&group[0].metric.points, group[0].mirror(), &rates),
        }
    }

    /// Adds the product with a field.
    fn apply(&self, x: &[Row], weights: &[f64], sums: &mut [Sum], workspace: &mut Workspace) {
        let weight = |a: Option<usize>| a.map_or(0.0, |a| weights[a]);
        let weights: Vec<[f64; 2]> = self.gaussians.iter().map(|both| both.map(weight)).collect();
        if weights.as_flattened().iter().any(|w| *w != 0.0) {
            self.grid.apply(x, &weights, sums, workspace);
        }
    }
}

/// A Gaussian and its mirror image, whichever there are.
struct Both<'a> {
    /// The metric of either: they have the same points.
    metric: &'a Metric,
    /// The mirror, if there is one.
    negates: Option<[bool; 3]>,
    rate: f64,
    gaussians: [Option<usize>; 2],
}

/// Pairs each Gaussian with its mirror image.
fn both_sides(metrics: &[Metric]) -> Vec<Both<'_>> {
    let mut all: Vec<Both<'_>> = Vec::new();
    let mut gaussian = 0;
    for metric in metrics {
        let side = usize::from(metric.negates != [false; 3]);
        for &rate in &metric.rates {
            let same = |both: &Both<'_>| {
                both.rate.to_bits() == rate.to_bits()
                    && both.gaussians[side].is_none()
                    && both.metric.points == metric.points
            };
            let known = all.iter().position(same).unwrap_or(all.len());
            if known == all.len() {
                all.push(Both { metric, negates: None, rate, gaussians: [None; 2] });
            }
            let both = &mut all[known];
            both.gaussians[side] = Some(gaussian);
            if side == 1 {
                both.negates = Some(metric.negates);
            }
            gaussian += 1;
        }
    }
    all
}

impl Both<'_> {
    fn mirror(&self) -> [bool; 3] {
        self.negates.unwrap_or([false; 3])
    }

    /// Whether a grid is cheaper than near pairs.
    fn suits_grid(&self) -> bool {
        let Metric { points, .. } = self.metric;
        let sides: Vec<Metric> = [Some([false; 3]), self.negates]
            .into_iter()
            .flatten()
            .map(|negates| Metric { points: points.clone(), negates, rates: vec![self.rate] })
            .collect();
        let [spread, filter] = grid::work(points, self.mirror(), self.rate);
        spread * SPREADING + filter < near::entries(&sides) as f64 * EVALUATION
    }
}

/// Gaussians that are to share a grid, the narrowest first: where filtering it once more costs less
/// than spreading to another.
fn grouped(mut all: Vec<Both<'_>>) -> Vec<Vec<Both<'_>>> {
    all.sort_by(|a, b| b.rate.total_cmp(&a.rate));
    let mut groups: Vec<Vec<Both<'_>>> = Vec::new();
    for both in all {
        let joins = |group: &&mut Vec<Both<'_>>| {
            let first = &group[0];
            let [spread, filter] = grid::work(&first.metric.points, first.mirror(), first.rate);
            first.metric.points == both.metric.points
                && first.negates == both.negates
                && filter < spread * SPREADING
        };
        match groups.iter_mut().find(joins) {
            Some(group) => group.push(both),
            None => groups.push(vec![both]),
        }
    }
    groups
}

/// Some of the Gaussians of metrics, by their numbers, ascending.
fn restricted(metrics: &[Metric], gaussians: &[usize]) -> Vec<Metric> {
    let mut first = 0;
    let part = metrics.iter().map(|metric| {
        let rates = metric.rates.iter().enumerate();
        let kept = rates.filter(|(k, _)| gaussians.contains(&(first + k))).map(|(_, rate)| *rate);
        let rates = kept.collect();
        first += metric.rates.len();
        Metric { rates, ..metric.clone() }
    });
    part.filter(|metric| !metric.rates.is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both ways of a product at once, with mirrors and without.
    #[test]
    fn products_are_the_same_whether_values_are_kept_or_not() {
        let n = 4000;
        // A dented sheet.
        let points = [0, 1, 2].map(|k| {
            let at = |i: usize| {
                let [x, y] = [(i % 80) as f64 * 2.5 - 95.0, (i / 80) as f64 * 4.0];
                [x, y, 9.0 * (x / 20.0).sin() * (y / 30.0).cos()][k]
            };
            (0..n).map(at).collect::<Vec<f64>>()
        });
        let rates: Vec<f64> = [100.0_f64, 15.0, 2.0].iter().map(|s| s.powi(-2)).collect();
        let metrics = [[false; 3], [true, false, false]].map(|negates| Metric {
            points: points.clone(),
            negates,
            rates: rates.clone(),
        });
        let problem = |gaussians: [f64; 6], odd: f64| Weights {
            gaussians: gaussians.to_vec(),
            scales: (0..n).map(|i| if i % 7 == 0 { odd } else { 1.0 }).collect(),
        };
        let make = |bytes: usize| {
            let problems =
                vec![problem([7.0, 3.0, 1.0, 4.9, 2.1, 0.7], 0.7), problem([1.0; 6], 0.0)];
            Operator::new(metrics.to_vec(), problems, bytes)
        };
        let (kept, split) = (make(KEPT_BYTES), make(0));
        assert!(kept.is_exact());
        let Products::Split(Split { smooth, .. }) = &split.products else { panic!("kept") };
        let wide: usize = smooth.iter().map(|smooth| smooth.gaussians.len()).sum();
        assert_eq!(wide, 2, "the shortest vanishes between most points");
        assert_eq!(kept.trace(0), split.trace(0));
        let x = Mat::from_fn(n, 3, |i, j| f64::from(((i * 5 + j * 3) % 11) as u32) - 5.0);
        let inputs = [(1, x.as_ref()), (0, x.as_ref())];
        let (expected, found) = (kept.apply(&inputs), split.apply(&inputs));
        for ((a, b), (p, _)) in expected.iter().zip(&found).zip(inputs) {
            for k in 0..3 {
                let scale = a.col(k).norm_l2();
                let error = (a.col(k) - b.col(k)).norm_l2();
                assert!(error <= 1e-6 * scale, "{:e}", error / scale);
                let estimate = split.error(p, x.as_ref(), b.as_ref())[k];
                assert!((0.5..2.0).contains(&(estimate / error)), "{estimate:e} of {error:e}");
                assert!(kept.error(p, x.as_ref(), a.as_ref())[k] < 1e-11 * scale);
            }
        }
    }
}
