//! `onescan demo`, which is also what plain `onescan` does.

use super::output_directory;
use super::running::watch;
use clap::Args;
use onescan::demo::{subjects, template_model};
use onescan::error::{Error, Result};
use onescan::files::write_atomically;
use onescan::fit::output::{self, Finished, Names, PhotoNames};
use onescan::fit::summary::Summaries;
use onescan::fit::{Ending, Job};
use onescan::photo::picture::{Picture, contact_sheet};
use onescan::progress::Console;
use onescan::texture::Kind;
use onescan::{render, report};
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Build the built-in face model, fit it to three photos, write a report with pictures.
///
/// Takes about half a minute. The directory then holds the model, each photo with its
/// landmarks and its fit, summary.json and report.html.
#[derive(Args)]
pub(super) struct Demo {
    /// Directory to write to.
    #[arg(long, default_value = Demo::OUT)]
    out: PathBuf,
    /// Seed of all randomness.
    #[arg(long, default_value_t = Demo::SEED)]
    seed: u64,
}

impl Default for Demo {
    fn default() -> Self {
        Self { out: Self::OUT.into(), seed: Self::SEED }
    }
}

/// Components of each half of the demo's model: the paper's number.
const RANK: usize = 199;
/// Instances of the model the report shows.
const SAMPLES: usize = 8;

impl Demo {
    const OUT: &'static str = "out/demo";
    const SEED: u64 = 7;

    pub(super) fn run(self, console: Console) -> Result<()> {
        output_directory(&self.out)?;
        let mut task = console.task("building the model", 1000);
        let built = template_model(RANK, &mut |done, _| task.set((1000.0 * done) as u64))?;
        task.finish();
        console.say(&built.report);
        built.model.write(&self.out.join("face.3dmm"))?;
        let model = built.model.view();

        let mut results: Vec<(Finished, &str)> = Vec::new();
        for subject in subjects(self.seed)? {
            let directory = self.out.join(subject.name);
            output_directory(&directory)?;
            let tlms = format!("{}.tlms", subject.name);
            put(&directory.join(subject.file), &subject.bytes)?;
            put(&directory.join(&tlms), subject.landmarks.to_text().as_bytes())?;
            let job = Job::new(&model, &subject.photo, &subject.landmarks)?;
            let job = Job { seed: self.seed, ..job };
            let task = console.task(subject.name, job.steps());
            let Ending::Done(fit) =
                watch(&AtomicBool::new(false), task, |control| job.run(None, control))?
            else {
                return Err(Error::new("the fit was stopped"));
            };
            let photo =
                PhotoNames { image: subject.file.into(), landmarks: Some(tlms), mask: None };
            let names =
                Names { model: "face.3dmm".into(), given: None, face: 1, photos: vec![photo] };
            for result in output::finish(&[job], &[*fit], &names, Kind::default())? {
                output::write(&directory, &result, Vec::new(), &[])?;
                console.say(output::closing_line(&result.summary));
                results.push((result, subject.about));
            }
        }

        let sheet = sample_sheet(&model, self.seed)?;
        let page = report::demo_report(&results, &sheet, model.provenance())?;
        put(&self.out.join("report.html"), page.as_bytes())?;
        let fits = results.into_iter().map(|(result, _)| result.summary).collect();
        put(&self.out.join("summary.json"), Summaries { fits }.to_json()?.as_bytes())?;
        console.say(format_args!("open {}", self.out.join("report.html").display()));
        Ok(())
    }
}

fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, |out| out.write_all(bytes))
}

/// Random instances of the model, as many as [`SAMPLES`].
fn sample_sheet(model: &Model<'_>, seed: u64) -> Result<Picture> {
    let mut rng = Rng::new(seed, 0);
    let pictures = (0..SAMPLES)
        .map(|_| {
            let shape = render::random_coefficients(model.shape.rank(), &mut rng);
            let albedo = render::random_coefficients(model.albedo.rank(), &mut rng);
            let mesh = render::instance(model, &shape, &albedo);
            render::draw_mesh(&mesh, &render::portrait(model, [256; 2], 0.35, 0.0), render::GROUND)
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(contact_sheet(&pictures.iter().collect::<Vec<_>>(), 4, 4, render::GROUND))
}
