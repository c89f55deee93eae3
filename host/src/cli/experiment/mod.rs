//! `onescan experiment`: the paper's experiments.

mod recognition;

use super::{file_name, output_directory};
use clap::{Args, Subcommand};
use onescan::error::{Error, Result};
use onescan::experiment::objects::animals::{Animal, Kind};
use onescan::experiment::photos::{self, Subject};
use onescan::experiment::recognition::models::Named;
use onescan::experiment::stages::Stages;
use onescan::experiment::{compactness, decomposition, kernels, objects, registration};
use onescan::files::write_atomically;
use onescan::fit::Schedule;
use onescan::mesh::Axis;
use onescan::mesh::landmarks;
use onescan::mesh::landmarks::Landmark;
use onescan::mesh::ply;
use onescan::model::metrics::Options;
use onescan::progress::Console;
use onescan::scan::mesh_file;
use onescan::{demo, report};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Repeat an experiment of the paper, on this project's faces and animals.
///
/// Each writes a page, report.html, and its pictures and numbers beside it. What it has done is kept
/// until all is (in `stages`): the same command goes on where it was stopped.
#[derive(Args)]
pub(super) struct Experiment {
    #[command(subcommand)]
    which: Which,
}

#[derive(Subcommand)]
enum Which {
    Kernels(Kernels),
    Decomposition(Decomposition),
    /// Models of a fish, and fits to pictures of other fish.
    Fish(Object),
    /// Models of a bird, and fits to pictures of other birds.
    Bird(Object),
    /// Compactness, generalization and specificity of one-scan models beside a model of 60 people.
    ///
    /// Builds 13 models of kernels, three on the template and one on each of ten scans, and one of
    /// the principal components of 60 people; measures all on the scans' true surfaces (a scan's
    /// own model on the other nine). Takes some minutes. Writes report.html, compactness.json and
    /// table.md.
    Compactness(Compactness),
    Photos(Photos),
    Recognition(recognition::Recognition),
    /// Ten scans registered by shape only, by shape and albedo, and with landmarks.
    ///
    /// With a model of kernels, and with one of 60 people and a little of the kernels; judged by where
    /// vertices truly belong. Takes some minutes. Writes report.html, averages.png, registration.json
    /// and table.md.
    Registration(Registration),
}

impl Experiment {
    pub(super) fn run(self, console: Console) -> Result<()> {
        match self.which {
            Which::Kernels(experiment) => experiment.run(console),
            Which::Decomposition(experiment) => experiment.run(console),
            Which::Fish(experiment) => experiment.run(Kind::Fish, console),
            Which::Bird(experiment) => experiment.run(Kind::Bird, console),
            Which::Compactness(experiment) => experiment.run(console),
            Which::Photos(experiment) => experiment.run(console),
            Which::Recognition(experiment) => experiment.run(console),
            Which::Registration(experiment) => experiment.run(console),
        }
    }
}

/// Three samples of each of the paper's ten kernels, on one sheet.
///
/// The kernels are those of symmetric objects: the scan's plane of symmetry is x = 0.
#[derive(Args)]
struct Kernels {
    /// The scan, as of `onescan build`, y up [default: the built-in face template].
    scan: Option<PathBuf>,
    /// Directory to write to.
    #[arg(short, long, default_value = "out/kernels")]
    output: PathBuf,
    /// Components to draw from.
    #[arg(long, default_value_t = 199, value_parser = clap::value_parser!(u32).range(1..=2000))]
    rank: u32,
    /// Seed of the coefficients.
    #[arg(long, default_value_t = 7)]
    seed: u64,
}

impl Kernels {
    fn run(self, console: Console) -> Result<()> {
        output_directory(&self.output)?;
        let (scan, name) = match &self.scan {
            Some(path) => {
                let read = mesh_file::read(path, &mesh_file::Options::default())?;
                let mut scan = read.mesh;
                scan.points.as_flattened_mut().iter_mut().for_each(|c| *c *= read.millimetres);
                (scan, file_name(path))
            }
            None => (demo::template()?.0, "the face template".to_string()),
        };
        let mut task = console.task("sampling", 1000);
        let columns =
            kernels::run(&scan, Some(Axis::X), self.rank as usize, self.seed, &mut |done, what| {
                task.report(done, what);
            })
            .map_err(|e| Error::new(format_args!("{name}: {e}")))?;
        task.finish();
        kernels::sheet(&columns).write_png(&self.output.join("kernels.png"))?;
        put(&self.output, "report.html", kernels::page(&columns, &name)?)?;
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}

/// Exact components beside Nyström's, and time and memory by number of vertices.
///
/// On the built-in face template: 50, 199 and 1000 components of shape and albedo, exact and from a
/// sample of the vertices; then 199 + 199 components of the template made finer and coarser. Takes
/// some ten minutes. Writes report.html, decomposition.json and table.md.
#[derive(Args)]
struct Decomposition {
    /// Directory to write to.
    #[arg(short, long, default_value = "out/decomposition")]
    output: PathBuf,
    /// Leave out meshes of more vertices.
    #[arg(long, default_value_t = 200_000)]
    largest: usize,
}

impl Decomposition {
    fn run(self, console: Console) -> Result<()> {
        output_directory(&self.output)?;
        // Meshes are stages of their own: which are done does not depend on how many there are.
        let stages = Stages::new(&self.output, "decomposition");
        let mut task = console.task("decomposing", 1000);
        let result = decomposition::run(self.largest, &stages, &mut |done, what| {
            task.report(done, what);
        })?;
        task.finish();
        put(&self.output, "decomposition.json", result.to_json()?)?;
        put(&self.output, "table.md", result.markdown())?;
        put(&self.output, "report.html", result.page()?)?;
        stages.forget();
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}

#[derive(Args)]
struct Object {
    /// Directory to write to [default: out/fish, out/bird].
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Directory of the fixtures, as in the project's repository.
    #[arg(long, default_value = "fixtures")]
    fixtures: PathBuf,
    /// Pictures to fit.
    #[arg(short = 'n', long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pictures: u32,
    /// How to fit them, see `onescan fit`.
    #[arg(long, value_enum, default_value_t)]
    schedule: Schedule,
    /// Seed of animals, scenes and fits.
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Only write the template and its landmarks, as the fixtures have them.
    #[arg(long)]
    template: bool,
}

impl Object {
    fn run(self, kind: Kind, console: Console) -> Result<()> {
        let output = self.output.unwrap_or_else(|| PathBuf::from("out").join(kind.name()));
        output_directory(&output)?;
        if self.template {
            let Animal { mesh, landmarks } = kind.template();
            let mut bytes = Vec::new();
            ply::write(&mut bytes, &mesh, ply::Encoding::default()).map_err(Error::new)?;
            put(&output, "template.ply", bytes)?;
            let point = |l: &Landmark| landmarks::Point {
                id: l.name.clone(),
                description: None,
                coordinates: mesh.points[l.vertex as usize].map(f64::from),
                uncertainty: None,
            };
            let points: Vec<_> = landmarks.iter().map(point).collect();
            put(&output, "landmarks.json", landmarks::to_json(&points))?;
            console.say(format_args!("wrote {}", output.join("template.ply").display()));
            return Ok(());
        }
        let place = self.fixtures.join(kind.name());
        let template = ply::read(&place.join("template.ply"))?;
        let landmarks = landmarks::read(&place.join("landmarks.json"), &template.points, 1.0)?;
        let Self { pictures, schedule, seed, .. } = self;
        let settings =
            format!("{} {pictures} {schedule} {seed} {template:?} {landmarks:?}", kind.name());
        let stages = Stages::new(&output, &settings);
        let mut task = console.task("models", 1000);
        let result = objects::run(
            kind,
            (&template, &landmarks),
            pictures as usize,
            schedule,
            seed,
            &stages,
            &mut |done, what| task.report(done, what),
        )?;
        task.finish();
        for (name, picture) in result.sheets() {
            picture.write_png(&output.join(name))?;
        }
        put(&output, "objects.json", result.to_json()?)?;
        put(&output, "table.md", result.markdown())?;
        put(&output, "report.html", result.page()?)?;
        stages.forget();
        console.say(result.markdown().trim_end());
        console.say(format_args!("open {}", output.join("report.html").display()));
        Ok(())
    }
}

#[derive(Args)]
struct Compactness {
    /// Directory to write to.
    #[arg(short, long, default_value = "out/compactness")]
    output: PathBuf,
    /// Directory of the fixtures, as in the project's repository.
    #[arg(long, default_value = "fixtures")]
    fixtures: PathBuf,
    /// Components of each model of kernels.
    #[arg(long, default_value_t = 199, value_parser = clap::value_parser!(u32).range(1..=2000))]
    rank: u32,
    /// Random instances for specificity.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    samples: u32,
    /// How many of them are compared with surfaces as well.
    #[arg(long, default_value_t = 4)]
    surface_samples: u32,
    /// Seed of the instances.
    #[arg(long, default_value_t = 7)]
    seed: u64,
}

impl Compactness {
    fn run(self, console: Console) -> Result<()> {
        output_directory(&self.output)?;
        let options = Options {
            samples: self.samples as usize,
            surface_samples: self.surface_samples as usize,
            seed: self.seed,
        };
        let settings = format!("compactness {} {options:?} {}", self.rank, self.fixtures.display());
        let stages = Stages::new(&self.output, &settings);
        let mut task = console.task("models", 1000);
        let result = compactness::run(
            &self.fixtures,
            self.rank as usize,
            &options,
            &stages,
            &mut |done, what| {
                task.report(done, what);
            },
        )?;
        task.finish();
        put(&self.output, "compactness.json", result.to_json()?)?;
        put(&self.output, "table.md", report::measures_table(&result.curves))?;
        let notes = result.notes();
        let notes: Vec<&str> = notes.iter().map(String::as_str).collect();
        let page = report::measures_report(
            "One scan, or many people?",
            "Compactness, generalization and specificity of models made from one scan, beside a \
             model learnt from 60 people.",
            &notes,
            &result.curves,
        )?;
        put(&self.output, "report.html", page)?;
        stages.forget();
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}

/// Photos, and what each of recognition's models makes of them: in the photo, from the side, and
/// where the face is hidden.
///
/// The paper's figures of reconstructions: its nine models of kernels on the template, the
/// symmetric-full kernels on each of ten scans, principal components of the ten scans and of 60
/// people. Landmarks are read from `NAME.tlms` or `NAME.pts` beside a photo, or found. Takes some
/// five seconds a model and one a fit. Writes report.html, seen.png, turned.png and masks.png.
///
/// Example: onescan experiment photos fixtures/photos --models symmetric-full,sixty-people-pca
#[derive(Args)]
struct Photos {
    /// Photos, PNG or JPEG, or directories of them.
    #[arg(required = true, value_name = "PHOTO")]
    paths: Vec<PathBuf>,
    /// Directory to write to.
    #[arg(short, long, default_value = "out/photos")]
    output: PathBuf,
    /// Directory of the fixtures, as in the project's repository.
    #[arg(long, default_value = "fixtures")]
    fixtures: PathBuf,
    /// Only these models, as recognition's table names them, with commas between.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    models: Vec<String>,
    /// Components of models of kernels.
    #[arg(long, default_value_t = 199, value_parser = clap::value_parser!(u32).range(1..=200))]
    rank: u32,
}

impl Photos {
    fn run(self, console: Console) -> Result<()> {
        let names: Vec<&str> = self.models.iter().map(String::as_str).collect();
        let models = Named::of_names(&names)?;
        let subjects = photos::photos(&self.paths)?
            .iter()
            .map(|(photo, landmarks)| Subject::read(photo, landmarks.as_deref()))
            .collect::<Result<Vec<_>>>()?;
        output_directory(&self.output)?;
        let hashes: Vec<u64> = subjects.iter().map(Subject::hash).collect();
        let stages = Stages::new(
            &self.output,
            &format!("photos {} {hashes:?} {}", self.rank, self.fixtures.display()),
        );
        let mut task = console.task("fitting", 1000);
        let sheets = photos::run(
            &subjects,
            &models,
            (&self.fixtures, self.rank as usize),
            &stages,
            &mut |done, what| task.report(done, what),
        )?;
        task.finish();
        for (name, picture) in sheets.files() {
            picture.write_png(&self.output.join(name))?;
        }
        put(&self.output, "report.html", sheets.page()?)?;
        stages.forget();
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}

#[derive(Args)]
struct Registration {
    /// Directory to write to.
    #[arg(short, long, default_value = "out/registration")]
    output: PathBuf,
    /// Directory of the fixtures, as in the project's repository.
    #[arg(long, default_value = "fixtures")]
    fixtures: PathBuf,
    /// Scans to register, the first ones.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10))]
    scans: u32,
}

impl Registration {
    fn run(self, console: Console) -> Result<()> {
        output_directory(&self.output)?;
        let stages =
            Stages::new(&self.output, &format!("registration {}", self.fixtures.display()));
        let mut task = console.task("registration", 1000);
        let result =
            registration::run(&self.fixtures, self.scans as usize, &stages, &mut |done, what| {
                task.report(done, what);
            })?;
        task.finish();
        result.averages()?.write_png(&self.output.join("averages.png"))?;
        put(&self.output, "registration.json", result.to_json()?)?;
        put(&self.output, "table.md", result.markdown())?;
        put(&self.output, "report.html", result.page()?)?;
        stages.forget();
        console.say(result.markdown().trim_end());
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}

/// Writes a file of the output directory.
fn put(directory: &Path, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
    write_atomically(&directory.join(name), |out| out.write_all(bytes.as_ref()))
}
