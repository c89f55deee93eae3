//! `cargo xtask scale`: the jobs of an experiment, done by GNU parallel, by Dask, and as tasks of a
//! SLURM array, come to the same bytes.

use crate::hdf5::python;
use crate::shell::{cargo, command, output, run as sh, target};
use crate::targets::install;
use crate::{Outcome, no_arguments};
use std::fs;
use std::path::{Path, PathBuf};

/// A small experiment, and its jobs: two models, four angles.
const EXPERIMENT: &str = "experiment recognition --people 3 --rank 5 --models";
const MODELS: &str = "symmetric-full,ten-scan-pca";
const JOBS: usize = 8;
const ARRAY: &str = "docs/scale/jobs.sbatch";

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Does the jobs in all ways and compares.
pub(crate) fn check() -> Outcome {
    sh(&mut cargo(["build", "--release", "--quiet", "--package", "onescan"]))?;
    for (program, package) in [("parallel", "parallel"), ("shellcheck", "shellcheck")] {
        if output(&mut command(program, ["--version"])).is_err() {
            install(&[package])?;
        }
    }
    let place = target().join("scale");
    let _ = fs::remove_dir_all(&place);
    let [parallel, dask, array] = ["parallel", "dask", "array"].map(|name| place.join(name));
    for of in [&parallel, &dask, &array] {
        let jobs = jobs(of)?;
        expect(of, jobs.lines().count(), JOBS)?;
        fs::create_dir_all(of).and_then(|()| fs::write(table(of), jobs)).map_err(told(of))?;
    }
    sh(command("parallel", ["--jobs", "2", "--halt", "soon,fail=1", "--arg-file"])
        .arg(table(&parallel)))?;
    sh(command(python()?, ["docs/scale/with_dask.py"]).arg(table(&dask)))?;
    sh(&mut command("shellcheck", [ARRAY]))?;
    for task in ["1", "2"] {
        let mut tried = command("bash", [ARRAY]);
        sh(tried.arg(table(&array)).env("SLURM_ARRAY_TASK_ID", task))?;
    }
    for (of, left) in [(&parallel, 0), (&dask, 0), (&array, JOBS - 2)] {
        expect(of, jobs(of)?.lines().count(), left)?;
    }
    for yaw in ["00", "15", "30", "45"] {
        let result = |of: &Path| of.join(format!("fits/clean/symmetric-full/{yaw}.bin"));
        let bytes = |of: &Path| fs::read(result(of)).map_err(told(&result(of)));
        if bytes(&parallel)? != bytes(&dask)? {
            return Err(format!("{}: Dask's differs", result(&parallel).display()));
        }
    }
    // What is left of it is the report.
    sh(&mut experiment(&parallel))?;
    let report = parallel.join("report.html");
    fs::metadata(&report).map(drop).map_err(told(&report))
}

fn table(of: &Path) -> PathBuf {
    of.join("jobs.txt")
}

fn told(path: &Path) -> impl Fn(std::io::Error) -> String {
    move |e| format!("{}: {e}", path.display())
}

fn experiment(of: &Path) -> std::process::Command {
    let mut line = command(target().join("release/onescan"), EXPERIMENT.split(' '));
    line.arg(MODELS).arg("-q").arg("-o").arg(of);
    line
}

/// The jobs that are left.
fn jobs(of: &Path) -> Result<String, String> {
    output(experiment(of).arg("--jobs"))
}

fn expect(of: &Path, found: usize, expected: usize) -> Outcome {
    if found == expected {
        return Ok(());
    }
    Err(format!("{}: {found} jobs, expected {expected}", of.display()))
}
