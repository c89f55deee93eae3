//! The model that knows some vertices: Gaussian-process regression.
//!
//! With `Q_t` the rows of `Q` of the observed numbers `y`, and `Σ` the covariance of their errors
//! (3 × 3 blocks), coefficients have the posterior
//!
//! ```text
//! M = Q_tᵀ Σ⁻¹ Q_t + I      c̄ = M⁻¹ Q_tᵀ Σ⁻¹ (y − m_t)      Cov(c) = M⁻¹
//! ```
//!
//! `M` squares what is already large when errors are small, so it is never formed: with
//! `Σ^(-½) Q_t = P diag(s) Vᵀ`
//!
//! ```text
//! c̄ = V diag(s / (1 + s²)) Pᵀ Σ^(-½) (y − m_t)
//! M⁻¹ = F Fᵀ,  F = I − V diag(1 − 1/√(1 + s²)) Vᵀ
//! ```
//!
//! and the posterior is the mean `m + Q c̄` with the covariance `(Q F)(Q F)ᵀ`.

use crate::error::{Error, Result};
use crate::model::kernel::Matrix3;
use crate::model::morphable::Morphable;
use crate::model::process::Process;
use faer::Mat;

/// Least variance of an error, mm² or squared colour: exact data are exact to a millionth.
const LEAST_ERROR: f64 = 1e-12;

/// What is known of one vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// The vertex.
    pub vertex: u32,
    /// Where it is, millimetres, or its colour.
    pub value: [f64; 3],
    /// Covariance of the error of `value`, mm² or squared colour; zero for exact data.
    pub covariance: Matrix3,
}

impl Observation {
    /// A value with independent errors of one standard deviation.
    pub fn isotropic(vertex: u32, value: [f64; 3], deviation: f64) -> Self {
        let mut covariance = [[0.0; 3]; 3];
        for (k, row) in covariance.iter_mut().enumerate() {
            row[k] = deviation * deviation;
        }
        Self { vertex, value, covariance }
    }
}

impl Process {
    /// The process given observations; its own noise adds to their errors. Components are
    /// orthonormal, leading ones first. Data say nothing of the variance that the components
    /// never held.
    ///
    /// # Errors
    /// A vertex out of range, a covariance that is not positive semidefinite, numbers that are not finite.
    pub fn posterior(&self, observations: &[Observation]) -> Result<Self> {
        let (vertices, rank) = (self.vertices(), self.rank());
        let q = self.scaled_basis();
        let mut rows = Mat::zeros(3 * observations.len(), rank);
        let mut residual = Mat::zeros(3 * observations.len(), 1);
        for (i, observation) in observations.iter().enumerate() {
            let v = observation.vertex as usize;
            let fault = |what: &str| Error::new(format_args!("observation {i}: {what}"));
            let mean = self.mean.get(v).ok_or_else(|| fault("no such vertex in the model"))?;
            if !observation.value.iter().all(|x| x.is_finite()) {
                return Err(fault("its value is not finite"));
            }
            let whiten = Whitening::new(observation.covariance, self.noise + LEAST_ERROR)
                .ok_or_else(|| fault("its covariance is not that of any error"))?;
            let mut put = |k: Option<usize>, values: [f64; 3]| {
                for (axis, value) in whiten.apply(values).into_iter().enumerate() {
                    match k {
                        Some(k) => rows[(3 * i + axis, k)] = value,
                        None => residual[(3 * i + axis, 0)] = value,
                    }
                }
            };
            for k in 0..rank {
                put(Some(k), [0, 1, 2].map(|axis| q[(axis * vertices + v, k)]));
            }
            put(None, [0, 1, 2].map(|axis| observation.value[axis] - f64::from(mean[axis])));
        }
        if observations.is_empty() || rank == 0 {
            return Ok(self.clone());
        }
        let svd = rows.thin_svd().map_err(|_| {
            Error::new("the observations cannot be decomposed; are their errors sensible numbers?")
        })?;
        let (s, v) = (svd.S().column_vector(), svd.V());
        let seen = svd.U().transpose() * &residual;
        let weights = Mat::from_fn(s.nrows(), 1, |k, _| s[k] / (1.0 + s[k] * s[k]) * seen[(k, 0)]);
        let c = v * weights;
        let lost = Mat::from_fn(rank, s.nrows(), |i, k| {
            v[(i, k)] * (1.0 - 1.0 / (1.0 + s[k] * s[k]).sqrt())
        });
        let f = Mat::<f64>::identity(rank, rank) - lost * v.transpose();

        let c: Vec<f64> = c.col(0).iter().copied().collect();
        let mean = self.instance(&c).into_iter().map(|p| p.map(|x| x as f32)).collect();
        let unheld = (self.total_variance - self.held()).max(0.0);
        let posterior = self.with_components(&(q * f), 0.0)?;
        let total_variance = posterior.variances.iter().sum::<f64>() + unheld;
        Ok(Self { mean, total_variance, ..posterior })
    }
}

impl Morphable {
    /// The model given observations of its shape and of its albedo.
    ///
    /// # Errors
    /// See [`Process::posterior`].
    pub fn posterior(&self, shape: &[Observation], albedo: &[Observation]) -> Result<Self> {
        Ok(Self {
            shape: self.shape.posterior(shape)?,
            albedo: self.albedo.posterior(albedo)?,
            ..self.clone()
        })
    }
}

/// `L⁻¹` of a covariance `Σ = L Lᵀ`: `L⁻¹ x` has independent errors of variance 1.
struct Whitening([[f64; 3]; 3]);

impl Whitening {
    /// Of `Σ + extra·I`; `None` if that is not positive definite.
    fn new(covariance: Matrix3, extra: f64) -> Option<Self> {
        let mut l = [[0.0; 3]; 3];
        for i in 0..3 {
            for j in 0..=i {
                // Rounding may leave halves apart; the lower one counts.
                let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
                let rest = covariance[i][j] - sum + if i == j { extra } else { 0.0 };
                l[i][j] = if i == j { rest.sqrt() } else { rest / l[j][j] };
            }
            // Not `<=`: what is not a number is refused as well.
            if !(l[i][i] > 0.0 && l[i].iter().all(|x| x.is_finite())) {
                return None;
            }
        }
        Some(Self(l))
    }

    fn apply(&self, values: [f64; 3]) -> [f64; 3] {
        let Self(l) = self;
        let mut out = values;
        for i in 0..3 {
            let known: f64 = (0..i).map(|k| l[i][k] * out[k]).sum();
            out[i] = (values[i] - known) / l[i][i];
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{assert_close, covariance, process};
    use super::*;
    use proptest::prelude::*;

    /// Variance of every number, 3V.
    fn variances(process: &Process) -> Vec<f64> {
        let all = covariance(process);
        (0..all.nrows()).map(|i| all[(i, i)]).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn without_noise_it_passes_through_its_data(seed in 0_u64..1000, x in -9.0..9.0_f64) {
            let prior = process(8, 12, seed);
            let data = [
                Observation::isotropic(1, [x, 2.0, -3.0], 0.0),
                Observation::isotropic(6, [0.5, -x, 30.0], 0.0),
            ];
            let posterior = prior.posterior(&data).unwrap();
            for data in &data {
                for axis in 0..3 {
                    let mean = posterior.mean[data.vertex as usize][axis];
                    prop_assert!((f64::from(mean) - data.value[axis]).abs() < 1e-4);
                }
            }
            let (before, after) = (variances(&prior), variances(&posterior));
            for (row, (before, after)) in before.iter().zip(&after).enumerate() {
                let known = data.iter().any(|data| data.vertex as usize == row % 8);
                // What is left out as negligible may have been anywhere.
                let most = if known { 1e-5 } else { *before };
                prop_assert!(*after <= most + 1e-9, "{row}: {before} becomes {after}");
            }
        }

        #[test]
        fn all_data_give_the_projection(seed in 0_u64..1000, noise in 0.01..10.0_f64) {
            let prior = process(7, 5, seed);
            let field = prior.instance(&[1.0, -0.5, 2.0, 0.1, -1.5]);
            let data: Vec<_> = (0..7)
                .map(|v| Observation::isotropic(v, field[v as usize], noise.sqrt()))
                .collect();
            let posterior = prior.posterior(&data).unwrap();
            let c = prior.coefficients(&field, noise).unwrap();
            for (a, b) in posterior.mean.iter().zip(prior.instance(&c)) {
                for axis in 0..3 {
                    prop_assert!((f64::from(a[axis]) - b[axis]).abs() < 1e-4);
                }
            }
        }

        #[test]
        fn it_is_the_textbook_formula(seed in 0_u64..1000, sd in 0.2..3.0_f64) {
            let prior = process(6, 4, seed);
            let mut data = [
                Observation::isotropic(0, [1.0, 2.0, 3.0], sd),
                Observation::isotropic(4, [-1.0, 0.0, 7.0], sd),
            ];
            data[1].covariance = [[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 3.0]];
            // K − K_t (K_tt + Σ)⁻¹ K_tᵀ
            let k = covariance(&prior);
            let at = |i: usize| i % 3 * 6 + data[i / 3].vertex as usize;
            let noisy = Mat::from_fn(6, 6, |i, j| {
                let error = if i / 3 == j / 3 { data[i / 3].covariance[i % 3][j % 3] } else { 0.0 };
                k[(at(i), at(j))] + error
            });
            let cross = Mat::from_fn(18, 6, |i, j| k[(i, at(j))]);
            let gain = {
                use faer::linalg::solvers::Solve;
                noisy.llt(faer::Side::Lower).unwrap().solve(cross.transpose())
            };
            let expected = k - &cross * &gain;
            let posterior = prior.posterior(&data).unwrap();
            assert_close(&covariance(&posterior), &expected, 1e-6);
        }
    }

    #[test]
    fn an_error_along_one_axis_leaves_that_axis_free() {
        let prior = process(5, 9, 4);
        let mut data = Observation::isotropic(2, [0.0; 3], 1e-3);
        data.covariance[1][1] = 1e6;
        let (before, after) = (variances(&prior), variances(&prior.posterior(&[data]).unwrap()));
        let (x, y) = (2, 5 + 2);
        assert!(after[x] < 1e-4 * before[x] && after[y] > 1e-3 * before[y]);
    }

    #[test]
    fn nonsense_is_refused_by_its_number() {
        let prior = process(5, 3, 4);
        let good = Observation::isotropic(2, [0.0; 3], 1.0);
        let mut odd = good;
        odd.covariance[0][0] = -1.0;
        for bad in [
            odd,
            Observation { vertex: 5, ..good },
            Observation { value: [f64::NAN; 3], ..good },
            Observation::isotropic(2, [0.0; 3], f64::NAN),
        ] {
            let error = prior.posterior(&[good, bad]).unwrap_err().to_string();
            assert!(error.starts_with("observation 1: "), "{error}");
        }
    }
}
