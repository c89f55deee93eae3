//! Meshes in the model: the coefficients that explain one best.
//!
//! The posterior mean of the coefficients given a mesh in correspondence, every number of which has
//! independent noise of variance σ²:
//!
//! ```text
//! c = (QᵀQ + σ²I)⁻¹ Qᵀ (s − m)
//! ```
//!
//! For orthonormal `U` this is `c_i = √λ_i / (λ_i + σ²) · u_iᵀ(s − m)`. (The reference engine uses
//! `UᵀU diag(λ)` for `QᵀQ`, which is another matrix if the columns are not orthogonal.)

use super::columns;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::model::morphable::Morphable;
use crate::model::process::Process;
use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

/// Least variance of the noise of a mesh, mm² or squared colour: the reference engine's.
pub const LEAST_NOISE: f64 = 1e-5;

/// `(G + σ²I)⁻¹ B`, `G = QᵀQ`.
///
/// # Errors
/// When `G + σ²I` is not positive definite.
pub(crate) fn ridge(g: MatRef<'_, f64>, b: MatRef<'_, f64>, noise: f64) -> Result<Mat<f64>> {
    let mut m = g.to_owned();
    for k in 0..m.nrows() {
        m[(k, k)] += noise;
    }
    let factors = m.llt(Side::Lower).map_err(|_| {
        Error::new("components depend on each other; raise the noise, or make them orthonormal")
    })?;
    Ok(factors.solve(b))
}

impl Process {
    /// The coefficients that explain a field, noise of variance `noise` on each of its numbers.
    /// Without noise they are the least-squares ones.
    ///
    /// # Errors
    /// A field over another number of vertices; dependent components without noise.
    pub fn coefficients<T: Copy + Into<f64>>(
        &self,
        field: &[[T; 3]],
        noise: f64,
    ) -> Result<Vec<f64>> {
        self.check_length(field.len())?;
        let mean = columns(self.vertices(), &[&self.mean]);
        let deviation = columns(self.vertices(), &[field]) - mean;
        let q = self.scaled_basis();
        let (g, b) = (q.transpose() * &q, q.transpose() * deviation);
        let c = ridge(g.as_ref(), b.as_ref(), noise)?;
        Ok(c.col(0).iter().copied().collect())
    }

    /// The variance of a mesh's noise that the model itself suggests: its own, but at least
    /// [`LEAST_NOISE`].
    pub fn usual_noise(&self) -> f64 {
        self.noise.max(LEAST_NOISE)
    }

    pub(super) fn check_length(&self, vertices: usize) -> Result<()> {
        if vertices == self.vertices() {
            return Ok(());
        }
        Err(Error::new(format_args!(
            "has {vertices} vertices, the model {}; give a mesh of the model's topology",
            self.vertices()
        )))
    }
}

impl Morphable {
    /// Coefficients of shape and of albedo that explain a mesh of the model's topology; `noise` is
    /// the variance of every number, [`Process::usual_noise`] if not given.
    ///
    /// # Errors
    /// See [`Process::coefficients`].
    pub fn project(&self, mesh: &Mesh, noise: Option<f64>) -> Result<[Vec<f64>; 2]> {
        let half = |process: &Process, field: &[[f32; 3]]| {
            process.coefficients(field, noise.unwrap_or_else(|| process.usual_noise()))
        };
        Ok([half(&self.shape, &mesh.points)?, half(&self.albedo, &mesh.colors)?])
    }

    /// The model's mesh that explains a mesh of its topology: the instance of
    /// [`Morphable::project`].
    ///
    /// # Errors
    /// See [`Process::coefficients`].
    pub fn reconstruct(&self, mesh: &Mesh, noise: Option<f64>) -> Result<Mesh> {
        let [shape, albedo] = self.project(mesh, noise)?;
        Ok(self.instance(&shape, &albedo))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::process;
    use proptest::prelude::*;

    fn some_coefficients(rank: usize) -> Vec<f64> {
        (0..rank).map(|k| (1.7 * k as f64 + 0.4).sin() * 2.0).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn an_instance_has_the_coefficients_it_was_made_of(
            vertices in 4_usize..12, rank in 1_usize..8, seed in 0_u64..1000, orthonormal: bool,
        ) {
            let mut process = process(vertices, rank, seed);
            if orthonormal {
                process = process.orthonormal().unwrap();
            }
            let known = some_coefficients(process.rank());
            let found = process.coefficients(&process.instance(&known), 1e-14).unwrap();
            for (a, b) in known.iter().zip(&found) {
                prop_assert!((a - b).abs() < 1e-6, "{known:?} came back as {found:?}");
            }
        }

        #[test]
        fn noise_draws_coefficients_to_zero(seed in 0_u64..1000) {
            let process = process(6, 5, seed);
            let field = process.instance(&some_coefficients(5));
            let size = |noise| {
                let c = process.coefficients(&field, noise).unwrap();
                c.iter().map(|c| c * c).sum::<f64>()
            };
            prop_assert!(size(0.1) > size(10.0) && size(10.0) > size(1000.0));
        }
    }

    #[test]
    fn orthonormal_components_have_a_closed_form() {
        let process = process(6, 4, 3).orthonormal().unwrap();
        let (field, noise) = (process.instance(&[1.0, -2.0, 0.5, 0.25]), 2.0);
        for (k, c) in process.coefficients(&field, noise).unwrap().into_iter().enumerate() {
            let overlap: f64 = (0..18)
                .map(|row| {
                    let mean = f64::from(process.mean[row % 6][row / 6]);
                    process.basis[(row, k)] * (field[row % 6][row / 6] - mean)
                })
                .sum();
            let variance = process.variances[k];
            assert!((c - variance.sqrt() / (variance + noise) * overlap).abs() < 1e-9);
        }
    }

    #[test]
    fn a_field_of_another_mesh_is_refused() {
        let error = process(6, 4, 3).coefficients(&[[0.0; 3]; 5], 1.0).unwrap_err();
        assert!(error.to_string().contains("5 vertices, the model 6"), "{error}");
    }
}
