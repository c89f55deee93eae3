//! Mean plus scaled eigenvectors: coefficients in, a field over all vertices out.
//!
//! A *field* holds three numbers per vertex (x y z, or R G B) as three planes of
//! [`padded`]`(vertices)` numbers, so that one loop over a plane is one loop over vertices.
//! The eigenbasis is stored in blocks of [`LANES`] field entries, and within a block component
//! after component: an instance streams the bytes once, front to back, with the accumulators in
//! registers. Every entry is one sum in component order, whatever the vector width.

/// Field entries per block of the basis.
pub const LANES: usize = 32;

/// Length of one plane of a field: `vertices` rounded up to whole blocks.
pub const fn padded(vertices: usize) -> usize {
    vertices.div_ceil(LANES) * LANES
}

/// Length of a field: three planes.
pub const fn field_len(vertices: usize) -> usize {
    3 * padded(vertices)
}

/// One half of a model: `field = mean + Σ_k c_k·√λ_k·u_k` (the shape or the albedo).
#[derive(Clone, Copy, Debug)]
pub struct Basis<'a> {
    pub(crate) mean: &'a [[f32; LANES]],
    /// `[block][component]`, already multiplied by `√λ`.
    pub(crate) columns: &'a [[f32; LANES]],
    pub(crate) variance: &'a [f32],
    pub(crate) total_variance: f64,
}

impl<'a> Basis<'a> {
    /// Number of components.
    pub fn rank(&self) -> usize {
        self.variance.len()
    }

    /// Eigenvalues `λ` of the 3V×3V covariance, descending.
    pub fn variance(&self) -> &'a [f32] {
        self.variance
    }

    /// Trace of the whole covariance, before truncation to [`Basis::rank`] components.
    pub fn total_variance(&self) -> f64 {
        self.total_variance
    }

    /// The mean as a field.
    pub fn mean(&self) -> &'a [f32] {
        self.mean.as_flattened()
    }

    /// Fills `field` (length [`field_len`]) with the instance of the coefficients. Coefficients
    /// beyond the rank are ignored, missing ones count as zero.
    pub fn instance(&self, coefficients: &[f32], field: &mut [f32]) {
        let rank = self.rank();
        let (blocks, _) = field.as_chunks_mut::<LANES>();
        if rank == 0 {
            for (out, mean) in blocks.iter_mut().zip(self.mean) {
                *out = *mean;
            }
            return;
        }
        for ((out, mean), columns) in
            blocks.iter_mut().zip(self.mean).zip(self.columns.chunks_exact(rank))
        {
            let mut sum = *mean;
            for (&c, column) in coefficients.iter().zip(columns) {
                for l in 0..LANES {
                    sum[l] += c * column[l];
                }
            }
            *out = sum;
        }
    }

    /// Component `k` at one field entry, scaled by its standard deviation.
    ///
    /// # Panics
    /// If `entry` or `k` is out of range.
    pub fn entry(&self, entry: usize, k: usize) -> f32 {
        self.columns[entry / LANES * self.rank() + k][entry % LANES]
    }
}
