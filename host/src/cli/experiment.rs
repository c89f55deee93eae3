//! `onescan experiment`.

use super::output_directory;
use clap::{Args, Subcommand};
use onescan::error::Result;
use onescan::experiment::compactness;
use onescan::files::write_atomically;
use onescan::metrics::Options;
use onescan::progress::Console;
use onescan::report;
use std::io::Write;
use std::path::PathBuf;

#[derive(Subcommand)]
pub(super) enum Experiment {
    /// Compactness, generalization and specificity of one-scan models beside a model of 60 people.
    ///
    /// Builds 13 models of kernels, three on the template and one on each of ten scans, and one of
    /// the principal components of 60 people; measures all on the scans' true surfaces (a scan's
    /// own model on the other nine). Takes some minutes. Writes report.html, compactness.json and
    /// table.md.
    Compactness(Compactness),
}

impl Experiment {
    pub(super) fn run(self, console: Console) -> Result<()> {
        match self {
            Self::Compactness(command) => command.run(console),
        }
    }
}

#[derive(Args)]
pub(super) struct Compactness {
    /// Directory to write to.
    #[arg(short, long)]
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
    #[arg(long, default_value_t = 20)]
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
        let mut task = console.task("models", 1000);
        let result =
            compactness::run(&self.fixtures, self.rank as usize, &options, &mut |done, what| {
                task.name(what);
                task.set((1000.0 * done) as u64);
            })?;
        task.finish();
        let put = |name: &str, text: &str| {
            write_atomically(&self.output.join(name), |out| out.write_all(text.as_bytes()))
        };
        put("compactness.json", &result.to_json()?)?;
        put("table.md", &report::measures_table(&result.curves))?;
        let notes = result.notes();
        let notes: Vec<&str> = notes.iter().map(String::as_str).collect();
        let page = report::measures_report(
            "One scan, or many people?",
            "Compactness, generalization and specificity of models made from one scan, beside a \
             model learnt from 60 people.",
            &notes,
            &result.curves,
        )?;
        put("report.html", &page)?;
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}
