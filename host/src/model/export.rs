//! Smaller models of the same thing: fewer components, fewer vertices, fewer bits.

use crate::error::{Error, Result};
use crate::mesh::landmarks::Landmark;
use crate::model::morphable::Morphable;
use crate::model::process::Process;
use crate::model_file::OwnedModel;
use crate::scan::decimate::decimate;
use std::fmt;

/// What is to be left of a model.
#[derive(Clone, Copy, Debug)]
pub struct ExportOptions {
    /// At most so many shape components.
    pub shape_rank: usize,
    /// At most so many albedo components.
    pub albedo_rank: usize,
    /// At most about so many vertices; `None` leaves the mesh alone.
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
    let whole = Morphable::of(&view);
    let mut triangles = whole.triangles.clone();
    let mut kept: Vec<u32> = (0..view.vertices() as u32).collect();
    let decimated = options.vertices.is_some_and(|target| target < kept.len());
    if let Some(target) = options.vertices.filter(|_| decimated) {
        let landmarks: Vec<u32> = whole.landmarks.iter().map(|l| l.vertex).collect();
        triangles = decimate(&whole.mean(), &landmarks, target);
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
    let reduced = |process: &Process, rank: usize| {
        if decimated {
            Ok::<_, Error>(process.marginal(&kept).orthonormal()?.truncated(rank))
        } else {
            Ok(process.truncated(rank))
        }
    };
    let (shape, albedo) =
        (reduced(&whole.shape, options.shape_rank)?, reduced(&whole.albedo, options.albedo_rank)?);
    let bits = options.bits.clamp(2, 16);
    let levels = i16::MAX >> (16 - bits);
    // What an earlier export said no longer holds.
    let origin: String = whole
        .provenance
        .lines()
        .filter(|line| !line.starts_with("exported_"))
        .map(|line| line.to_string() + "\n")
        .collect();
    let provenance = format!(
        "{origin}exported_vertices = {}\nexported_shape_rank = {}\nexported_albedo_rank = {}\n\
         exported_bits = {bits}\n",
        kept.len(),
        shape.rank(),
        albedo.rank(),
    );
    let landmark = |l: &Landmark| Landmark { name: l.name.clone(), vertex: renumbered(l.vertex) };
    let smaller = Morphable::new(
        shape,
        albedo,
        triangles.iter().map(|t| t.map(renumbered)).collect(),
        whole.landmarks.iter().map(landmark).collect(),
        provenance,
    );
    let occlusion =
        whole.occlusion.as_ref().map(|map| kept.iter().map(|&v| map[v as usize]).collect());
    let left = Morphable { occlusion, ..smaller };
    let exported = left.to_model(levels)?;
    let half = |before: &Process, after: &Process| HalfReport {
        rank: [before.rank(), after.rank()],
        captured: [before, after]
            .map(|process| fraction(process.variances.iter().sum(), process.total_variance)),
        rounding: rounding(after, levels),
    };
    let report = ExportReport {
        vertices: [view.vertices(), kept.len()],
        triangles: [whole.triangles.len(), left.triangles.len()],
        bytes: exported.bytes().len(),
        halves: [half(&whole.shape, &left.shape), half(&whole.albedo, &left.albedo)],
    };
    Ok(Exported { model: exported, report })
}

fn fraction(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 1.0 }
}

/// Root mean square error of an entry when each component has so many levels, relative to the
/// field's standard deviation.
fn rounding(process: &Process, levels: i16) -> f64 {
    let error: f64 = process
        .scaled_basis()
        .col_iter()
        .map(|column| (column.norm_max() / f64::from(levels)).powi(2) / 12.0)
        .sum();
    fraction(error * process.basis.nrows() as f64, process.total_variance).sqrt()
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
