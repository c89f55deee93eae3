//! Exact low-rank decomposition of a kernel over all vertices of a scan.
//!
//! The covariance of a field over V vertices is a 3V × 3V matrix. The kernels here are sums of
//! (3×3 matrix) ⊗ (scalar kernel) whose matrices share eigenvectors, so it falls apart exactly
//! into a few scalar problems of size V, or of half that when the vertices are symmetric too
//! (`structure`). The leading eigenpairs of all of them are found together by a block Krylov
//! method (`krylov`) on kernel products (`operator`). Nothing is sampled. Matrices are kept only
//! while they are small (2 GiB in all); beyond that memory grows with V, not V².
//!
//! Results are the same at every number of threads.

mod columns;
mod commuting;
mod grid;
mod krylov;
mod near;
mod operator;
mod structure;
mod tiles;

use crate::error::{Error, Result};
use crate::model::kernel::{Kernel, Vertex, block, trace};
use crate::model::process::{Deviation, Process};
use faer::{Mat, MatRef};
use krylov::Krylov;
use operator::KEPT_BYTES;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use structure::{Structure, Use};

/// Largest residual `‖K u − λ u‖ / λ` of any pair returned. Chosen; docs/decomposition.md has
/// what is reached.
pub const MAX_RESIDUAL: f64 = 1e-3;

/// Most components [`Truncation::Variance`] will go to. Chosen, not measured.
pub const MAX_COMPONENTS: usize = 2000;

/// Pairs below this fraction of the leading eigenvalue are rounding noise of a
/// rank-deficient kernel. Chosen, not measured.
const POSITIVE: f64 = 1e-9;
/// The same where products are not exact. Chosen, not measured.
const RESOLVED: f64 = 1e-6;

/// Receives the fraction done, in `[0, 1]`, and what is being done.
pub type Progress<'a> = dyn FnMut(f64, &str) + 'a;

/// How many components to keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Truncation {
    /// This many, or all there are.
    Rank(usize),
    /// As few as hold this fraction of the variance, in `(0, 1)`; at most [`MAX_COMPONENTS`].
    Variance(f64),
}

/// Leading eigenpairs of a covariance, in descending order.
///
/// Guarantees: variances positive; columns orthonormal in `R^{3V}`, each with its entry of
/// largest magnitude positive; residuals at most [`MAX_RESIDUAL`].
#[derive(Serialize, Deserialize)]
pub struct Decomposition {
    /// Eigenvalues λ of the 3V × 3V covariance.
    pub variances: Vec<f64>,
    /// Trace of the covariance, exact: the sum of all its eigenvalues, kept or not.
    pub total_variance: f64,
    /// Largest residual `‖K u − λ u‖ / λ`, from one more product over all vertices; where products
    /// are not exact, with their error as 256 rows of the exact kernel tell it.
    pub max_residual: f64,
    columns: Vec<Column>,
    vectors: Vec<Vec<f64>>,
}

/// An eigenvector as the product (colour or coordinate direction) ⊗ (scalar eigenvector).
#[derive(Serialize, Deserialize)]
struct Column {
    direction: [f64; 3],
    vector: usize,
}

impl Decomposition {
    /// Number of components kept.
    pub fn rank(&self) -> usize {
        self.variances.len()
    }

    /// Whether it is one over so many vertices, as far as its shape tells.
    pub(super) fn is_over(&self, vertices: usize) -> bool {
        self.columns.len() == self.variances.len()
            && self.columns.iter().all(|column| column.vector < self.vectors.len())
            && self.vectors.iter().all(|vector| vector.len() == vertices)
    }

    /// Fraction of the total variance the kept components hold.
    pub fn captured(&self) -> f64 {
        // An empty sum is −0.
        (0.0 + self.variances.iter().sum::<f64>()) / self.total_variance
    }

    /// The unit eigenvector `k` as a product: its value at vertex `i` is `direction·vector[i]`,
    /// direction being over x, y, z or R, G, B.
    ///
    /// # Panics
    /// If `k` is not below the rank.
    pub fn column(&self, k: usize) -> ([f64; 3], &[f64]) {
        let column = &self.columns[k];
        (column.direction, &self.vectors[column.vector])
    }

    /// The process of these deviations from a mean.
    pub fn around(&self, mean: &[[f32; 3]]) -> Process {
        let vertices = mean.len();
        Process {
            mean: mean.to_vec(),
            basis: Mat::from_fn(3 * vertices, self.rank(), |row, k| {
                let (direction, values) = self.column(k);
                direction[row / vertices] * values[row % vertices]
            }),
            variances: self.variances.clone(),
            noise: 0.0,
            total_variance: self.total_variance,
        }
    }
}

impl Deviation for Decomposition {
    fn variances(&self) -> &[f64] {
        &self.variances
    }

    fn total_variance(&self) -> f64 {
        self.total_variance
    }

    fn column(&self, k: usize, channel: usize) -> (f64, &[f64]) {
        let (direction, vector) = self.column(k);
        (self.variances[k].sqrt() * direction[channel], vector)
    }
}

/// A scalar eigenproblem on its way and what its pairs stand for.
struct Problem {
    krylov: Krylov,
    uses: Vec<Use>,
}

/// A pair of the whole covariance: pair `ritz` of `problem`, in its role `use_`.
struct Candidate {
    variance: f64,
    problem: usize,
    ritz: usize,
    use_: usize,
}

/// Leading eigenpairs of `kernel` over `vertices` (at least one).
///
/// # Errors
/// When the 3×3 matrices of the kernel share no eigenvectors, or when the variance asked for
/// needs more than [`MAX_COMPONENTS`] components (the message says how much those hold at most); what
/// needs more memory than there is.
pub fn decompose(
    kernel: &Kernel,
    vertices: &[Vertex],
    truncation: Truncation,
    progress: &mut Progress<'_>,
) -> Result<Decomposition> {
    decompose_within(KEPT_BYTES, kernel, vertices, truncation, progress)
}

/// [`decompose`], of whose matrices at most so many bytes are kept.
fn decompose_within(
    kept_bytes: usize,
    kernel: &Kernel,
    vertices: &[Vertex],
    truncation: Truncation,
    progress: &mut Progress<'_>,
) -> Result<Decomposition> {
    if truncation == Truncation::Rank(0) {
        // The trace is all there is to know: no need of V² values of the kernel.
        let terms = kernel.terms();
        let total_variance = vertices.iter().map(|v| trace(&block(&terms, v, v))).sum();
        return Ok(Decomposition {
            variances: Vec::new(),
            total_variance,
            max_residual: 0.0,
            columns: Vec::new(),
            vectors: Vec::new(),
        });
    }
    if let Truncation::Rank(rank) = truncation {
        check_memory(rank, vertices.len())?;
    }
    let structure = Structure::new(kernel, vertices, kept_bytes)?;
    let operator = &structure.operator;
    let mut problems: Vec<Problem> = structure
        .uses
        .iter()
        .enumerate()
        .map(|(p, uses)| Problem {
            krylov: Krylov::new(
                operator.size(),
                operator.block_width(),
                operator.trace(p),
                p as u64,
            ),
            uses: uses.clone(),
        })
        .collect();
    let floor = if operator.is_exact() { POSITIVE } else { RESOLVED };
    let total: f64 = problems.iter().map(Problem::total_variance).sum();
    let limit = MAX_COMPONENTS.min(3 * vertices.len());

    let kept = loop {
        let mut candidates = merged(&problems, floor);
        let wanted = wanted(&candidates, truncation, total, limit);
        let cutoff = candidates.get(wanted.wrapping_sub(1)).map_or(0.0, |c| c.variance);
        let lagging: Vec<bool> = problems.iter().map(|p| p.lags(cutoff, floor)).collect();
        candidates.truncate(wanted);
        let converged = |c: &&Candidate| problems[c.problem].krylov.converged(c.ritz);
        if let Truncation::Variance(fraction) = truncation {
            let leading: Vec<f64> =
                candidates.iter().take_while(converged).map(|c| c.variance).collect();
            check_reach(&leading, fraction, total, limit)?;
        }
        let done = candidates.iter().filter(converged);
        progress(done.count() as f64 / wanted.max(1) as f64, "eigenvectors");
        if !lagging.contains(&true) {
            break candidates;
        }
        advance(&structure, &mut problems, &lagging);
    };

    Ok(finish(&structure, &problems, &kept, total))
}

/// Bytes that a component takes for each vertex, as measured on large meshes (docs/decomposition.md):
/// a share of the Krylov spaces, and itself.
const BYTES: usize = 80;

/// Fails if so many components of so many vertices are more than this machine has memory for.
fn check_memory(rank: usize, vertices: usize) -> Result<()> {
    let bytes = rank.min(3 * vertices).saturating_mul(vertices).saturating_mul(BYTES);
    // Asked for and given back: what was never touched costs nothing, and what cannot be there is refused.
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| {
        Error::new(format_args!(
            "{rank} components of {vertices} vertices need some {} GB of memory, which are not there; \
             ask for fewer, or give a coarser mesh",
            bytes / 1_000_000_000
        ))
    })
}

/// Fails as soon as the leading variances show that `limit` components cannot hold `fraction` of
/// the total: none of the others is larger than the last of these.
fn check_reach(leading: &[f64], fraction: f64, total: f64, limit: usize) -> Result<()> {
    let Some(last) = leading.last() else { return Ok(()) };
    let rest = last * (limit - leading.len()) as f64;
    let reach = (leading.iter().sum::<f64>() + rest) / total;
    if reach >= fraction * (1.0 - 1e-12) {
        return Ok(());
    }
    Err(Error::new(format_args!(
        "{limit} components hold less than {:.2} % of the variance, not the {:.2} % asked for; \
         ask for less, or give a rank",
        100.0 * reach,
        100.0 * fraction
    )))
}

/// All positive pairs found so far, largest variance first.
fn merged(problems: &[Problem], floor: f64) -> Vec<Candidate> {
    let mut all: Vec<Candidate> = Vec::new();
    for (p, problem) in problems.iter().enumerate() {
        for (ritz, theta) in problem.krylov.values().iter().enumerate() {
            all.extend(problem.uses.iter().enumerate().map(|(u, role)| Candidate {
                variance: role.scale * theta,
                problem: p,
                ritz,
                use_: u,
            }));
        }
    }
    // Stable, so equal variances keep the order of problems, pairs and roles.
    all.sort_by(|a, b| b.variance.total_cmp(&a.variance));
    let floor = all.first().map_or(0.0, |c| floor * c.variance);
    all.retain(|c| c.variance > floor);
    all
}

fn wanted(candidates: &[Candidate], truncation: Truncation, total: f64, limit: usize) -> usize {
    match truncation {
        Truncation::Rank(rank) => rank,
        Truncation::Variance(fraction) => {
            let mut left = fraction * total;
            let enough = candidates.iter().position(|c| {
                left -= c.variance;
                left <= 0.0
            });
            enough.map_or(limit, |last| limit.min(last + 1))
        }
    }
}

impl Problem {
    fn total_variance(&self) -> f64 {
        self.uses.iter().map(|role| role.scale).sum::<f64>() * self.krylov.trace()
    }

    /// Whether a pair that may belong above `cutoff` (0: as many as there are) is not exact yet.
    fn lags(&self, cutoff: f64, floor: f64) -> bool {
        let scale = self.uses.iter().map(|role| role.scale).fold(0.0, f64::max);
        self.krylov.lags(cutoff / scale, floor)
    }
}

/// Extends the Krylov spaces of the problems that lag, all in the same sweeps over the kernel.
fn advance(structure: &Structure, problems: &mut [Problem], lagging: &[bool]) {
    loop {
        let active: Vec<usize> =
            (0..problems.len()).filter(|&p| lagging[p] && !problems[p].krylov.is_due()).collect();
        if active.is_empty() {
            break;
        }
        let blocks: Vec<(usize, MatRef<'_, f64>)> =
            active.iter().map(|&p| (p, problems[p].krylov.block())).collect();
        let mut products = vec![None; problems.len()];
        for (&p, product) in active.iter().zip(structure.operator.apply(&blocks)) {
            products[p] = Some(product);
        }
        problems.par_iter_mut().zip(products).for_each(|(problem, product)| {
            if let Some(product) = product {
                problem.krylov.absorb(product);
            }
        });
    }
    problems.par_iter_mut().zip(lagging).filter(|(_, lags)| **lags).for_each(|(problem, _)| {
        problem.krylov.project();
    });
}

/// Forms the kept eigenvectors and certifies them with one more product.
fn finish(
    structure: &Structure,
    problems: &[Problem],
    kept: &[Candidate],
    total: f64,
) -> Decomposition {
    // The kept pairs of each problem are its leading ones.
    let ranks: Vec<usize> = (0..problems.len())
        .map(|p| kept.iter().filter(|c| c.problem == p).map(|c| c.ritz + 1).max().unwrap_or(0))
        .collect();
    let bases: Vec<_> =
        problems.par_iter().zip(&ranks).map(|(p, &rank)| p.krylov.vectors(rank)).collect();
    let blocks: Vec<_> = bases.iter().enumerate().map(|(p, u)| (p, u.as_ref())).collect();
    let products = structure.operator.apply(&blocks);

    let mut max_residual: f64 = 0.0;
    let mut first = vec![0; problems.len()];
    let mut vectors = Vec::new();
    for (p, (basis, product)) in bases.iter().zip(&products).enumerate() {
        first[p] = vectors.len();
        let errors = if structure.operator.is_exact() {
            vec![0.0; ranks[p]]
        } else {
            structure.operator.error(p, basis.as_ref(), product.as_ref())
        };
        let values = &problems[p].krylov.values()[..ranks[p]];
        let pair = |(j, theta): (usize, &f64)| {
            let residual = product.col(j) - faer::Scale(*theta) * basis.col(j);
            ((residual.norm_l2() + errors[j]) / theta, structure.expand(p, basis.col(j)))
        };
        let pairs: Vec<(f64, Vec<f64>)> = values.par_iter().enumerate().map(pair).collect();
        for (residual, vector) in pairs {
            max_residual = max_residual.max(residual);
            vectors.push(vector);
        }
    }
    let columns = kept
        .iter()
        .map(|c| {
            let vector = first[c.problem] + c.ritz;
            let direction = problems[c.problem].uses[c.use_].direction;
            let sign = leading_sign(&direction) * leading_sign(&vectors[vector]);
            Column { direction: direction.map(|d| sign * d), vector }
        })
        .collect();
    let variances = kept.iter().map(|c| c.variance).collect();
    Decomposition { variances, total_variance: total, max_residual, columns, vectors }
}

/// Sign of the entry of largest magnitude; of the first among those that differ by rounding.
fn leading_sign(values: &[f64]) -> f64 {
    let largest = values.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    let leader = values.iter().find(|v| v.abs() >= largest * (1.0 - 1e-9));
    leader.map_or(1.0, |v| v.signum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Axis;
    use crate::model::kernel::Preset;

    #[test]
    fn what_no_machine_holds_is_refused_before_it_is_tried() {
        check_memory(199, 100_000).unwrap();
        check_memory(usize::MAX, 1).unwrap();
        let error = check_memory(2000, 1 << 40).unwrap_err().to_string();
        assert!(
            error.starts_with("2000 components of 1099511627776 vertices need some"),
            "{error}"
        );
    }

    #[test]
    fn large_meshes_decompose_like_small_ones() {
        // A dented mask, its two sides alike or not.
        let vertex = |i: usize, bend: f64| {
            let [x, y] = [(i % 41) as f64 * 3.0 - 60.0, (i / 41) as f64 * 3.0];
            let z = 20.0 * (x / 35.0).cos() + 5.0 * (y / 9.0).sin();
            let shade = 0.5 + 0.2 * (x.abs() / 17.0).sin() * (y / 11.0).cos();
            Vertex { position: [x, y + bend * x, z], color: [shade, 0.8 * shade, 0.5 - z / 99.0] }
        };
        let preset = Preset::named("symmetric-full").unwrap();
        for (bend, axis) in [(0.0, Axis::X), (0.1, Axis::X)] {
            let vertices: Vec<Vertex> = (0..41 * 50).map(|i| vertex(i, bend)).collect();
            for kernel in [preset.shape(Some(axis)), preset.albedo(Some(axis))] {
                let rank = Truncation::Rank(120);
                let silent = &mut |_: f64, _: &str| {};
                let small = decompose_within(KEPT_BYTES, &kernel, &vertices, rank, silent).unwrap();
                let large = decompose_within(0, &kernel, &vertices, rank, silent).unwrap();
                assert!(large.max_residual <= MAX_RESIDUAL, "{}", large.max_residual);
                assert_eq!(large.rank(), 120);
                for (a, b) in small.variances.iter().zip(&large.variances) {
                    assert!((a / b - 1.0).abs() < 1e-5, "{a} {b}");
                }
            }
        }
    }
}
