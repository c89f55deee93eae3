//! One half of a model in double precision: a mean and the components of what deviates from it.

use faer::Mat;
use onescan_core::basis::{Basis, padded};

/// One half of a model: a mean and the eigenpairs of its covariance, over the same vertices.
pub struct Half<'a> {
    /// Mean per vertex: positions in millimetres or RGB in `[0, 1]`.
    pub mean: &'a [[f32; 3]],
    /// What instances add to it.
    pub deviation: &'a dyn Deviation,
}

/// Orthogonal components of a field over the vertices, in descending order.
pub trait Deviation: Sync {
    /// Their variances.
    fn variances(&self) -> &[f64];

    /// Trace of the covariance they are the leading components of.
    fn total_variance(&self) -> f64;

    /// Component `k` in one channel, its standard deviation included: a factor, and what it
    /// multiplies per vertex.
    fn column(&self, k: usize, channel: usize) -> (f64, &[f64]);
}

/// A low-rank Gaussian process over V vertices, three numbers each:
/// `mean + U diag(√λ) c`, `c ~ N(0, I)`, and independent noise on every number.
///
/// Guarantees: `3V` rows and as many columns in `U` as there are `λ`, all of them finite, `λ` and
/// noise not negative. The columns may have any norm; those of a decomposition are orthonormal.
#[derive(Clone, Debug)]
pub struct Process {
    /// Per vertex: x, y, z in millimetres, or R, G, B in `[0, 1]`.
    pub mean: Vec<[f32; 3]>,
    /// `U`, 3V × r: first all vertices' x (or R), then their y, then their z.
    pub basis: Mat<f64>,
    /// `λ`.
    pub variances: Vec<f64>,
    /// Variance of the noise.
    pub noise: f64,
    /// Trace of the covariance that the components are the leading part of, without noise.
    pub total_variance: f64,
}

impl Process {
    /// A process that is all there is: nothing was left out.
    pub fn new(mean: Vec<[f32; 3]>, basis: Mat<f64>, variances: Vec<f64>, noise: f64) -> Self {
        let total_variance = held(&basis, &variances);
        Self { mean, basis, variances, noise, total_variance }
    }

    /// One component that changes nothing.
    pub fn zero(vertices: usize) -> Self {
        Self::new(vec![[0.0; 3]; vertices], Mat::zeros(3 * vertices, 1), vec![0.0], 0.0)
    }

    /// One half of a `.3dmm` model of so many vertices.
    pub fn of(basis: &Basis<'_>, vertices: usize) -> Self {
        let plane = padded(vertices);
        let variances: Vec<f64> = basis.variance().iter().map(|&v| f64::from(v)).collect();
        let entries = Mat::from_fn(3 * vertices, variances.len(), |row, k| {
            let entry = basis.term(row / vertices * plane + row % vertices, k, 1.0);
            f64::from(entry) / variances[k].sqrt().max(f64::MIN_POSITIVE)
        });
        let mean = |v: usize| [0, 1, 2].map(|channel| basis.mean()[channel * plane + v]);
        Self {
            mean: (0..vertices).map(mean).collect(),
            basis: entries,
            variances,
            noise: 0.0,
            total_variance: basis.total_variance(),
        }
    }

    /// Trace of the covariance that the components make, `U diag(λ) Uᵀ`.
    pub fn held(&self) -> f64 {
        held(&self.basis, &self.variances)
    }

    /// Number of components.
    pub fn rank(&self) -> usize {
        self.variances.len()
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.mean.len()
    }

    /// Fraction of the whole variance that the components hold.
    pub fn captured(&self) -> f64 {
        if self.total_variance > 0.0 { self.held() / self.total_variance } else { 1.0 }
    }

    /// `Q = U diag(√λ)`: the components with their standard deviations.
    pub fn scaled_basis(&self) -> Mat<f64> {
        let mut scaled = self.basis.clone();
        for (column, variance) in scaled.col_iter_mut().zip(&self.variances) {
            for entry in column.iter_mut() {
                *entry *= variance.sqrt();
            }
        }
        scaled
    }

    /// The field of coefficients; missing ones count as zero, those beyond the rank are ignored.
    pub fn instance(&self, coefficients: &[f64]) -> Vec<[f64; 3]> {
        let mut field: Vec<[f64; 3]> = self.mean.iter().map(|m| m.map(f64::from)).collect();
        let vertices = self.vertices();
        for ((c, variance), column) in
            coefficients.iter().zip(&self.variances).zip(self.basis.col_iter())
        {
            let c = c * variance.sqrt();
            for (row, entry) in column.iter().enumerate() {
                field[row % vertices][row / vertices] += c * entry;
            }
        }
        field
    }

    /// The same process in another unit: every length is so many times what it was.
    #[must_use]
    pub fn in_unit(mut self, factor: f64) -> Self {
        if factor == 1.0 {
            return self;
        }
        let square = factor * factor;
        self.mean.as_flattened_mut().iter_mut().for_each(|x| *x = (f64::from(*x) * factor) as f32);
        self.variances.iter_mut().for_each(|v| *v *= square);
        Self { noise: self.noise * square, total_variance: self.total_variance * square, ..self }
    }

    /// The same process with columns of norm one and variances to go with them, in descending
    /// order.
    #[must_use]
    pub fn with_unit_columns(&self) -> Self {
        let norms: Vec<f64> = self.basis.col_iter().map(|u| u.norm_l2()).collect();
        let variance = |k: usize| self.variances[k] * norms[k] * norms[k];
        let mut order: Vec<usize> = (0..self.rank()).collect();
        order.sort_by(|&a, &b| variance(b).total_cmp(&variance(a)));
        Self {
            mean: self.mean.clone(),
            basis: Mat::from_fn(self.basis.nrows(), order.len(), |row, k| {
                self.basis[(row, order[k])] / norms[order[k]].max(f64::MIN_POSITIVE)
            }),
            variances: order.iter().map(|&k| variance(k)).collect(),
            ..*self
        }
    }

    /// The first `rank` components.
    #[must_use]
    pub fn truncated(&self, rank: usize) -> Self {
        let rank = rank.min(self.rank());
        Self {
            mean: self.mean.clone(),
            basis: self.basis.subcols(0, rank).to_owned(),
            variances: self.variances[..rank].to_vec(),
            ..*self
        }
    }

    /// The same process on some of the vertices. Its columns are no longer orthogonal.
    #[must_use]
    pub fn marginal(&self, vertices: &[u32]) -> Self {
        let count = vertices.len();
        let row = |i: usize| i / count * self.vertices() + vertices[i % count] as usize;
        let basis = Mat::from_fn(3 * count, self.rank(), |i, k| self.basis[(row(i), k)]);
        let part = Self {
            mean: vertices.iter().map(|&v| self.mean[v as usize]).collect(),
            basis,
            variances: self.variances.clone(),
            ..*self
        };
        // What the components never held is assumed to be spread over the vertices like what
        // they hold.
        let (before, after) = (self.held(), part.held());
        let share = if before > 0.0 { after / before } else { 1.0 };
        Self { total_variance: self.total_variance * share, ..part }
    }
}

/// Trace of `U diag(λ) Uᵀ`.
fn held(basis: &Mat<f64>, variances: &[f64]) -> f64 {
    basis.col_iter().zip(variances).map(|(u, v)| v * u.squared_norm_l2()).sum()
}

impl Deviation for Process {
    fn variances(&self) -> &[f64] {
        &self.variances
    }

    fn total_variance(&self) -> f64 {
        self.total_variance
    }

    fn column(&self, k: usize, channel: usize) -> (f64, &[f64]) {
        let vertices = self.basis.nrows() / 3;
        let column = self.basis.col(k).try_as_col_major().map_or(&[][..], |c| c.as_slice());
        (self.variances[k].sqrt(), &column[channel * vertices..(channel + 1) * vertices])
    }
}
