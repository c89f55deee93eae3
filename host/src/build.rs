//! From one coloured scan to a morphable model.

use crate::decompose::{Decomposition, Progress, Truncation, decompose};
use crate::error::{Error, Result};
use crate::kernel::{Kernel, Kernels, Vertex};
use crate::landmarks::Landmark;
use crate::mesh::Mesh;
use crate::model_file::{Half, ModelParts, OwnedModel};
use crate::morphable::{Morphable, Process};
use crate::reference;
use std::fmt;
use std::time::Instant;

/// Seed of [`build_reference`], the released program's.
const SEED: u64 = 1986;

/// How a model is built.
#[derive(Clone)]
pub struct BuildOptions<'a> {
    /// What the model's provenance calls the scan: its file name, without directories.
    pub scan_name: &'a str,
    /// The kernels of shape and albedo.
    pub kernels: Kernels,
    /// Components of shape and of albedo.
    pub truncation: Truncation,
    /// Length of the scan's unit: 1 for millimetres, 10 for centimetres, 1000 for metres.
    pub millimetres: f32,
}

/// A model and how its making went.
pub struct BuiltModel {
    /// The model.
    pub model: OwnedModel,
    /// Ranks, variances, certificates, times.
    pub report: BuildReport,
    shape: Computed,
    albedo: Computed,
}

/// One half of a model as it was computed.
enum Computed {
    Exact(Decomposition),
    Sampled(Process),
}

impl Computed {
    fn around(&self, mean: &[[f32; 3]]) -> Process {
        match self {
            Self::Exact(deviation) => Process::around(mean, deviation),
            Self::Sampled(process) => process.clone(),
        }
    }
}

impl BuiltModel {
    /// The model in the precision it was computed in.
    pub fn morphable(&self) -> Morphable {
        let file = Morphable::of(&self.model.view());
        Morphable {
            shape: self.shape.around(&file.shape.mean),
            albedo: self.albedo.around(&file.albedo.mean),
            ..file
        }
    }
}

/// How a build went; displays as a few lines for a person.
#[derive(Clone, Debug, PartialEq)]
pub struct BuildReport {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Shape.
    pub shape: HalfReport,
    /// Albedo.
    pub albedo: HalfReport,
    /// Seconds to lay out the file.
    pub layout_seconds: f64,
}

/// How the decomposition of one kernel went.
#[derive(Clone, Debug, PartialEq)]
pub struct HalfReport {
    /// The kernel, as algebra.
    pub kernel: String,
    /// Components kept.
    pub rank: usize,
    /// Fraction of the variance they hold.
    pub captured: f64,
    /// Largest residual `‖K u − λ u‖ / λ` among them; of components of a sample it is not known.
    pub max_residual: Option<f64>,
    /// Wall time.
    pub seconds: f64,
}

/// Builds a model whose mean is the scan and whose deviations follow the kernels.
///
/// # Errors
/// Those of [`decompose`]; a unit that is not positive and finite or makes coordinates overflow;
/// a basis too large for a file.
pub fn build(
    scan: &Mesh,
    landmarks: &[Landmark],
    options: &BuildOptions<'_>,
    progress: &mut Progress<'_>,
) -> Result<BuiltModel> {
    let (points, vertices) = vertices(scan, options)?;
    let mut half = |name: &str, kernel: &Kernel, from: f64| {
        let start = Instant::now();
        let deviation = decompose(kernel, &vertices, options.truncation, &mut |done, what| {
            progress(from + 0.5 * done, &format!("{name} {what}"));
        })
        .map_err(|e| Error::new(format_args!("{name}: {e}")))?;
        let report = HalfReport {
            kernel: kernel.to_string(),
            rank: deviation.rank(),
            captured: deviation.captured(),
            max_residual: Some(deviation.max_residual),
            seconds: start.elapsed().as_secs_f64(),
        };
        Ok::<(Decomposition, HalfReport), Error>((deviation, report))
    };
    let (shape, shape_report) = half("shape", &options.kernels.shape, 0.0)?;
    let (albedo, albedo_report) = half("albedo", &options.kernels.albedo, 0.5)?;

    let halves = [
        Half { mean: &points, deviation: &shape },
        Half { mean: &scan.colors, deviation: &albedo },
    ];
    let (model, report) = lay_out(scan, landmarks, options, halves, [shape_report, albedo_report])?;
    let [shape, albedo] = [shape, albedo].map(Computed::Exact);
    Ok(BuiltModel { model, report, shape, albedo })
}

/// Builds a model the way the paper's released program does, see [`mod@reference`]. Of the options
/// the truncation is ignored.
///
/// # Errors
/// Those of [`reference::reference`] and [`build`].
pub fn build_reference(
    scan: &Mesh,
    landmarks: &[Landmark],
    options: &BuildOptions<'_>,
    progress: &mut Progress<'_>,
) -> Result<BuiltModel> {
    let (points, vertices) = vertices(scan, options)?;
    let start = Instant::now();
    let halves =
        reference::reference(&options.kernels, &vertices, [&points, &scan.colors], SEED, progress)?;
    // A model file's variances are those of all vertices together, not of one.
    let halves = halves.map(|process| process.with_unit_columns());
    let seconds = start.elapsed().as_secs_f64();
    let [shape, albedo] = &halves;
    let report = |kernel: &Kernel, process: &Process| HalfReport {
        kernel: format!("nystrom {kernel}"),
        rank: process.rank(),
        captured: process.captured(),
        max_residual: None,
        seconds: 0.5 * seconds,
    };
    let reports = [report(&options.kernels.shape, shape), report(&options.kernels.albedo, albedo)];
    let deviations = [shape.deviation(), albedo.deviation()];
    let halves = [
        Half { mean: &shape.mean, deviation: &deviations[0] },
        Half { mean: &albedo.mean, deviation: &deviations[1] },
    ];
    let (model, report) = lay_out(scan, landmarks, options, halves, reports)?;
    drop(deviations);
    let [shape, albedo] = [shape, albedo].map(|process| Computed::Sampled(process.clone()));
    Ok(BuiltModel { model, report, shape, albedo })
}

/// The scan's points in millimetres, and what kernels are evaluated on.
fn vertices(scan: &Mesh, options: &BuildOptions<'_>) -> Result<(Vec<[f32; 3]>, Vec<Vertex>)> {
    let points: Vec<[f32; 3]> =
        scan.points.iter().map(|p| p.map(|c| c * options.millimetres)).collect();
    if !(options.millimetres > 0.0 && points.as_flattened().iter().all(|c| c.is_finite())) {
        return Err(Error::new(format_args!(
            "a unit of {} mm does not suit this scan; give mm, cm or m",
            options.millimetres
        )));
    }
    let vertices = points
        .iter()
        .zip(&scan.colors)
        .map(|(p, c)| Vertex { position: p.map(f64::from), color: c.map(f64::from) })
        .collect();
    Ok((points, vertices))
}

/// The model file, and how its making went.
fn lay_out(
    scan: &Mesh,
    landmarks: &[Landmark],
    options: &BuildOptions<'_>,
    [shape, albedo]: [Half<'_>; 2],
    [shape_report, albedo_report]: [HalfReport; 2],
) -> Result<(OwnedModel, BuildReport)> {
    let start = Instant::now();
    let parts = ModelParts {
        shape,
        albedo,
        triangles: &scan.triangles,
        landmarks,
        provenance: &provenance(options, &shape_report, &albedo_report),
        levels: i16::MAX,
    };
    let model = OwnedModel::from_bytes(&parts.to_bytes()?)?;
    let report = BuildReport {
        vertices: scan.points.len(),
        triangles: scan.triangles.len(),
        shape: shape_report,
        albedo: albedo_report,
        layout_seconds: start.elapsed().as_secs_f64(),
    };
    Ok((model, report))
}

/// Where the model comes from, as TOML. Nothing of the machine it was made on, nor times: equal
/// inputs give equal files.
fn provenance(options: &BuildOptions<'_>, shape: &HalfReport, albedo: &HalfReport) -> String {
    format!(
        "onescan = \"{}\"\nscan = {:?}\nmillimetres_per_unit = {}\nkernels = {:?}\n\
         shape_kernel = \"{}\"\nshape_rank = {}\nshape_captured = {:.4}\n\
         albedo_kernel = \"{}\"\nalbedo_rank = {}\nalbedo_captured = {:.4}\n",
        env!("CARGO_PKG_VERSION"),
        options.scan_name,
        options.millimetres,
        options.kernels.name,
        shape.kernel,
        shape.rank,
        shape.captured,
        albedo.kernel,
        albedo.rank,
        albedo.captured,
    )
}

impl fmt::Display for BuildReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} vertices, {} triangles", self.vertices, self.triangles)?;
        writeln!(f, "shape:  {}", self.shape)?;
        write!(f, "albedo: {}", self.albedo)
    }
}

impl fmt::Display for HalfReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} components hold {:.2} % of the variance (",
            self.rank,
            100.0 * self.captured
        )?;
        match self.max_residual {
            Some(residual) => write!(f, "residual {residual:.0e}")?,
            None => f.write_str("from a sample of the vertices")?,
        }
        write!(f, ", {:.1} s)", self.seconds)
    }
}
