//! Leading eigenpairs of a symmetric operator by a block Krylov space with Rayleigh–Ritz.
//!
//! Block Lanczos with full reorthogonalisation (Golub & Underwood 1977): from a random block
//! `Q₁`, each product `K Q_j` is orthogonalised against all blocks so far, and what is left,
//! `Q_{j+1} R_j`, is the next block. In the basis `Q = [Q₁ … Q_j]` the operator is
//! `T = Qᵀ K Q`, block-tridiagonal; an eigenpair `(θ, s)` of `T` gives the Ritz pair `(θ, Q s)`
//! whose residual `‖K Q s − θ Q s‖ = ‖R_j s_j‖` costs nothing, `s_j` being the rows of `s` for the
//! last block.

use super::MAX_RESIDUAL;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Side};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

/// Stop at half the residual promised.
const TOLERANCE: f64 = 0.5 * MAX_RESIDUAL;

/// A whisper of random noise, relative to the operator, in every new block: where the Krylov
/// space is exhausted (few distinct colours; multiple eigenvalues) it becomes the new
/// direction. Small against `POSITIVE · TOLERANCE`.
const NOISE: f64 = 1e-14;

/// The part of the trace below which nothing is left to find. Chosen, not measured.
const NOTHING: f64 = 1e-11;

/// Rows that are multiplied at a time, fixed so that results do not depend on threads.
const BAND: usize = 4096;

/// A growing Krylov space of one operator.
pub(super) struct Krylov {
    size: usize,
    trace: f64,
    /// Orthonormal columns, column-major, the last `width` of them not multiplied yet.
    basis: Vec<f64>,
    width: usize,
    /// Columns multiplied last.
    previous: usize,
    /// `T` over the columns multiplied so far.
    projected: Mat<f64>,
    /// `R_j` of the last block multiplied.
    coupling: Mat<f64>,
    /// Largest `‖K q‖` seen: the scale of the operator.
    norm: f64,
    random: Xoshiro256PlusPlus,
    /// Eigenvalues of `T`, descending, their eigenvectors and residuals.
    values: Vec<f64>,
    vectors: Mat<f64>,
    residuals: Vec<f64>,
    /// Dimension at which to look at the Ritz pairs again.
    next_look: usize,
}

impl Krylov {
    /// A space of one random block of `width` columns, for an operator on `R^size` with the given trace.
    pub(super) fn new(size: usize, width: usize, trace: f64, seed: u64) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let width = width.min(size);
        let start = Mat::from_fn(size, width, |_, _| deviate(&mut random));
        let mut basis = Vec::new();
        append(&mut basis, start.qr().compute_thin_Q().as_ref());
        Self {
            size,
            trace,
            basis,
            width,
            previous: 0,
            projected: Mat::new(),
            coupling: Mat::new(),
            norm: 0.0,
            random,
            values: Vec::new(),
            vectors: Mat::new(),
            residuals: Vec::new(),
            next_look: 1,
        }
    }

    /// Trace of the operator.
    pub(super) fn trace(&self) -> f64 {
        self.trace
    }

    /// Ritz values, descending.
    pub(super) fn values(&self) -> &[f64] {
        &self.values
    }

    /// Whether Ritz pair `j` is an eigenpair to the tolerance.
    pub(super) fn converged(&self, j: usize) -> bool {
        self.residuals[j] <= TOLERANCE * self.values[j]
    }

    /// Whether an eigenvalue of at least `cutoff` may not be known yet. An eigenvalue lies
    /// within the residual of each Ritz value; those below `floor` of the first are noise.
    pub(super) fn lags(&self, cutoff: f64, floor: f64) -> bool {
        let Some(first) = self.values.first() else { return true };
        let floor = floor * first;
        let positive = self.values.iter().take_while(|theta| **theta > floor);
        let unknown = self.trace - positive.clone().sum::<f64>();
        let complete = self.width == 0 || unknown <= NOTHING * self.trace;
        let open = positive
            .zip(&self.residuals)
            .enumerate()
            .any(|(j, (theta, r))| theta + r >= cutoff && !self.converged(j));
        self.width > 0 && (open || (!complete && cutoff <= *first * f64::EPSILON))
    }

    /// Whether the space has grown enough since the last look to be worth another.
    pub(super) fn is_due(&self) -> bool {
        self.width == 0 || self.dimension() >= self.next_look
    }

    /// The block to be multiplied next, `size × width`.
    pub(super) fn block(&self) -> MatRef<'_, f64> {
        let known = self.basis.len() - self.size * self.width;
        MatRef::from_column_major_slice(&self.basis[known..], self.size, self.width)
    }

    /// Takes `K ·` [`Self::block`] and prepares the next block.
    pub(super) fn absorb(&mut self, mut product: Mat<f64>) {
        let columns = self.basis.len() / self.size;
        let q = MatRef::from_column_major_slice(&self.basis, self.size, columns);
        self.norm = product.col_iter().fold(self.norm, |norm, c| norm.max(c.norm_l2()));

        // T = Qᵀ K Q, its newest columns and by symmetry rows. Of K Q_j only the parts along Q_j
        // and Q_{j−1} are more than rounding: K of an earlier block is in the span of those up to
        // the next.
        let first = columns - self.width;
        let recent = first - self.previous;
        let overlap = inner(q.subcols(recent, columns - recent), &product);
        let old = std::mem::replace(&mut self.projected, Mat::zeros(columns, columns));
        self.projected.submatrix_mut(0, 0, first, first).copy_from(&old);
        let count = columns - recent;
        self.projected.submatrix_mut(recent, first, count, self.width).copy_from(&overlap);
        self.projected
            .submatrix_mut(first, recent, self.width, count)
            .copy_from(overlap.transpose());

        // What leaves the space, K Q_j − Q T_j, is orthogonal to all of Q only after a second pass.
        remove(&mut product, q.subcols(recent, columns - recent), &overlap);
        let scale = NOISE * self.norm;
        for column in product.col_iter_mut() {
            for entry in column.iter_mut() {
                *entry += scale * deviate(&mut self.random);
            }
        }
        let (mut next, coupling) = orthonormal(product.as_ref());
        let overlap = inner(q, &next);
        remove(&mut next, q, &overlap);
        let (next, _) = orthonormal(next.as_ref());

        self.coupling = coupling;
        self.previous = self.width;
        self.width = self.width.min(self.size - columns);
        append(&mut self.basis, next.subcols(0, self.width));
    }

    /// Rayleigh–Ritz: eigenpairs of `T` and their residuals.
    pub(super) fn project(&mut self) {
        let m = self.dimension();
        self.next_look = m + self.patience(m);
        // Only a matrix with an infinite or NaN entry has no decomposition; those of a mesh
        // with finite vertices have none.
        let Ok(eigen) = self.projected.self_adjoint_eigen(Side::Lower) else { return };
        let ascending = eigen.S().column_vector();
        self.values = (0..m).rev().map(|j| ascending[j]).collect();
        self.vectors = eigen.U().reverse_cols().to_owned();
        let last = self.coupling.ncols();
        let tails = &self.coupling * self.vectors.subrows(m - last, last);
        let exhausted = self.width == 0;
        self.residuals =
            tails.col_iter().map(|c| if exhausted { 0.0 } else { c.norm_l2() }).collect();
    }

    /// Columns to add after a look at dimension `m`, for about the work (in multiplications)
    /// that the look took: some `9 m³`, against `2 n² + 8 n m` for a column.
    fn patience(&self, m: usize) -> usize {
        let (n, m) = (self.size as f64, m as f64);
        (9.0 * m * m * m / (2.0 * n * n + 8.0 * n * m)).min(m) as usize + 1
    }

    /// The first `count` Ritz vectors, `size × count`, orthonormal.
    pub(super) fn vectors(&self, count: usize) -> Mat<f64> {
        let m = self.dimension();
        let q = MatRef::from_column_major_slice(&self.basis[..self.size * m], self.size, m);
        let mut vectors = Mat::zeros(self.size, count);
        let parts = bands(q, |_, q| q * self.vectors.subcols(0, count));
        for (rows, part) in (0..).step_by(BAND).zip(&parts) {
            vectors.subrows_mut(rows, part.nrows()).copy_from(part);
        }
        vectors
    }

    /// Columns multiplied so far.
    fn dimension(&self) -> usize {
        self.basis.len() / self.size - self.width
    }
}

/// What `part` makes of each band of rows, by the first of them.
fn bands<T: Send>(
    rows: MatRef<'_, f64>,
    part: impl Fn(usize, MatRef<'_, f64>) -> T + Sync,
) -> Vec<T> {
    let band = |first: usize| part(first, rows.subrows(first, BAND.min(rows.nrows() - first)));
    (0..rows.nrows()).into_par_iter().step_by(BAND).map(band).collect()
}

/// `qᵀ · block`.
fn inner(q: MatRef<'_, f64>, block: &Mat<f64>) -> Mat<f64> {
    let product = |first, q: MatRef<'_, f64>| q.transpose() * block.subrows(first, q.nrows());
    let parts = bands(q, product);
    parts.iter().fold(Mat::zeros(q.ncols(), block.ncols()), |sum, part| sum + part)
}

/// `Q` and `R` of a tall matrix, by those of each band and of the bands' `R` together
/// (Demmel, Grigori, Hoemmen & Langou 2012).
fn orthonormal(block: MatRef<'_, f64>) -> (Mat<f64>, Mat<f64>) {
    let factors = bands(block, |_, rows| {
        let factors = rows.qr();
        (factors.compute_thin_Q(), factors.thin_R().to_owned())
    });
    let heights = factors.iter().map(|(_, r)| r.nrows());
    let mut stacked = Mat::zeros(heights.sum(), block.ncols());
    let mut top = 0;
    for (_, r) in &factors {
        stacked.subrows_mut(top, r.nrows()).copy_from(r);
        top += r.nrows();
    }
    let joint = stacked.qr();
    let turns = joint.compute_thin_Q();
    let mut all = Mat::zeros(block.nrows(), turns.ncols());
    let (mut row, mut top) = (0, 0);
    for (q, r) in &factors {
        let band = all.subrows_mut(row, q.nrows());
        matmul(band, Accum::Replace, q, turns.subrows(top, r.nrows()), 1.0, Par::Seq);
        row += q.nrows();
        top += r.nrows();
    }
    (all, joint.thin_R().to_owned())
}

/// `block −= q · overlap`.
fn remove(block: &mut Mat<f64>, q: MatRef<'_, f64>, overlap: &Mat<f64>) {
    let parts = bands(q, |_, q| q * overlap);
    for (first, part) in (0..).step_by(BAND).zip(&parts) {
        let mut rows = block.subrows_mut(first, part.nrows());
        rows -= part;
    }
}

fn append(basis: &mut Vec<f64>, block: MatRef<'_, f64>) {
    basis.extend(block.col_iter().flat_map(|c| c.iter().copied()));
}

/// Uniform in `[-1, 1)`.
fn deviate(random: &mut Xoshiro256PlusPlus) -> f64 {
    (random.next_u64() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}
