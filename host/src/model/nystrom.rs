//! Models the way the paper's released program makes them: by the Nyström method.
//!
//! Where that program differs from the paper's text, so does this module; docs/decomposition.md
//! lists how. Its random numbers are Java's, so its models cannot be had to the bit.

use crate::error::{Error, Result};
use crate::model::kernel::{Kernel, Vertex, block, trace};
use crate::model::process::Process;
use faer::{Mat, MatRef, Side};
use onescan_core::rng::Rng;
use rayon::prelude::*;

/// Vertices sampled, with replacement. All these numbers are the released program's.
pub const POINTS: usize = 300;
/// Components kept.
pub const COMPONENTS: usize = 199;
/// Samples a "full" albedo is the principal components of.
pub const SAMPLES: usize = 200;
/// Relative trace at which the pivoted Cholesky factorisation stops.
const TOLERANCE: f64 = 1e-5;
/// Smallest eigenvalue kept.
const SMALLEST: f64 = 1e-8;

/// The leading components of a kernel over the vertices by the Nyström method: eigenvectors of the
/// kernel over `points` random vertices, extended to all of them.
///
/// With `K u = Λ u` over the sample, `λ = Λ/n` and `φ(x) = (√n/Λ) k(x, X) u`. The `φ` are
/// orthonormal over the sample, not over all vertices, where their squares sum to about V.
///
/// # Errors
/// When the eigenvalues do not converge.
pub fn nystrom(
    kernel: &Kernel,
    vertices: &[Vertex],
    mean: &[[f32; 3]],
    points: usize,
    components: usize,
    rng: &mut Rng,
) -> Result<Process> {
    let sample: Vec<Vertex> = (0..points)
        .map(|_| vertices[(rng.uniform() * vertices.len() as f64) as usize % vertices.len()])
        .collect();
    let terms = kernel.terms();
    let n = sample.len();
    let rows: Vec<Vec<f64>> = (0..3 * n)
        .into_par_iter()
        .map(|row| {
            let of = |y: &Vertex| block(&terms, &sample[row / 3], y)[row % 3];
            sample.iter().flat_map(of).collect()
        })
        .collect();
    let matrix = Mat::from_fn(3 * n, 3 * n, |i, j| rows[i][j]);
    let factor = pivoted_cholesky(matrix.as_ref(), TOLERANCE);
    // L Lᵀ u = Λ u by way of the smaller Lᵀ L w = Λ w, u = L w / √Λ.
    let small = factor.transpose() * &factor;
    let eigen = small
        .self_adjoint_eigen(Side::Lower)
        .map_err(|_| Error::new("the eigenvalues of the sampled kernel do not converge"))?;
    let lambda: Vec<f64> = eigen.S().column_vector().iter().rev().copied().collect();
    let n_points = n as f64;
    let rank = lambda.iter().take_while(|l| **l / n_points >= SMALLEST).count().min(components);
    let w = eigen.U().reverse_cols();
    let mut u = &factor * w.subcols(0, rank);
    for (column, l) in u.col_iter_mut().zip(&lambda) {
        // u / Λ · √n, with u = L w / √Λ.
        let scale = n_points.sqrt() / (l.sqrt() * l);
        column.iter_mut().for_each(|x| *x *= scale);
    }
    let count = vertices.len();
    let mut basis = Mat::zeros(3 * count, rank);
    let extended: Vec<Mat<f64>> = vertices
        .par_chunks(256)
        .map(|chunk| {
            let mut rows = Mat::zeros(3 * chunk.len(), 3 * n);
            for (i, x) in chunk.iter().enumerate() {
                for (j, y) in sample.iter().enumerate() {
                    let block = block(&terms, x, y);
                    for (r, row) in block.iter().enumerate() {
                        for (c, value) in row.iter().enumerate() {
                            rows[(3 * i + r, 3 * j + c)] = *value;
                        }
                    }
                }
            }
            rows * &u
        })
        .collect();
    for (chunk, values) in extended.iter().enumerate() {
        for i in 0..values.nrows() {
            let vertex = 256 * chunk + i / 3;
            for k in 0..rank {
                basis[(i % 3 * count + vertex, k)] = values[(i, k)];
            }
        }
    }
    let total_variance = vertices.iter().map(|v| trace(&block(&terms, v, v))).sum();
    let variances = lambda[..rank].iter().map(|l| l / n_points).collect();
    Ok(Process { mean: mean.to_vec(), basis, variances, noise: 0.0, total_variance })
}

/// `L` with `L Lᵀ ≈ K`: columns by the largest remaining diagonal entry, until the trace that
/// remains is `tolerance` of the first.
fn pivoted_cholesky(matrix: MatRef<'_, f64>, tolerance: f64) -> Mat<f64> {
    let n = matrix.nrows();
    let mut diagonal: Vec<f64> = (0..n).map(|i| matrix[(i, i)]).collect();
    let enough = tolerance * diagonal.iter().sum::<f64>();
    let mut columns: Vec<Vec<f64>> = Vec::new();
    while diagonal.iter().sum::<f64>() >= enough && columns.len() < n {
        let largest = (0..n).max_by(|&a, &b| diagonal[a].total_cmp(&diagonal[b])).unwrap_or(0);
        let pivot = diagonal[largest].sqrt();
        if !(pivot > 0.0) {
            break;
        }
        let mut column: Vec<f64> = matrix.col(largest).iter().copied().collect();
        for known in &columns {
            let factor = known[largest];
            for (value, entry) in column.iter_mut().zip(known) {
                *value -= entry * factor;
            }
        }
        for ((value, left), i) in column.iter_mut().zip(&mut diagonal).zip(0..) {
            *value /= pivot;
            *left = if i == largest { 0.0 } else { (*left - *value * *value).max(0.0) };
        }
        columns.push(column);
    }
    Mat::from_fn(n, columns.len(), |i, k| columns[k][i])
}

/// The deviations the released program makes of a kernel.
///
/// # Errors
/// See [`nystrom`].
pub fn released(
    kernel: &Kernel,
    vertices: &[Vertex],
    mean: &[[f32; 3]],
    rng: &mut Rng,
) -> Result<Process> {
    nystrom(kernel, vertices, mean, POINTS, COMPONENTS, rng)
}

/// The albedo the released program makes of a kernel. The mean of two kernels is not decomposed: 200 samples
/// of each are averaged in pairs, so that the covariance is `¼ (K_rgb + K_xyz)` and not ½, and the albedo is
/// the principal components of those 200, around their mean instead of the scan.
///
/// # Errors
/// See [`nystrom`].
pub fn released_albedo(
    kernel: &Kernel,
    vertices: &[Vertex],
    mean: &[[f32; 3]],
    rng: &mut Rng,
) -> Result<Process> {
    let Some([a, b]) = halves(kernel) else { return released(kernel, vertices, mean, rng) };
    let (a, b) = (released(a, vertices, mean, rng)?, released(b, vertices, mean, rng)?);
    let mut draw = |process: &Process| {
        let c: Vec<f64> = (0..process.rank()).map(|_| rng.normal()).collect();
        process.instance(&c)
    };
    let average = |(a, b): (&[f64; 3], &[f64; 3])| -> [f32; 3] {
        std::array::from_fn(|channel| (0.5 * (a[channel] + b[channel])) as f32)
    };
    let samples: Vec<Vec<[f32; 3]>> = (0..SAMPLES)
        .map(|_| {
            let (a, b) = (draw(&a), draw(&b));
            a.iter().zip(&b).map(average).collect()
        })
        .collect();
    Process::of_samples(&samples.iter().map(Vec::as_slice).collect::<Vec<_>>())
}

/// The two kernels that a kernel is the mean of.
fn halves(kernel: &Kernel) -> Option<[&Kernel; 2]> {
    let Kernel::Scaled(_, sum) = kernel else { return None };
    let Kernel::Sum(a, b) = &**sum else { return None };
    Some([a, b])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Axis;
    use crate::model::kernel::Preset;

    fn vertices() -> Vec<Vertex> {
        let position =
            |i: usize| [(i % 9) as f64 * 11.0, (i / 9) as f64 * 9.0, ((i * i) % 13) as f64];
        let color = |i: usize| [(i % 5) as f64 / 5.0, (i % 3) as f64 / 3.0, 0.5];
        (0..120).map(|i| Vertex { position: position(i), color: color(i) }).collect()
    }

    /// With every vertex in the sample nothing is approximated: the covariance is the kernel's
    /// to the tolerance of the factorisation, and the eigenvalues sum to its trace.
    #[test]
    fn nystrom_reproduces_the_kernel_where_nothing_is_truncated() {
        let vertices = vertices();
        let kernel = Preset::named("symmetric-full").unwrap().shape(Some(Axis::X));
        let mean = vec![[0.0; 3]; vertices.len()];
        let n = 400;
        let mut rng = Rng::new(1, 0);
        let process = nystrom(&kernel, &vertices, &mean, n, usize::MAX, &mut rng).unwrap();
        let terms = kernel.terms();
        // Some vertex was drawn: there the covariance is right.
        let mut rng = Rng::new(1, 0);
        let drawn = (rng.uniform() * vertices.len() as f64) as usize;
        let q = process.scaled_basis();
        let whole: f64 = trace(&block(&terms, &vertices[drawn], &vertices[drawn]));
        let held: f64 = (0..3)
            .map(|c| q.row(c * vertices.len() + drawn).iter().map(|x| x * x).sum::<f64>())
            .sum();
        assert!((held / whole - 1.0).abs() < 1e-3, "{held} of {whole}");
        let sum: f64 = process.variances.iter().sum();
        let expected = process.total_variance / vertices.len() as f64;
        assert!((sum / expected - 1.0).abs() < 0.1, "{sum} {expected}");
        // Orthonormal over the sample, which here is about all of it.
        let norm = process.basis.col(0).squared_norm_l2() / vertices.len() as f64;
        assert!((0.5..2.0).contains(&norm), "{norm}");
    }

    #[test]
    fn a_full_albedo_has_a_quarter_of_the_two_variances() {
        let vertices = vertices();
        let kernel = Preset::named("standard-full").unwrap().albedo(None);
        let mean = vec![[0.5; 3]; vertices.len()];
        let albedo = released_albedo(&kernel, &vertices, &mean, &mut Rng::new(3, 0)).unwrap();
        let per_number = albedo.total_variance / (3 * vertices.len()) as f64;
        assert!((per_number / 0.01375 - 1.0).abs() < 0.15, "{per_number}");
        assert!(albedo.rank() <= 199);
    }
}
