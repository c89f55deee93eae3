//! `onescan experiment recognition`.

use super::super::output_directory;
use super::super::running::{stop_on_signals, watch};
use super::put;
use clap::Args;
use onescan::error::{Error, Result};
use onescan::experiment::recognition::models::Named;
use onescan::experiment::recognition::results::Results;
use onescan::experiment::recognition::{Job, Plan, pictures};
use onescan::progress::{Console, print};
use rayon::ThreadPoolBuilder;
use std::fmt::Write as _;
use std::path::PathBuf;

/// People told apart by fits: the gallery at 0°, probes at 15, 30 and 45°.
///
/// The paper's table: its nine models of kernels on the template, the symmetric-full kernels on each
/// of ten scans, the mixture of these, the principal components of the ten scans, and those of 60
/// people in the role of the Basel face model. All are fitted to clean pictures of 249 synthetic
/// people, and with --pictures DIR to the pictures `PERSON_YAW.jpg` of a directory as well.
///
/// Writes report.html, recognition.json and table.md; the models and what fits found go to folders
/// beside. What is there is not done again: the same command goes on where it was stopped.
///
/// The work is a list of independent jobs. --jobs prints them, a command a line, for whatever runs
/// lists of commands (docs/scale.md); the command without --jobs and --job then makes the report.
///
/// Example: onescan experiment recognition --quick -o out/recognition
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
    /// Synthetic people, four clean pictures each [default: 249, with --quick 20].
    #[arg(long, value_parser = clap::value_parser!(u32).range(0..=10_000))]
    people: Option<u32>,
    /// Only these models, as the table names them [default: all; with --quick some, of fewer
    /// components].
    #[arg(long, value_name = "NAME", num_args = 1.., value_delimiter = ',')]
    models: Vec<String>,
    /// Components of models of kernels [default: 199, with --quick 50].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=200))]
    rank: Option<u32>,
    /// Seed of the synthetic people and their pictures.
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// A small one, in minutes.
    #[arg(long)]
    quick: bool,
    /// Print the jobs that are not done yet, a command a line, and do none.
    #[arg(long, conflicts_with = "job")]
    jobs: bool,
    /// Do one job, as --jobs names it.
    #[arg(long, value_name = "SET/MODEL/YAW")]
    job: Option<String>,
    /// Threads to fit with [default: all there are].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
}

/// Models of a small experiment.
const QUICK: [&str; 6] =
    ["symmetric-full", "symmetric-rgb", "scan-00", "scan-01", "ten-scan-pca", "sixty-people-pca"];

impl Recognition {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let plan = self.plan()?;
        if self.jobs {
            return self.print_jobs(&plan);
        }
        output_directory(&self.output)?;
        if let Some(threads) = self.threads {
            let pool = ThreadPoolBuilder::new().num_threads(threads as usize).build();
            return pool.map_err(Error::new)?.install(|| self.work(&plan, console));
        }
        self.work(&plan, console)
    }

    fn work(&self, plan: &Plan, console: Console) -> Result<()> {
        let mut jobs = plan.jobs();
        if let Some(name) = &self.job {
            jobs.retain(|job| job.to_string() == *name);
            if jobs.is_empty() {
                return Err(Error::new(format_args!(
                    "no job {name:?}; --jobs with the same options prints them"
                )));
            }
        }
        let stop = stop_on_signals()?;
        let total = jobs.iter().map(|job| plan.size(job)).sum::<Result<u64>>()?;
        let done = watch(&stop, console.task("fitting", total), |control| {
            let one = |job: &Job| plan.run(job, control);
            jobs.iter().try_fold(true, |on, job| if on { one(job) } else { Ok(false) })
        })?;
        if !done {
            return Err(Error::file(
                &self.output,
                "interrupted; the same command goes on from the last job done",
            ));
        }
        if self.job.is_some() {
            return Ok(());
        }
        let results = Results::read(plan)?;
        put(&self.output, "recognition.json", results.to_json()?)?;
        put(&self.output, "table.md", results.markdown())?;
        put(&self.output, "report.html", results.page(plan)?)?;
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }

    /// The commands of the jobs that are not done.
    fn print_jobs(&self, plan: &Plan) -> Result<()> {
        let program = std::env::current_exe().map_err(Error::new)?;
        let mut line = format!("{} -q experiment recognition", quoted(&program.to_string_lossy()));
        let mut add = |name: &str, value: &str| {
            // Writing to a string cannot fail.
            let _ = write!(line, " --{name} {}", quoted(value));
        };
        add("output", &self.output.to_string_lossy());
        add("fixtures", &self.fixtures.to_string_lossy());
        if let Some(pictures) = &self.pictures {
            add("pictures", &pictures.to_string_lossy());
        }
        add("people", &plan.people.to_string());
        add("rank", &plan.rank.to_string());
        add("seed", &plan.seed.to_string());
        add("threads", &self.threads.unwrap_or(1).to_string());
        for job in plan.jobs() {
            if plan.read(&job)?.is_none() {
                print(format_args!("{line} --job {job}"))?;
            }
        }
        Ok(())
    }

    fn plan(&self) -> Result<Plan> {
        let wanted: Vec<&str> = match &self.models[..] {
            [] if self.quick => QUICK.to_vec(),
            names => names.iter().map(String::as_str).collect(),
        };
        let models = Named::of_names(&wanted)?;
        if let Some(directory) = &self.pictures {
            pictures(directory)?;
        }
        Ok(Plan {
            output: self.output.clone(),
            fixtures: self.fixtures.clone(),
            pictures: self.pictures.clone(),
            models,
            rank: self.rank.unwrap_or(if self.quick { 50 } else { 199 }) as usize,
            people: self.people.unwrap_or(if self.quick { 20 } else { 249 }) as usize,
            seed: self.seed,
        })
    }
}

/// A word for a shell.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,:@+".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}
