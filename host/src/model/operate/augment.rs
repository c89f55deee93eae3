//! Deviations of two models together: a model of few scans lends itself the flexibility of one
//! scan's kernels (Lüthi et al., "Gaussian process morphable models", section on augmenting a
//! statistical model; the paper, section "Introduction").
//!
//! The sum of two independent processes has the sum of their covariances. Of low rank, both are
//! kept exactly: `[Q₁ Q₂] [Q₁ Q₂]ᵀ = Q₁Q₁ᵀ + Q₂Q₂ᵀ`.

use super::columns;
use crate::error::{Error, Result};
use crate::model::morphable::Morphable;
use crate::model::process::Process;
use faer::Mat;

impl Process {
    /// This process plus the deviations of another: this mean, the sum of the covariances, noises
    /// and variances. Components are orthonormal, as many as both have or the vertices allow.
    ///
    /// # Errors
    /// A process over another number of vertices.
    pub fn augmented(&self, other: &Self) -> Result<Self> {
        self.check_length(other.vertices())?;
        let (own, more) = (self.scaled_basis(), other.scaled_basis());
        let rank = self.rank();
        let mut q = Mat::zeros(own.nrows(), rank + other.rank());
        q.subcols_mut(0, rank).copy_from(&own);
        q.subcols_mut(rank, other.rank()).copy_from(&more);
        let sum = self.with_components(&q, self.total_variance + other.total_variance)?;
        Ok(Self { noise: self.noise + other.noise, ..sum })
    }
}

impl Morphable {
    /// This model plus the deviations of another on the same topology, see [`Process::augmented`].
    ///
    /// # Errors
    /// A model of another topology.
    pub fn augmented(&self, other: &Self) -> Result<Self> {
        if self.triangles != other.triangles {
            return Err(Error::new(
                "the models have different triangles; build both on the same mesh",
            ));
        }
        Ok(Self {
            shape: self.shape.augmented(&other.shape)?,
            albedo: self.albedo.augmented(&other.albedo)?,
            ..self.clone()
        })
    }

    /// Root mean square distance of the vertices of two means, millimetres. Kernels of another
    /// mesh suit this one as far as the meshes are alike.
    pub fn mean_distance(&self, other: &Self) -> f64 {
        let vertices = self.shape.vertices().max(1);
        let pair = columns(vertices, &[&self.shape.mean, &other.shape.mean]);
        ((pair.col(0) - pair.col(1)).squared_norm_l2() / vertices as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{assert_close, covariance, morphable, process};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn covariances_add(
            vertices in 1_usize..8, ranks in [0_usize..12, 0_usize..12], seed in 0_u64..1000,
        ) {
            let [a, b] = [0, 1].map(|i| process(vertices, ranks[i], seed + i as u64));
            let both = a.augmented(&b).unwrap();
            assert_close(&covariance(&both), &(covariance(&a) + covariance(&b)), 1e-7);
            prop_assert_eq!(&both.mean, &a.mean);
            prop_assert!(both.rank() <= (a.rank() + b.rank()).min(3 * vertices));
            let total = a.total_variance + b.total_variance;
            prop_assert!((both.total_variance - total).abs() <= 1e-12 * total);
        }
    }

    #[test]
    fn models_of_other_meshes_are_refused() {
        let (a, mut b) = (morphable(6, 3, 1), morphable(6, 3, 2));
        assert!(a.augmented(&b).is_ok());
        b.triangles.pop();
        assert!(a.augmented(&b).unwrap_err().to_string().contains("different triangles"));
        let (p, q) = (process(6, 3, 1), process(5, 3, 1));
        assert!(p.augmented(&q).is_err());
    }
}
