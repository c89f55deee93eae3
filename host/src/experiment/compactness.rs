//! Compactness, generalization and specificity (paper, section of that name): models of kernels on
//! the template and on single scans, beside principal components of many people.
//!
//! | curve | model | the paper's |
//! |---|---|---|
//! | standard, correlated, symmetric | `…-full` kernels on the template | on the 2017 Basel mean |
//! | single scan | mean of ten, symmetric-full on each scan | on the ten 2009 Basel scans |
//! | 60 people | principal components of the 60 identities | the 2017 Basel model, 200 people |
//! | nine scans | principal components of nine of the ten scans, tested on the tenth | |
//! | nine scans + kernels | the same and the deviations of symmetric-full on the template | its closing claim |
//!
//! All are tested on the true surfaces of the ten scans, on the template's topology; a scan's own
//! model on the other nine. Identities and scans are different people, but drawn by one generator
//! (`fixtures/README.md`): principal components know the very distribution that is tested.

use super::faces::{identity_meshes, scan_meshes};
use super::stages::Stages;
use crate::demo;
use crate::error::{Error, Result};
use crate::json;
use crate::mesh::{Axis, Mesh};
use crate::model::decompose::{Progress, Truncation, decompose};
use crate::model::kernel::{Kernel, Preset, Vertex};
use crate::model::metrics::{Curve, Estimate, Metrics, Options, Point, TestSet, measure};
use crate::model::morphable::Morphable;
use crate::model::process::Process;
use crate::scan::surface::Surface;
use serde::Serialize;
use std::path::Path;

/// Kernels of the models on the template.
const ON_TEMPLATE: [(&str, &str); 3] = [
    ("standard", "standard-full"),
    ("correlated", "correlated-full"),
    ("symmetric", "symmetric-full"),
];

/// The result.
#[derive(Clone, Debug, Serialize)]
pub struct Compactness {
    /// Meshes measured with.
    pub test_meshes: usize,
    /// Random instances per model and number of components.
    pub samples: usize,
    /// Their seed.
    pub seed: u64,
    /// The models.
    pub curves: Vec<Curve>,
}

/// Builds and measures all models, of `rank` components each. `progress` hears the fraction done.
///
/// # Errors
/// Fixtures that cannot be read.
pub fn run(
    fixtures: &Path,
    rank: usize,
    options: &Options,
    stages: &Stages,
    progress: &mut Progress<'_>,
) -> Result<Compactness> {
    let (template, _) = demo::template()?;
    let scans = scan_meshes(fixtures)?;
    let surfaces: Vec<Surface> = scans.iter().map(Surface::new).collect();
    let without = |left_out: Option<usize>| {
        let used = || (0..scans.len()).filter(move |j| Some(*j) != left_out);
        TestSet::new(used().map(|j| &scans[j]).collect(), used().map(|j| &surfaces[j]).collect())
    };
    let total = (ON_TEMPLATE.len() + 2 * scans.len() + 1) as f64;
    let mut done = 0.0;

    let mut curves = Vec::new();
    let mut shapes: Vec<(Kernel, Process)> = Vec::new();
    for (name, kernels) in ON_TEMPLATE {
        let metrics = stages.stage(name, || {
            let mut building = |part: f64| progress((done + part) / total, name);
            // Standard and correlated models share their shape.
            let kernel = preset(kernels)?.shape(Some(Axis::X));
            let shape = match shapes.iter().find(|(known, _)| *known == kernel) {
                Some((_, shape)) => shape.clone(),
                None => deviate(&kernel, &template, &template.points, rank, &mut |part| {
                    building(0.4 * part);
                })?,
            };
            shapes.push((kernel, shape.clone()));
            let albedo = albedo(kernels, &template, rank, &mut |part| building(0.4 + 0.4 * part))?;
            measure(&morphable(&template, shape, albedo), &without(None), options)
        })?;
        let about = format!("{kernels} kernels on the template");
        curves.push(Curve { name: name.into(), about, metrics });
        done += 1.0;
    }
    drop(shapes);

    let mut singles = Vec::new();
    for (number, scan) in scans.iter().enumerate() {
        let name = format!("scan {number}");
        singles.push(stages.stage(&format!("scan-{number}"), || {
            let model = symmetric(scan, rank, &mut |part| {
                progress((done + 0.8 * part) / total, &name);
            })?;
            measure(&model, &without(Some(number)), options)
        })?);
        done += 1.0;
    }
    curves.push(Curve {
        name: "single scan".into(),
        about: format!(
            "mean over {} symmetric-full models, each on one scan and tested on the others",
            scans.len()
        ),
        metrics: average(&singles)?,
    });

    progress(done / total, "principal components");
    let identities = identity_meshes(fixtures)?;
    let people = stages.stage("people", || {
        let model = Morphable::of_meshes(&identities, Vec::new())?;
        measure(&model, &without(None), options)
    })?;
    curves.push(Curve {
        name: "60 people".into(),
        about: format!("principal components of {} registered faces", identities.len()),
        metrics: people,
    });
    done += 1.0;
    let [alone, augmented] = stages.stage("few-scans", || {
        let mut told =
            |part: f64| progress((done + part * scans.len() as f64) / total, "few scans");
        told(0.0);
        let kernels = symmetric(&template, rank, &mut |_| {})?;
        few(&scans, &surfaces, &kernels, options, &mut told)
    })?;
    let of =
        format!("principal components of {} of the scans, tested on the other", scans.len() - 1);
    curves.push(Curve { name: "nine scans".into(), about: of.clone(), metrics: alone });
    curves.push(Curve {
        name: "nine scans + kernels".into(),
        about: format!("{of}; with the symmetric-full deviations of the template"),
        metrics: augmented,
    });
    Ok(Compactness {
        test_meshes: scans.len(),
        samples: options.samples,
        seed: options.seed,
        curves,
    })
}

/// Principal components of all scans but one, tested on that, without and with the deviations of
/// `kernels`; means over the ones left out.
fn few(
    scans: &[Mesh],
    surfaces: &[Surface],
    kernels: &Morphable,
    options: &Options,
    progress: &mut dyn FnMut(f64),
) -> Result<[Metrics; 2]> {
    let (mut alone, mut augmented) = (Vec::new(), Vec::new());
    for (number, (scan, surface)) in scans.iter().zip(surfaces).enumerate() {
        progress(number as f64 / scans.len() as f64);
        let mut others = scans.to_vec();
        others.remove(number);
        let model = Morphable::of_meshes(&others, Vec::new())?;
        let test = TestSet::new(vec![scan], vec![surface]);
        alone.push(measure(&model, &test, options)?);
        augmented.push(measure(&model.augmented(kernels)?, &test, options)?);
    }
    Ok([average(&alone)?, average(&augmented)?])
}

impl Compactness {
    /// The contents of `compactness.json`.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_json(&self) -> Result<String> {
        json::to_text(self)
    }

    /// What a reader of the numbers must know.
    pub fn notes(&self) -> [String; 4] {
        [
            format!(
                "All models are tested on the true surfaces of {} scans, on the template's \
                 topology; a scan's own model on the others. Distances are between corresponding \
                 vertices, means over vertices; specificity draws {} instances per model (seed {}).",
                self.test_meshes, self.samples, self.seed
            ),
            "Bars are 95 % intervals: over test faces (generalization), over instances \
             (specificity), over the ten models (single scan). The dashed line is the template alone."
                .into(),
            "The 60 people of the principal components are not those of the ten scans, but all were \
             drawn by one generator: that model has seen the very distribution it is tested on."
                .into(),
            "Each model of nine scans is tested on the tenth, so specificity is the distance to that one \
             face, not to the nearest of ten."
                .into(),
        ]
    }
}

fn preset(name: &str) -> Result<&'static Preset> {
    Preset::named(name).ok_or_else(|| Error::new("no such kernels"))
}

/// The leading part of a kernel over a mesh, about `mean`; `progress` hears the fraction done.
fn deviate(
    kernel: &Kernel,
    mesh: &Mesh,
    mean: &[[f32; 3]],
    rank: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<Process> {
    let vertices = Vertex::all(&mesh.points, &mesh.colors);
    let deviation =
        decompose(kernel, &vertices, Truncation::Rank(rank), &mut |done, _| progress(done))?;
    Ok(deviation.around(mean))
}

/// The albedo of a mesh by kernels of a name.
fn albedo(
    kernels: &str,
    mesh: &Mesh,
    rank: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<Process> {
    deviate(&preset(kernels)?.albedo(Some(Axis::X)), mesh, &mesh.colors, rank, progress)
}

/// The symmetric-full model on a mesh.
fn symmetric(mesh: &Mesh, rank: usize, progress: &mut dyn FnMut(f64)) -> Result<Morphable> {
    const KERNELS: &str = "symmetric-full";
    let kernel = preset(KERNELS)?.shape(Some(Axis::X));
    let shape = deviate(&kernel, mesh, &mesh.points, rank, &mut |part| progress(0.5 * part))?;
    let albedo = albedo(KERNELS, mesh, rank, &mut |part| progress(0.5 + 0.5 * part))?;
    Ok(morphable(mesh, shape, albedo))
}

fn morphable(mesh: &Mesh, shape: Process, albedo: Process) -> Morphable {
    Morphable::new(shape, albedo, mesh.triangles.clone(), Vec::new(), String::new())
}

/// Means over models, point by point; standard errors are of these means.
fn average(models: &[Metrics]) -> Result<Metrics> {
    let half = |points: fn(&Metrics) -> &Vec<Point>| {
        let count = models.iter().map(|m| points(m).len()).min().unwrap_or(0);
        (0..count)
            .map(|i| {
                let at: Vec<&Point> = models.iter().map(|m| &points(m)[i]).collect();
                if at.iter().any(|p| p.components != at[0].components) {
                    return Err(Error::new(
                        "the scans' models differ in rank; ask for a lower one",
                    ));
                }
                let mean = |value: &dyn Fn(&Point) -> f64| {
                    Estimate::of(&at.iter().map(|p| value(p)).collect::<Vec<_>>())
                };
                let maybe = |value: fn(&Point) -> Option<Estimate>| {
                    value(at[0])?;
                    Some(mean(&|p| value(p).map_or(f64::NAN, |estimate| estimate.mean)))
                };
                Ok(Point {
                    components: at[0].components,
                    compactness: mean(&|p| p.compactness).mean,
                    generalization: mean(&|p| p.generalization.mean),
                    specificity: mean(&|p| p.specificity.mean),
                    surface_generalization: maybe(|p| p.surface_generalization),
                    surface_specificity: maybe(|p| p.surface_specificity),
                })
            })
            .collect::<Result<Vec<_>>>()
    };
    Ok(Metrics { shape: half(|m| &m.shape)?, albedo: half(|m| &m.albedo)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_average_is_point_by_point() {
        let metrics = |x: f64| {
            let estimate = Estimate { mean: x, standard_error: 9.0 };
            let point = Point {
                components: 1,
                compactness: x,
                generalization: estimate,
                specificity: estimate,
                surface_generalization: Some(estimate),
                surface_specificity: None,
            };
            Metrics { shape: vec![point], albedo: Vec::new() }
        };
        let mean = average(&[metrics(1.0), metrics(3.0)]).unwrap();
        let point = &mean.shape[0];
        assert_eq!(point.compactness, 2.0);
        assert_eq!(point.generalization, Estimate { mean: 2.0, standard_error: 1.0 });
        assert_eq!(point.surface_generalization, Some(point.generalization));
        assert_eq!(point.surface_specificity, None);
        let mut other = metrics(3.0);
        other.shape[0].components = 2;
        assert!(average(&[metrics(1.0), other]).is_err());
    }
}
