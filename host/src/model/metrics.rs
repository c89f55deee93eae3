//! How good a model is: compactness, generalization, specificity (Styner et al. 2003; the paper,
//! section "Specificity, Generalization, and Compactness").
//!
//! | measure | of the first M components | better |
//! |---|---|---|
//! | compactness | the variance they hold, `Σ_{i≤M} λ_i ‖u_i‖²`, per vertex | less |
//! | generalization | mean distance of test meshes to their projections into the model | less |
//! | specificity | mean distance of random instances to the nearest test mesh | less |
//!
//! The distance of two meshes is the mean over the vertices of the Euclidean distance to the same
//! vertex of the other (of two albedos: of RGB), or, for shapes, to the other's surface. Test
//! meshes are in correspondence with the model and in its place.

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::model::morphable::Morphable;
use crate::model::operate::columns;
use crate::model::operate::project::ridge;
use crate::model::process::Process;
use crate::scan::surface::Surface;
use faer::{Accum, Mat, Par, linalg::matmul::matmul};
use onescan_core::rng::Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Numbers of components looked at, and all of them: the paper's.
pub const COMPONENTS: [usize; 7] = [1, 2, 5, 10, 20, 50, 100];

/// Instances drawn together: their memory is 24 bytes per instance and vertex.
const BATCH: usize = 25;

/// How to measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Random instances for specificity, at least 2.
    pub samples: usize,
    /// How many of them are compared with surfaces as well; 0 for no distances to surfaces.
    pub surface_samples: usize,
    /// Seed of the instances. The same coefficients serve every number of components.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { samples: 1000, surface_samples: 0, seed: 7 }
    }
}

/// A mean with its standard error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Standard deviation over the square root of the number averaged; 0 of a single one.
    pub standard_error: f64,
}

impl Estimate {
    /// Of some numbers, at least one.
    pub fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
        Self { mean, standard_error: (squares / (n - 1.0).max(1.0) / n).sqrt() }
    }
}

/// What a number of components achieves, in millimetres (compactness: mm²) or RGB units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Number of components; 0 is the mean alone.
    pub components: usize,
    /// Variance that they hold, per vertex.
    pub compactness: f64,
    /// Over the test meshes.
    pub generalization: Estimate,
    /// Over the instances.
    pub specificity: Estimate,
    /// The same to the test meshes' surfaces, if asked for; shape only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_generalization: Option<Estimate>,
    /// The same of an instance's vertices to the test meshes' surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_specificity: Option<Estimate>,
}

/// The measures of a model by number of components.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Of the shape.
    pub shape: Vec<Point>,
    /// Of the albedo.
    pub albedo: Vec<Point>,
}

/// A model, or an average of models, by number of components.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    /// What the plots call it.
    pub name: String,
    /// What it is.
    pub about: String,
    /// Its measures; of an average, standard errors are over the models.
    pub metrics: Metrics,
}

/// Meshes to measure with, and their surfaces.
pub struct TestSet<'a> {
    meshes: Vec<&'a Mesh>,
    surfaces: Vec<&'a Surface>,
}

impl<'a> TestSet<'a> {
    /// Meshes in correspondence with the models; surfaces of all of them, or none if distances to
    /// surfaces are not wanted.
    pub fn new(meshes: Vec<&'a Mesh>, surfaces: Vec<&'a Surface>) -> Self {
        Self { meshes, surfaces }
    }
}

/// Measures a model.
///
/// # Errors
/// Without test meshes, or with one of another number of vertices (by its number).
pub fn measure(model: &Morphable, test: &TestSet<'_>, options: &Options) -> Result<Metrics> {
    let vertices = model.shape.vertices();
    if test.meshes.is_empty() {
        return Err(Error::new("there are no meshes to measure with"));
    }
    if let Some(odd) = test.meshes.iter().position(|mesh| mesh.points.len() != vertices) {
        return Err(Error::new(format_args!(
            "mesh {odd} has {} vertices, the model {vertices}; give meshes of its topology",
            test.meshes[odd].points.len()
        )));
    }
    let points: Vec<&[[f32; 3]]> = test.meshes.iter().map(|mesh| &mesh.points[..]).collect();
    let colors: Vec<&[[f32; 3]]> = test.meshes.iter().map(|mesh| &mesh.colors[..]).collect();
    let surfaces = if options.surface_samples > 0 { &test.surfaces[..] } else { &[] };
    Ok(Metrics {
        shape: half(&model.shape, &points, surfaces, options)?,
        albedo: half(&model.albedo, &colors, &[], options)?,
    })
}

/// 0, the [`COMPONENTS`] below the rank, and the rank.
pub fn numbers(rank: usize) -> Vec<usize> {
    let mut numbers: Vec<usize> =
        std::iter::once(0).chain(COMPONENTS).filter(|&m| m < rank).collect();
    numbers.push(rank);
    numbers
}

fn half(
    process: &Process,
    fields: &[&[[f32; 3]]],
    surfaces: &[&Surface],
    options: &Options,
) -> Result<Vec<Point>> {
    let numbers = numbers(process.rank());
    let q = process.scaled_basis();
    let mean = columns(process.vertices(), &[&process.mean]);
    let targets = columns(process.vertices(), fields);
    let general = generalization(process, &q, &mean, &targets, surfaces, &numbers)?;
    let specific = specificity(&q, &mean, &targets, surfaces, &numbers, options);
    let mut held = 0.0;
    let mut from = 0;
    Ok(numbers
        .iter()
        .zip(general.into_iter().zip(specific))
        .map(|(&m, (general, specific))| {
            let sum = q.subcols(from, m - from).squared_norm_l2();
            (held, from) = (held + sum, m);
            Point {
                components: m,
                compactness: held / process.vertices() as f64,
                generalization: general.0,
                specificity: specific.0,
                surface_generalization: general.1,
                surface_specificity: specific.1,
            }
        })
        .collect())
}

/// Per number of components: by correspondence, and to surfaces.
type Pair = (Estimate, Option<Estimate>);

/// The projection (see [`mod@crate::model::operate::project`]) into M components needs the leading M × M
/// part of `QᵀQ` and the first M rows of `Qᵀ(s − m)`.
fn generalization(
    process: &Process,
    q: &Mat<f64>,
    mean: &Mat<f64>,
    targets: &Mat<f64>,
    surfaces: &[&Surface],
    numbers: &[usize],
) -> Result<Vec<Pair>> {
    let mut deviation = targets.clone();
    for column in deviation.col_iter_mut() {
        for (x, mean) in column.iter_mut().zip(mean.col(0).iter()) {
            *x -= mean;
        }
    }
    let g = q.transpose() * q;
    let b = q.transpose() * &deviation;
    numbers
        .iter()
        .map(|&m| {
            let c = ridge(g.submatrix(0, 0, m, m), b.subrows(0, m), process.usual_noise())?;
            let mut found = q.subcols(0, m) * c;
            for column in found.col_iter_mut() {
                for (x, mean) in column.iter_mut().zip(mean.col(0).iter()) {
                    *x += mean;
                }
            }
            let near: Vec<f64> =
                (0..targets.ncols()).map(|j| distance(&found, j, targets, j)).collect();
            let to_surfaces: Vec<f64> = surfaces
                .par_iter()
                .enumerate()
                .map(|(j, surface)| surface_distance(&found, j, targets, j, surface))
                .collect();
            let surface = (!surfaces.is_empty()).then(|| Estimate::of(&to_surfaces));
            Ok((Estimate::of(&near), surface))
        })
        .collect()
}

fn specificity(
    q: &Mat<f64>,
    mean: &Mat<f64>,
    targets: &Mat<f64>,
    surfaces: &[&Surface],
    numbers: &[usize],
    options: &Options,
) -> Vec<Pair> {
    let samples = options.samples.max(2);
    let mut rng = Rng::new(options.seed, 0);
    let coefficients: Vec<f64> = (0..samples * q.ncols()).map(|_| rng.normal()).collect();
    let starts: Vec<usize> = (0..samples).step_by(BATCH).collect();
    // Per batch, then per number of components: distances of its instances.
    let batches: Vec<Vec<(Vec<f64>, Vec<f64>)>> = starts
        .par_iter()
        .map(|&start| {
            let count = BATCH.min(samples - start);
            let c =
                Mat::from_fn(q.ncols(), count, |k, j| coefficients[(start + j) * q.ncols() + k]);
            let mut fields = Mat::from_fn(q.nrows(), count, |row, _| mean[(row, 0)]);
            let mut from = 0;
            numbers
                .iter()
                .map(|&m| {
                    let more = m - from;
                    let (q, c) = (q.subcols(from, more), c.subrows(from, more));
                    matmul(&mut fields, Accum::Add, q, c, 1.0, Par::Seq);
                    from = m;
                    let least = |values: &mut dyn Iterator<Item = f64>| {
                        values.fold(f64::INFINITY, f64::min)
                    };
                    let near = (0..count)
                        .map(|j| {
                            least(
                                &mut (0..targets.ncols()).map(|t| distance(&fields, j, targets, t)),
                            )
                        })
                        .collect();
                    let to_surfaces = (0..count)
                        .filter(|j| !surfaces.is_empty() && start + j < options.surface_samples)
                        .map(|j| {
                            least(&mut surfaces.iter().enumerate().map(|(t, surface)| {
                                surface_distance(&fields, j, targets, t, surface)
                            }))
                        })
                        .collect();
                    (near, to_surfaces)
                })
                .collect()
        })
        .collect();
    (0..numbers.len())
        .map(|i| {
            let near: Vec<f64> = batches.iter().flat_map(|b| b[i].0.iter().copied()).collect();
            let far: Vec<f64> = batches.iter().flat_map(|b| b[i].1.iter().copied()).collect();
            (Estimate::of(&near), (!far.is_empty()).then(|| Estimate::of(&far)))
        })
        .collect()
}

/// Mean distance of corresponding vertices of column `i` of `a` and column `j` of `b`.
fn distance(a: &Mat<f64>, i: usize, b: &Mat<f64>, j: usize) -> f64 {
    let vertices = a.nrows() / 3;
    let (Some(a), Some(b)) = (a.col(i).try_as_col_major(), b.col(j).try_as_col_major()) else {
        return f64::NAN; // `Mat` is column-major.
    };
    let ([ax, ay, az], [bx, by, bz]) = (planes(a.as_slice()), planes(b.as_slice()));
    let mut sum = 0.0;
    for v in 0..vertices {
        let (x, y, z) = (ax[v] - bx[v], ay[v] - by[v], az[v] - bz[v]);
        sum += (x * x + y * y + z * z).sqrt();
    }
    sum / vertices as f64
}

fn planes(field: &[f64]) -> [&[f64]; 3] {
    let vertices = field.len() / 3;
    [0, 1, 2].map(|k| &field[k * vertices..(k + 1) * vertices])
}

/// Mean distance of the vertices of column `i` of `a` to the surface of column `j` of `b`.
fn surface_distance(a: &Mat<f64>, i: usize, b: &Mat<f64>, j: usize, surface: &Surface) -> f64 {
    let vertices = a.nrows() / 3;
    let sum: f64 = (0..vertices)
        .map(|v| {
            let at = |m: &Mat<f64>, column| [0, 1, 2].map(|k| m[(k * vertices + v, column)]);
            let (p, same) = (at(a, i), at(b, j));
            // The same vertex is on the surface, so the nearest point is not farther.
            let bound: f64 = (0..3).map(|k| (p[k] - same[k]).powi(2)).sum();
            surface.nearest_within(p, bound).map_or(bound, |found| found.squared).sqrt()
        })
        .sum();
    sum / vertices as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::operate::tests::morphable;

    fn measured(model: &Morphable, meshes: &[Mesh], options: &Options) -> Metrics {
        let surfaces: Vec<Surface> = meshes.iter().map(Surface::new).collect();
        let test = TestSet::new(meshes.iter().collect(), surfaces.iter().collect());
        measure(model, &test, options).unwrap()
    }

    fn instances(model: &Morphable, count: u32) -> Vec<Mesh> {
        (0..count)
            .map(|i| {
                let c: Vec<f64> = (0..4).map(|k| (f64::from(3 * i + k) * 1.3).sin()).collect();
                model.instance(&c, &[])
            })
            .collect()
    }

    #[test]
    fn a_model_generalizes_to_its_own_instances_and_its_parts_less() {
        let model = morphable(12, 4, 3);
        let metrics = measured(&model, &instances(&model, 6), &Options::default());
        let errors: Vec<f64> = metrics.shape.iter().map(|p| p.generalization.mean).collect();
        let numbers: Vec<usize> = metrics.shape.iter().map(|p| p.components).collect();
        assert_eq!(numbers, [0, 1, 2, 4]);
        assert!(errors.windows(2).all(|pair| pair[1] < pair[0]), "{errors:?}");
        assert!(errors[3] < 1e-3, "{errors:?}");
    }

    #[test]
    fn more_components_hold_more_variance_and_are_less_specific() {
        let model = morphable(12, 4, 3);
        let mean = [model.mean()];
        let options = Options { surface_samples: 50, ..Options::default() };
        let metrics = measured(&model, &mean, &options);
        let first = &metrics.shape[0];
        assert_eq!((first.compactness, first.specificity.mean), (0.0, 0.0));
        for pair in metrics.shape.windows(2) {
            assert!(pair[1].compactness > pair[0].compactness);
            assert!(pair[1].specificity.mean > pair[0].specificity.mean);
        }
        let last = metrics.shape.last().unwrap();
        assert!((last.compactness - model.shape.held() / 12.0).abs() < 1e-9);
        // Vertices are never nearer than the surface they are on.
        assert!(last.surface_specificity.unwrap().mean < last.specificity.mean);
        assert_eq!(metrics.albedo[0].surface_specificity, None);
    }

    #[test]
    fn an_isotropic_model_has_the_specificity_of_the_maxwell_distribution() {
        // One vertex, three components of variance 1: the mean length is √(8/π).
        let mut model = morphable(3, 3, 1);
        model.shape.mean = vec![[0.0; 3]; 3];
        model.shape.basis = Mat::from_fn(9, 3, |row, k| f64::from(u8::from(row / 3 == k)));
        model.shape.variances = vec![1.0; 3];
        let options = Options { samples: 20_000, ..Options::default() };
        let metrics = measured(&model, &[model.mean()], &options);
        let found = metrics.shape.last().unwrap().specificity;
        let expected = (8.0 / std::f64::consts::PI).sqrt();
        assert!((found.mean - expected).abs() < 3.0 * found.standard_error, "{found:?}");
    }

    #[test]
    fn the_standard_error_is_that_of_the_mean() {
        let estimate = Estimate::of(&[1.0, 3.0, 5.0, 7.0]);
        assert_eq!(estimate.mean, 4.0);
        assert!((estimate.standard_error - (20.0_f64 / 3.0 / 4.0).sqrt()).abs() < 1e-12);
        assert_eq!(Estimate::of(&[2.0]).standard_error, 0.0);
    }

    #[test]
    fn other_topologies_are_refused_by_number() {
        let (model, other) = (morphable(6, 2, 1), morphable(5, 2, 1));
        let (a, b) = (model.mean(), other.mean());
        let test = TestSet::new(vec![&a, &b], Vec::new());
        let error = measure(&model, &test, &Options::default()).unwrap_err().to_string();
        assert!(error.starts_with("mesh 1 has 5 vertices, the model 6"), "{error}");
        let none = TestSet::new(Vec::new(), Vec::new());
        assert!(measure(&model, &none, &Options::default()).is_err());
    }
}
