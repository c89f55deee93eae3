//! The same covariance in orthonormal components, largest variance first.
//!
//! The eigenpairs of `Q Qᵀ` (3V × 3V, rank r) come from an r × r problem:
//!
//! ```text
//! QᵀQ w = λ w      u = Q w / √λ
//! ```

use crate::error::{Error, Result};
use crate::model::morphable::Morphable;
use crate::model::process::Process;
use faer::{Mat, Side};

/// Components below this fraction of the first one's variance are left out: eigenvalues of `QᵀQ`
/// are exact to 2⁻⁵² of the largest, so the columns of smaller ones would not be orthogonal to
/// 1e-8.
pub const NEGLIGIBLE: f64 = 1e-8;

/// Orthonormal columns `U` and descending `λ` with `U diag(λ) Uᵀ = Q Qᵀ` up to [`NEGLIGIBLE`]
/// components; each column's entry of largest magnitude is positive.
///
/// # Errors
/// Entries too large for a decomposition.
pub fn components(q: &Mat<f64>) -> Result<(Mat<f64>, Vec<f64>)> {
    if q.nrows() == 0 || q.ncols() == 0 {
        return Ok((Mat::zeros(q.nrows(), 0), Vec::new()));
    }
    let wide = q.ncols() > q.nrows();
    let small = if wide { q * q.transpose() } else { q.transpose() * q };
    let eigen = small.self_adjoint_eigen(Side::Lower).map_err(|_| {
        Error::new("the covariance cannot be decomposed; are its numbers finite and sensible?")
    })?;
    let ascending = eigen.S().column_vector();
    let mut variances: Vec<f64> = (0..small.nrows()).rev().map(|j| ascending[j]).collect();
    let floor = NEGLIGIBLE * variances.first().map_or(0.0, |first| first.max(0.0));
    variances.truncate(variances.partition_point(|&variance| variance > floor));
    let vectors = eigen.U().reverse_cols().subcols(0, variances.len());
    let mut basis = if wide { vectors.to_owned() } else { q * vectors };
    for k in 0..variances.len() {
        let (mut leader, mut squares) = (0.0_f64, 0.0);
        for &entry in basis.col(k).iter() {
            leader = if entry.abs() > leader.abs() { entry } else { leader };
            squares += entry * entry;
        }
        let scale = leader.signum() / squares.sqrt();
        for entry in basis.col_mut(k).iter_mut() {
            *entry *= scale;
        }
    }
    Ok((basis, variances))
}

impl Process {
    /// The same process in orthonormal components, largest variance first. Coefficients mean other
    /// fields than before.
    ///
    /// # Errors
    /// See [`components`].
    pub fn orthonormal(&self) -> Result<Self> {
        self.with_components(&self.scaled_basis(), self.total_variance)
    }

    /// This mean and noise, and the covariance `Q Qᵀ`.
    pub(super) fn with_components(&self, q: &Mat<f64>, total_variance: f64) -> Result<Self> {
        let (basis, variances) = components(q)?;
        Ok(Self { mean: self.mean.clone(), basis, variances, noise: self.noise, total_variance })
    }
}

impl Morphable {
    /// The same model in orthonormal components, see [`Process::orthonormal`].
    ///
    /// # Errors
    /// See [`components`].
    pub fn orthonormal(self) -> Result<Self> {
        Ok(Self { shape: self.shape.orthonormal()?, albedo: self.albedo.orthonormal()?, ..self })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{assert_close, covariance, process};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn components_change_and_the_covariance_stays(
            vertices in 1_usize..12, rank in 0_usize..20, seed in 0_u64..1000,
        ) {
            let before = process(vertices, rank, seed);
            let after = before.orthonormal().unwrap();
            assert_close(&covariance(&after), &covariance(&before), 1e-7);
            let unit = after.basis.transpose() * &after.basis;
            assert_close(&unit, &Mat::identity(after.rank(), after.rank()), 1e-7);
            prop_assert!(after.variances.is_sorted_by(|a, b| a >= b));
            prop_assert!(after.rank() <= rank.min(3 * vertices));
        }
    }

    #[test]
    fn a_component_said_twice_is_one_with_the_sum_of_its_variances() {
        let mut twice = process(7, 2, 1);
        let first = twice.basis.col(0).to_owned();
        twice.basis.col_mut(1).copy_from(&first);
        let once = twice.orthonormal().unwrap();
        assert_eq!(once.rank(), 1);
        assert!((once.variances[0] - twice.held()).abs() < 1e-9);
    }
}
