//! `onescan experiment recognition`.

use super::super::fit::{interrupted, stop_on_signals, watch};
use super::super::output_directory;
use clap::Args;
use onescan::error::{Error, Result};
use onescan::experiment::recognition::models::Named;
use onescan::experiment::recognition::{Job, Plan};
use onescan::progress::Console;
use std::path::PathBuf;

/// People told apart by fits: the gallery at 0°, probes at 15, 30 and 45°.
#[derive(Args)]
pub(super) struct Recognition {
    /// Directory to write to.
    #[arg(short, long, default_value = "out/recognition")]
    output: PathBuf,
    /// Directory of the fixtures, as in the project's repository.
    #[arg(long, default_value = "fixtures")]
    fixtures: PathBuf,
    /// Directory of rough pictures as well, `PERSON_YAW.jpg` with `.tlms` beside.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Synthetic people, four clean pictures each.
    #[arg(long, default_value_t = 249, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    people: u32,
    /// Only these models, as the table names them.
    #[arg(long, value_name = "NAME", num_args = 1.., value_delimiter = ',')]
    models: Vec<String>,
    /// Components of models of kernels.
    #[arg(long, default_value_t = 199, value_parser = clap::value_parser!(u32).range(1..=200))]
    rank: u32,
    /// Seed of the synthetic people and their pictures.
    #[arg(long, default_value_t = 7)]
    seed: u64,
}

impl Recognition {
    pub(super) fn run(self, console: Console) -> Result<()> {
        output_directory(&self.output)?;
        let plan = self.plan()?;
        let jobs = plan.jobs();
        let stop = stop_on_signals()?;
        let total = jobs.iter().map(|job| plan.size(job)).sum::<Result<u64>>()?;
        let done = watch(&stop, console.task("fitting", total), |control| {
            let one = |job: &Job| plan.run(job, control);
            jobs.iter().try_fold(true, |on, job| if on { one(job) } else { Ok(false) })
        })?;
        if !done {
            return Err(interrupted());
        }
        Ok(())
    }

    fn plan(&self) -> Result<Plan> {
        let mut models = Named::all();
        if !self.models.is_empty() {
            let known = |name: &String| models.iter().any(|model| model.name == *name);
            if let Some(other) = self.models.iter().find(|name| !known(name)) {
                let names: Vec<_> = models.iter().map(|model| &*model.name).collect();
                return Err(Error::new(format_args!(
                    "no model {other:?}; there are {}",
                    names.join(", ")
                )));
            }
            models.retain(|model| self.models.contains(&model.name));
        }
        Ok(Plan {
            output: self.output.clone(),
            fixtures: self.fixtures.clone(),
            pictures: self.pictures.clone(),
            models,
            rank: self.rank as usize,
            people: self.people as usize,
            seed: self.seed,
        })
    }
}
