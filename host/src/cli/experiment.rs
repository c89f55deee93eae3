//! `onescan experiment`: the paper's experiments.

use super::{file_name, output_directory};
use clap::{Args, Subcommand};
use onescan::error::{Error, Result};
use onescan::experiment::kernels;
use onescan::files::write_atomically;
use onescan::kernel::Axis;
use onescan::progress::Console;
use onescan::{demo, ply};
use std::io::Write;
use std::path::PathBuf;

/// Each writes a page, report.html, and its pictures and numbers beside it.
#[derive(Args)]
pub(super) struct Experiment {
    #[command(subcommand)]
    which: Which,
}

#[derive(Subcommand)]
enum Which {
    /// Three samples of each of the paper's ten kernels, on one sheet.
    Kernels(Kernels),
}

impl Experiment {
    pub(super) fn run(self, console: Console) -> Result<()> {
        match self.which {
            Which::Kernels(experiment) => experiment.run(console),
        }
    }
}

/// The kernels are those of symmetric objects: the scan's plane of symmetry is x = 0.
#[derive(Args)]
struct Kernels {
    /// The scan; the built-in face template by default.
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
            Some(path) => (ply::read(path)?, file_name(path)),
            None => (demo::template()?.0, "the face template".to_string()),
        };
        let mut task = console.task("sampling", 1000);
        let columns =
            kernels::run(&scan, Some(Axis::X), self.rank as usize, self.seed, &mut |done, what| {
                task.name(what);
                task.set((1000.0 * done) as u64);
            })
            .map_err(|e| Error::new(format_args!("{name}: {e}")))?;
        task.finish();
        kernels::sheet(&columns).write_png(&self.output.join("kernels.png"))?;
        let report = self.output.join("report.html");
        let page = kernels::page(&columns, &name)?;
        write_atomically(&report, |out| out.write_all(page.as_bytes()))?;
        console.say(format_args!("wrote {}", report.display()));
        Ok(())
    }
}
