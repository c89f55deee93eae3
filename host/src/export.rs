//! Smaller models of the same thing: fewer components, fewer vertices, fewer bits.

use crate::decimate::decimate;
use crate::error::{Error, Result};
use crate::landmarks::Landmark;
use crate::mesh::Mesh;
use crate::model_file::{Deviation, Half, ModelParts, OwnedModel};
use faer::{Mat, Side};
use onescan_core::basis::{Basis, padded};
use std::fmt;

/// What to leave.
#[derive(Clone, Copy, Debug)]
pub struct ExportOptions {
    /// Shape components, if there are more.
    pub shape_rank: usize,
    /// Albedo components, if there are more.
    pub albedo_rank: usize,
    /// Vertices, if there are more; `None` leaves the mesh alone.
    pub vertices: Option<usize>,
    /// Bits of an entry of the basis, 2 to 16. They take 16 in the file whatever the number, but
    /// fewer compress better.
    pub bits: u32,
}

/// What an export left, and what it cost.
pub struct Exported {
    /// The model.
    pub model: OwnedModel,
    /// The figures.
    pub report: ExportReport,
}

/// Figures of an export.
#[derive(Clone, Debug)]
pub struct ExportReport {
    /// Vertices before and after.
    pub vertices: [usize; 2],
    /// Triangles before and after.
    pub triangles: [usize; 2],
    /// Size of the file.
    pub bytes: usize,
    /// Shape and albedo.
    pub halves: [HalfReport; 2],
}

/// Figures of one half.
#[derive(Clone, Debug)]
pub struct HalfReport {
    /// Components before and after.
    pub rank: [usize; 2],
    /// Fraction of the variance that they hold, before and after.
    pub captured: [f64; 2],
    /// Root mean square error of an entry by its bits, relative to the standard deviation of the
    /// field.
    pub rounding: f64,
}

/// Makes a smaller model.
///
/// Of a decimated mesh the covariance of the remaining vertices is taken as it is (the marginal of
/// the Gaussian process) and decomposed anew. What of the total variance the model never held is
/// assumed to be spread over the vertices like what it holds.
///
/// # Errors
/// When the mesh cannot be decimated so far, or the smaller covariance resists decomposition.
pub fn export(model: &OwnedModel, options: &ExportOptions) -> Result<Exported> {
    let view = model.view();
    let mean = |basis: &Basis<'_>, v: u32| {
        let plane = padded(view.vertices());
        [0, 1, 2].map(|channel| basis.mean()[channel * plane + v as usize])
    };
    let all = 0..view.vertices() as u32;
    let mut triangles: Vec<[u32; 3]> =
        (0..view.triangles.len()).filter_map(|t| view.triangles.get(t)).collect();
    let triangles_before = triangles.len();
    let mut kept: Vec<u32> = all.clone().collect();
    if let Some(target) = options.vertices.filter(|&target| target < kept.len()) {
        let mesh = Mesh {
            points: all.clone().map(|v| mean(&view.shape, v)).collect(),
            colors: all.clone().map(|v| mean(&view.albedo, v)).collect(),
            triangles,
        };
        let landmarks: Vec<u32> = view.landmarks().map(|(_, v)| v).collect();
        triangles = decimate(&mesh, &landmarks, target);
        kept = triangles.as_flattened().iter().copied().chain(landmarks).collect();
        kept.sort_unstable();
        kept.dedup();
        if kept.len() > target {
            return Err(Error::new(format_args!(
                "the mesh cannot be brought below {} vertices without losing its landmarks or \
                 folding; ask for more",
                kept.len()
            )));
        }
    }
    let renumbered = |v: u32| kept.partition_point(|&other| other < v) as u32;
    let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(renumbered)).collect();
    let landmarks: Vec<Landmark> = view
        .landmarks()
        .map(|(name, v)| Landmark { name: name.to_string(), vertex: renumbered(v) })
        .collect();

    let decimated = kept.len() < view.vertices();
    let halves = [
        Reduced::new(&view.shape, &kept, options.shape_rank, decimated)?,
        Reduced::new(&view.albedo, &kept, options.albedo_rank, decimated)?,
    ];
    let means = [&view.shape, &view.albedo]
        .map(|basis| kept.iter().map(|&v| mean(basis, v)).collect::<Vec<_>>());
    let bits = options.bits.clamp(2, 16);
    let levels = i16::MAX >> (16 - bits);
    // What an earlier export said no longer holds.
    let origin: String = view
        .provenance()
        .lines()
        .filter(|line| !line.starts_with("exported_"))
        .map(|line| line.to_string() + "\n")
        .collect();
    let provenance = format!(
        "{origin}exported_vertices = {}\nexported_shape_rank = {}\nexported_albedo_rank = {}\n\
         exported_bits = {bits}\n",
        kept.len(),
        halves[0].variances.len(),
        halves[1].variances.len(),
    );
    let parts = ModelParts {
        shape: Half { mean: &means[0], deviation: &halves[0] },
        albedo: Half { mean: &means[1], deviation: &halves[1] },
        triangles: &triangles,
        landmarks: &landmarks,
        provenance: &provenance,
        levels,
    };
    let exported = OwnedModel::from_bytes(&parts.to_bytes()?)?;
    let report = ExportReport {
        vertices: [view.vertices(), kept.len()],
        triangles: [triangles_before, triangles.len()],
        bytes: exported.bytes().len(),
        halves: [0, 1].map(|i| {
            let (before, after) = ([&view.shape, &view.albedo][i], &halves[i]);
            let held: f64 = before.variance().iter().map(|&v| f64::from(v)).sum();
            HalfReport {
                rank: [before.rank(), after.variances.len()],
                captured: [
                    fraction(held, before.total_variance()),
                    fraction(after.variances.iter().sum(), after.total_variance),
                ],
                rounding: after.rounding(levels),
            }
        }),
    };
    Ok(Exported { model: exported, report })
}

fn fraction(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 1.0 }
}

/// Components over the vertices that are left.
struct Reduced {
    variances: Vec<f64>,
    total_variance: f64,
    /// Per component and channel.
    columns: Vec<[Vec<f64>; 3]>,
}

impl Reduced {
    fn new(basis: &Basis<'_>, kept: &[u32], rank: usize, decimated: bool) -> Result<Self> {
        let plane = basis.mean().len() / 3;
        let rank = rank.min(basis.rank());
        let entry = |k: usize, channel: usize, v: u32| {
            f64::from(basis.term(channel * plane + v as usize, k, 1.0))
        };
        if !decimated {
            let columns = (0..rank)
                .map(|k| [0, 1, 2].map(|c| kept.iter().map(|&v| entry(k, c, v)).collect()))
                .collect();
            let variances = basis.variance()[..rank].iter().map(|&v| f64::from(v)).collect();
            return Ok(Self { variances, total_variance: basis.total_variance(), columns });
        }
        // B Bᵀ u = λ u with B the rows that are left: from the small BᵀB w = λ w, √λ u = B w.
        let rows = Mat::from_fn(3 * kept.len(), basis.rank(), |i, k| {
            entry(k, i / kept.len(), kept[i % kept.len()])
        });
        let gram = rows.transpose() * &rows;
        let eigen = gram.self_adjoint_eigen(Side::Lower).map_err(|_| {
            Error::new("the eigenvalues of the smaller model do not converge; keep more vertices")
        })?;
        // Ascending; the leading components are wanted first.
        let order: Vec<f64> = eigen.S().column_vector().iter().rev().copied().collect();
        let vectors = eigen.U().reverse_cols();
        let before: f64 = basis.variance().iter().map(|&v| f64::from(v)).sum();
        let after: f64 = order.iter().sum();
        let components = &rows * vectors.subcols(0, rank);
        let columns = (0..rank)
            .map(|k| {
                let column: Vec<f64> = components.col(k).iter().copied().collect();
                let leader =
                    column.iter().fold(0.0_f64, |m, x| if x.abs() > m.abs() { *x } else { m });
                let sign = leader.signum();
                [0, 1, 2].map(|c| {
                    let channel = &column[c * kept.len()..(c + 1) * kept.len()];
                    channel.iter().map(|x| sign * x).collect()
                })
            })
            .collect();
        Ok(Self {
            variances: order.into_iter().take(rank).map(|v| v.max(0.0)).collect(),
            total_variance: basis.total_variance() * fraction(after, before),
            columns,
        })
    }

    /// Root mean square error of an entry when each component has so many levels, relative to the
    /// field's standard deviation.
    fn rounding(&self, levels: i16) -> f64 {
        let entries = self.columns.first().map_or(0, |column| 3 * column[0].len());
        let error: f64 = self
            .columns
            .iter()
            .map(|column| {
                let largest = column.iter().flatten().fold(0.0_f64, |max, x| max.max(x.abs()));
                (largest / f64::from(levels)).powi(2) / 12.0
            })
            .sum();
        (fraction(error * entries as f64, self.total_variance)).sqrt()
    }
}

impl Deviation for Reduced {
    fn variances(&self) -> &[f64] {
        &self.variances
    }

    fn total_variance(&self) -> f64 {
        self.total_variance
    }

    fn column(&self, k: usize, channel: usize) -> (f64, &[f64]) {
        (1.0, &self.columns[k][channel])
    }
}

impl fmt::Display for ExportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([v0, v1], [t0, t1]) = (self.vertices, self.triangles);
        writeln!(f, "{v1} of {v0} vertices, {t1} of {t0} triangles, {} bytes", self.bytes)?;
        let [shape, albedo] = &self.halves;
        writeln!(f, "shape:  {shape}")?;
        write!(f, "albedo: {albedo}")
    }
}

impl fmt::Display for HalfReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([r0, r1], [c0, c1]) = (self.rank, self.captured);
        write!(
            f,
            "{r1} of {r0} components hold {:.2} % of the variance ({:.2} % before; rounding errs by \
             {:.3} % of a standard deviation)",
            100.0 * c1,
            100.0 * c0,
            100.0 * self.rounding
        )
    }
}
