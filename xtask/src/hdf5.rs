//! `cargo xtask hdf5`: our `.h5` files through the eyes of HDF5's own library, and what we say of
//! samples through `ArviZ`'s.

use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::targets::install;
use crate::{Outcome, no_arguments};
use std::fs;
use std::path::PathBuf;

/// What of Python's packages is asked for.
const PACKAGES: [&str; 3] = ["h5py==3.16.0", "arviz==0.23.4", "distributed==2026.8.0"];
/// The face template: vertices, triangles, and how many landmarks it has.
const TEMPLATE: [&str; 3] = ["8291", "16374", "42"];
const RANK: &str = "5";

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds a model in both forms, samples a posterior, and has Python look at them.
pub(crate) fn check() -> Outcome {
    let python = python()?;
    let place = target().join("hdf5");
    fs::create_dir_all(&place).map_err(|e| format!("{}: {e}", place.display()))?;
    let face = root().join("fixtures/face");
    for name in ["face.h5", "face.h5.json"] {
        let mut build = cargo(["run", "--quiet", "--release", "--", "--quiet", "build"]);
        build.arg(face.join("template.ply")).arg("--landmarks").arg(face.join("landmarks.json"));
        sh(build.args(["--rank", RANK, "-o"]).arg(place.join(name)))?;
    }
    let [vertices, triangles, landmarks] = TEMPLATE;
    let mut check = command(&python, ["tests/python/model.py"]);
    sh(check.arg(&place).args([vertices, triangles, RANK, landmarks]))?;
    let photos = root().join("fixtures/photos");
    let mut fit = cargo(["run", "--quiet", "--release", "--", "--quiet", "fit"]);
    fit.arg(place.join("face.h5")).arg(photos.join("astronaut.png"));
    fit.arg("--landmarks").arg(photos.join("astronaut.tlms"));
    let sampled = place.join("posterior");
    sh(fit.args(["--size", "96", "--posterior", "100", "-o"]).arg(&sampled))?;
    sh(command(&python, ["tests/python/posterior.py"]).arg(sampled))
}

/// A Python of our own with the packages, made on first use.
pub(crate) fn python() -> Result<PathBuf, String> {
    let place = target().join("python");
    let python = place.join("bin/python");
    let has = || output(&mut command(&python, ["-c", "import arviz, distributed, h5py"])).is_ok();
    if has() {
        return Ok(python);
    }
    let make = || sh(command("python3", ["-m", "venv", "--clear"]).arg(&place));
    if make().is_err() {
        install(&["python3-venv"])?;
        make()?;
    }
    sh(command(&python, ["-m", "pip", "install", "--quiet"]).args(PACKAGES))?;
    Ok(python)
}
