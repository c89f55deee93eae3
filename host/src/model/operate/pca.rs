//! The model of registered meshes: principal components.
//!
//! With n meshes `s_j` on one topology, `m` their mean and `X = [s_1 − m, …, s_n − m] / √(n − 1)`,
//! the sample covariance is `X Xᵀ`; its components come from the smaller of `XᵀX` and `X Xᵀ`.

use super::columns;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::landmarks::Landmark;
use crate::model::morphable::Morphable;
use crate::model::process::Process;

impl Process {
    /// Mean and principal components of at least two fields over the same vertices: orthonormal,
    /// at most one fewer than fields.
    ///
    /// # Errors
    /// Fewer than two fields, fields of different length.
    pub fn of_samples(fields: &[&[[f32; 3]]]) -> Result<Self> {
        let [first, _, ..] = fields else {
            return Err(Error::new("a covariance needs two meshes or more"));
        };
        let (vertices, n) = (first.len(), fields.len());
        if let Some(odd) = fields.iter().position(|field| field.len() != vertices) {
            return Err(Error::new(format_args!(
                "mesh {odd} has {} vertices, the first {vertices}; give registered meshes",
                fields[odd].len()
            )));
        }
        let mut x = columns(vertices, fields);
        let mut mean = vec![[0.0; 3]; vertices];
        for row in 0..x.nrows() {
            let average = x.row(row).iter().sum::<f64>() / n as f64;
            mean[row % vertices][row / vertices] = average as f32;
            for j in 0..n {
                x[(row, j)] = (x[(row, j)] - average) / ((n - 1) as f64).sqrt();
            }
        }
        let none = Self {
            mean,
            basis: faer::Mat::zeros(3 * vertices, 0),
            variances: Vec::new(),
            noise: 0.0,
            total_variance: 0.0,
        };
        none.with_components(&x, x.squared_norm_l2())
    }
}

impl Morphable {
    /// Mean and principal components, of shape and of albedo, of registered meshes; their
    /// triangles are the first one's.
    ///
    /// # Errors
    /// See [`Process::of_samples`].
    pub fn of_meshes(meshes: &[Mesh], landmarks: Vec<Landmark>) -> Result<Self> {
        let points: Vec<&[[f32; 3]]> = meshes.iter().map(|mesh| &mesh.points[..]).collect();
        let colors: Vec<&[[f32; 3]]> = meshes.iter().map(|mesh| &mesh.colors[..]).collect();
        let provenance = format!(
            "onescan = \"{}\"\nprincipal_components_of = {}\n",
            env!("CARGO_PKG_VERSION"),
            meshes.len()
        );
        Ok(Self::new(
            Process::of_samples(&points)?,
            Process::of_samples(&colors)?,
            meshes[0].triangles.clone(),
            landmarks,
            provenance,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{assert_close, covariance, morphable, process};
    use super::*;
    use faer::Mat;
    use onescan_core::rng::Rng;
    use proptest::prelude::*;

    fn instances(process: &Process, count: usize) -> Vec<Vec<[f32; 3]>> {
        let mut rng = Rng::new(5, 0);
        (0..count)
            .map(|_| {
                let c: Vec<f64> = (0..process.rank()).map(|_| rng.normal()).collect();
                process.instance(&c).iter().map(|p| p.map(|x| x as f32)).collect()
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn its_covariance_is_the_samples(n in 2_usize..20, seed in 0_u64..1000) {
            // Fewer meshes than numbers, and more.
            let fields = instances(&process(3, 5, seed), n);
            let fields: Vec<&[[f32; 3]]> = fields.iter().map(|field| &field[..]).collect();
            let found = Process::of_samples(&fields).unwrap();
            let number = |j: usize, row: usize| f64::from(fields[j][row % 3][row / 3]);
            let mean = |row| (0..n).map(|j| number(j, row)).sum::<f64>() / n as f64;
            let expected = Mat::from_fn(9, 9, |a, b| {
                let of = |j| (number(j, a) - mean(a)) * (number(j, b) - mean(b));
                (0..n).map(of).sum::<f64>() / (n - 1) as f64
            });
            assert_close(&covariance(&found), &expected, 1e-6);
            prop_assert!(found.rank() <= (n - 1).min(9));
        }

        #[test]
        fn the_components_of_instances_span_them(seed in 0_u64..1000) {
            let known = process(10, 4, seed);
            let fields = instances(&known, 12);
            let fields: Vec<&[[f32; 3]]> = fields.iter().map(|field| &field[..]).collect();
            let found = Process::of_samples(&fields).unwrap();
            prop_assert!(found.rank() >= 4);
            for field in fields {
                let c = found.coefficients(field, 1e-9).unwrap();
                for (a, b) in field.iter().zip(found.instance(&c)) {
                    for axis in 0..3 {
                        prop_assert!((f64::from(a[axis]) - b[axis]).abs() < 1e-3);
                    }
                }
            }
        }
    }

    #[test]
    fn meshes_become_a_model_with_their_triangles() {
        let model = morphable(6, 3, 8);
        let meshes: Vec<_> =
            (0..5).map(|i| model.instance(&[f64::from(i), 1.0], &[0.2 * f64::from(i)])).collect();
        let found = Morphable::of_meshes(&meshes, model.landmarks.clone()).unwrap();
        assert_eq!(found.triangles, model.triangles);
        assert_eq!(found.landmarks, model.landmarks);
        assert!(found.to_model(i16::MAX).is_ok());
        assert!(Morphable::of_meshes(&meshes[..1], Vec::new()).is_err());
    }

    #[test]
    fn meshes_that_are_not_registered_are_named() {
        let (a, b) = (vec![[0.0; 3]; 4], vec![[0.0; 3]; 5]);
        let error = Process::of_samples(&[&a, &b]).unwrap_err().to_string();
        assert!(error.contains("mesh 1 has 5 vertices, the first 4"), "{error}");
    }
}
