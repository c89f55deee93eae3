//! From one coloured scan to a morphable model.

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::landmarks::Landmark;
use crate::model::decompose::{Decomposition, Progress, Truncation, decompose};
use crate::model::kept;
pub use crate::model::kept::forget;
use crate::model::kernel::{Kernel, Kernels, Space, Vertex};
use crate::model::layout::{self, ModelParts};
use crate::model::morphable::Morphable;
use crate::model::nystrom;
use crate::model::process::{Half, Process};
use crate::model_file::OwnedModel;
use onescan_core::rng::Rng;
use std::fmt;
use std::path::Path;
use std::time::Instant;

/// Seed of [`Method::Released`], the released program's.
const SEED: u64 = 1986;

/// How a kernel's leading components are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Exactly, over all vertices.
    Exact(Truncation),
    /// The way the paper's released program does it, see [`nystrom`].
    Released,
}

/// How a model is built.
#[derive(Clone)]
pub struct BuildOptions<'a> {
    /// What the model's provenance calls the scan: its file name, without directories.
    pub scan_name: &'a str,
    /// The kernels of shape and albedo.
    pub kernels: Kernels,
    /// How they are decomposed, and how far.
    pub method: Method,
    /// Length of the scan's unit: 1 for millimetres, 10 for centimetres, 1000 for metres.
    pub millimetres: f32,
}

/// A model and how its making went.
pub struct BuiltModel {
    /// The model.
    pub model: OwnedModel,
    /// Ranks, variances, residuals, times.
    pub report: BuildReport,
    shape: Computed,
    albedo: Computed,
}

/// One half of a model as it was computed.
enum Computed {
    Exact(Vec<[f32; 3]>, Decomposition),
    Sampled(Process),
}

impl Computed {
    fn half(&self) -> Half<'_> {
        match self {
            Self::Exact(mean, deviation) => Half { mean, deviation },
            Self::Sampled(process) => Half { mean: &process.mean, deviation: process },
        }
    }

    fn into_process(self) -> Process {
        match self {
            Self::Exact(mean, deviation) => deviation.around(&mean),
            Self::Sampled(process) => process,
        }
    }
}

impl BuiltModel {
    /// The model in the precision it was computed in.
    pub fn into_morphable(self) -> Morphable {
        let [shape, albedo] = [self.shape, self.albedo].map(Computed::into_process);
        Morphable::with_halves(&self.model.view(), shape, albedo)
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
    /// Largest residual `‖K u − λ u‖ / λ` among them; not known for components of a sample.
    pub max_residual: Option<f64>,
    /// Wall time.
    pub seconds: f64,
}

/// Least size of a scan, as a fraction of its kernels' least width. What is smaller moves as one, and
/// finding components that are not there takes minutes. Chosen, not measured.
const LEAST: f64 = 0.1;

/// Refuses scans that are far smaller than their kernels are wide: metres taken for millimetres.
fn check_size(points: &[[f32; 3]], kernels: &[&Kernel]) -> Result<()> {
    let terms = kernels.iter().flat_map(|kernel| kernel.terms());
    let widths = terms.filter(|term| term.space == Space::Position).map(|term| term.sigma);
    let least = widths.fold(f64::INFINITY, f64::min);
    let side = |axis: usize| {
        let along = points.iter().map(|p| f64::from(p[axis]));
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    };
    let diagonal = (0..3).map(|axis| side(axis).powi(2)).sum::<f64>().sqrt();
    if least.is_finite() && diagonal > 0.0 && diagonal < LEAST * least {
        return Err(Error::new(format_args!(
            "{diagonal:.3} mm across, but the kernels are {least} mm wide or wider; give its unit \
             (--unit m, cm, or a number of mm), or kernels of its size"
        )));
    }
    Ok(())
}

/// Builds a model whose mean is the scan and whose deviations follow the kernels.
///
/// # Errors
/// Those of [`decompose`] and [`nystrom`]; a unit that is not positive and finite or makes
/// coordinates overflow; a scan far smaller than its kernels are wide; a basis too large for a file.
pub fn build(
    scan: &Mesh,
    landmarks: &[Landmark],
    options: &BuildOptions<'_>,
    progress: &mut Progress<'_>,
) -> Result<BuiltModel> {
    build_kept(scan, landmarks, options, None, progress)
}

/// [`build`], which keeps the shape in a file if that took long, and takes it from there if it is of the
/// same vertices, kernel and settings: one that was stopped later goes on from there, with the same bits.
/// Who has written the model removes the file by [`forget`].
///
/// # Errors
/// Those of [`build`].
pub fn build_kept(
    scan: &Mesh,
    landmarks: &[Landmark],
    options: &BuildOptions<'_>,
    kept: Option<&Path>,
    progress: &mut Progress<'_>,
) -> Result<BuiltModel> {
    let points: Vec<[f32; 3]> =
        scan.points.iter().map(|p| p.map(|c| c * options.millimetres)).collect();
    if !(options.millimetres > 0.0 && points.as_flattened().iter().all(|c| c.is_finite())) {
        return Err(Error::new(format_args!(
            "a unit of {} mm does not suit this scan; give mm, cm or m",
            options.millimetres
        )));
    }
    let vertices = Vertex::all(&points, &scan.colors);
    let Kernels { shape, albedo, .. } = &options.kernels;
    check_size(&points, &[shape, albedo])?;
    let rank = match options.method {
        // There are no more than three to a vertex.
        Method::Exact(Truncation::Rank(rank)) => rank.min(3 * points.len()),
        _ => 0,
    };
    layout::check_size(points.len(), scan.triangles.len(), rank)?;
    let (shape, albedo) = match options.method {
        Method::Exact(truncation) => {
            let mut half = |name: &str, kernel: &Kernel, mean: &[[f32; 3]], from: f64, kept| {
                exact((kernel, mean), &vertices, truncation, kept, &mut |done, what| {
                    progress(from + 0.5 * done, &format!("{name} {what}"));
                })
                .map_err(|e| Error::new(format_args!("{name}: {e}")))
            };
            (
                half("shape", shape, &points, 0.0, kept)?,
                half("albedo", albedo, &scan.colors, 0.5, None)?,
            )
        }
        Method::Released => {
            let mut rng = Rng::new(SEED, 0);
            progress(0.0, "shape by Nyström");
            let shape = sampled(shape, || nystrom::released(shape, &vertices, &points, &mut rng))?;
            progress(0.5, "albedo by Nyström");
            let albedo = sampled(albedo, || {
                nystrom::released_albedo(albedo, &vertices, &scan.colors, &mut rng)
            })?;
            (shape, albedo)
        }
    };
    let ((shape, shape_report), (albedo, albedo_report)) = (shape, albedo);

    let start = Instant::now();
    let parts = ModelParts {
        occlusion: None,
        shape: shape.half(),
        albedo: albedo.half(),
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
    Ok(BuiltModel { model, report, shape, albedo })
}

fn exact(
    (kernel, mean): (&Kernel, &[[f32; 3]]),
    vertices: &[Vertex],
    truncation: Truncation,
    kept: Option<&Path>,
    progress: &mut Progress<'_>,
) -> Result<(Computed, HalfReport)> {
    let start = Instant::now();
    let kept = kept.map(|path| (path, kept::identity(kernel, vertices, truncation)));
    let known = kept.and_then(|(path, of)| kept::read(path, of, vertices.len()));
    let deviation = known.map_or_else(|| decompose(kernel, vertices, truncation, progress), Ok)?;
    if let Some((path, of)) = kept.filter(|_| start.elapsed() > kept::WORTH) {
        // A model that cannot be gone on with is worth more than none.
        let _ = kept::write(path, of, &deviation);
    }
    let report = HalfReport {
        kernel: kernel.to_string(),
        rank: deviation.rank(),
        captured: deviation.captured(),
        max_residual: Some(deviation.max_residual),
        seconds: start.elapsed().as_secs_f64(),
    };
    Ok((Computed::Exact(mean.to_vec(), deviation), report))
}

fn sampled(
    kernel: &Kernel,
    make: impl FnOnce() -> Result<Process>,
) -> Result<(Computed, HalfReport)> {
    let start = Instant::now();
    // A model file's variances are those of all vertices together, not of one.
    let process = make()?.with_unit_columns();
    let report = HalfReport {
        kernel: format!("nystrom {kernel}"),
        rank: process.rank(),
        captured: process.captured(),
        max_residual: None,
        seconds: start.elapsed().as_secs_f64(),
    };
    Ok((Computed::Sampled(process), report))
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
