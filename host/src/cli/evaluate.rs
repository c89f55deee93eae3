//! `onescan evaluate`.

use super::{file_name, meshes, output_directory, read_model};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::publish;
use onescan::model::metrics::{Curve, Options, Point, TestSet, measure};
use onescan::progress::Console;
use onescan::report;
use onescan::scan::rigid::Rigid;
use onescan::scan::surface::Surface;
use serde_json::json;
use std::path::PathBuf;

#[derive(Args)]
pub(super) struct Evaluate {
    /// The model: .3dmm, .h5, .h5.json or .mat; several are compared.
    #[arg(required = true, num_args = 1..=5)]
    models: Vec<PathBuf>,
    /// Meshes to measure with, PLY, or directories of them.
    #[arg(long, required = true, num_args = 1..)]
    meshes: Vec<PathBuf>,
    /// Directory to write to.
    #[arg(short, long)]
    output: PathBuf,
    /// Random instances for specificity.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    samples: u32,
    /// How many of them are compared with the meshes' surfaces as well (slower); 0 for no
    /// distances to surfaces.
    #[arg(long, default_value_t = 0)]
    surface_samples: u32,
    /// Seed of the instances.
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Move the meshes rigidly onto the first model's mean before.
    #[arg(long)]
    align: bool,
}

impl Evaluate {
    pub(super) fn run(self, console: Console) -> Result<()> {
        output_directory(&self.output)?;
        let models =
            self.models.iter().map(|path| read_model(console, path)).collect::<Result<Vec<_>>>()?;
        let mut tests = meshes(&self.meshes)?;
        for (path, mesh) in &mut tests {
            let odd = models
                .iter()
                .zip(&self.models)
                .find(|(model, _)| model.shape.vertices() != mesh.points.len());
            if let Some((model, name)) = odd {
                return Err(Error::file(
                    path,
                    format_args!(
                        "has {} vertices, {} {}; give meshes of the model's topology",
                        mesh.points.len(),
                        name.display(),
                        model.shape.vertices()
                    ),
                ));
            }
            if self.align {
                let motion = Rigid::between(&mesh.points, &models[0].shape.mean)
                    .ok_or_else(|| Error::file(path, "cannot be aligned"))?;
                for point in &mut mesh.points {
                    *point = motion.apply(*point);
                }
            }
        }
        let options = Options {
            samples: self.samples as usize,
            surface_samples: self.surface_samples as usize,
            seed: self.seed,
        };
        let meshes = || tests.iter().map(|(_, mesh)| mesh);
        let surfaces: Vec<Surface> = meshes().map(Surface::new).collect();
        let set = TestSet::new(meshes().collect(), surfaces.iter().collect());
        let mut task = console.task("measuring", models.len() as u64);
        let mut curves = Vec::new();
        for (i, (model, path)) in models.iter().zip(&self.models).enumerate() {
            curves.push(Curve {
                name: file_name(path),
                about: format!(
                    "{} shape and {} albedo components",
                    model.shape.rank(),
                    model.albedo.rank()
                ),
                metrics: measure(model, &set, &options).map_err(|e| Error::file(path, e))?,
            });
            task.set(i as u64 + 1);
        }
        task.finish();

        let names: Vec<_> = tests.iter().map(|(path, _)| file_name(path)).collect();
        let value = json!({
            "meshes": names,
            "samples": options.samples,
            "surface_samples": options.surface_samples,
            "seed": options.seed,
            "aligned": self.align,
            "models": curves,
        });
        let text = format!("{value:#}\n");
        let note = format!(
            "Measured with {} meshes and {} random instances (seed {}). Bars are 95 % intervals of \
             the mean over meshes or instances.",
            names.len(),
            options.samples,
            options.seed
        );
        let page = report::measures_report(
            "How good is the model?",
            "Compactness, generalization and specificity by number of components.",
            &[&note],
            &curves,
        )?;
        let files = [("report.html", page), ("metrics.json", text)];
        publish(&self.output, &files.map(|(name, text)| (name, text.into_bytes())), &[""; 0], &[])?;
        for curve in &curves {
            let last = |points: &[Point]| {
                points.last().map_or([f64::NAN; 2], |p| [p.generalization.mean, p.specificity.mean])
            };
            let (shape, albedo) = (last(&curve.metrics.shape), last(&curve.metrics.albedo));
            console.say(format_args!(
                "{}: generalization {:.2} mm, {:.4} RGB; specificity {:.2} mm, {:.4} RGB",
                curve.name, shape[0], albedo[0], shape[1], albedo[1]
            ));
        }
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}
