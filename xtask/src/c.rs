//! `cargo xtask c`: the C library, and what C programs make of it.

use crate::golden::Case;
use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::targets::install;
use crate::{Outcome, no_arguments};
use std::path::Path;

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds the library (which writes its header) and runs the programs.
pub(crate) fn check() -> Outcome {
    // Not of the workspace, so no other stage looks at it.
    let (place, built) = (root().join("c"), target().join("c"));
    sh(cargo(["fmt", "--check"]).current_dir(&place))?;
    let clippy = ["clippy", "--quiet", "--release", "--target-dir"];
    sh(cargo(clippy).arg(&built).args(["--", "-D", "warnings"]).current_dir(&place))?;
    let build = ["build", "--quiet", "--release", "--target-dir"];
    sh(cargo(build).arg(&built).current_dir(&place))?;
    let library = built.join("release/libonescan.a");
    if output(&mut command("gcc", ["--version"])).is_err() {
        install(&["gcc", "libc6-dev"])?;
    }
    let compile = |source: &str, program: &str| {
        let program = built.join(program);
        let strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-Ic/include"];
        sh(command("gcc", strict).arg(source).arg(&library).arg("-o").arg(&program))?;
        Ok::<_, String>(program)
    };
    let errors = compile("tests/c/errors.c", "errors")?;
    let place = Case::Small.inputs()?;
    sh(command(errors, [place.join("face.3dmm")]).current_dir(&place))?;
    for (source, case) in [("c/example.c", Case::Small), ("tests/c/full.c", Case::Full)] {
        let name = Path::new(source).file_stem().unwrap_or_default().to_string_lossy();
        let program = compile(source, &name)?;
        let place = case.inputs()?;
        let inputs = ["face.3dmm", "photo.ppm", "photo.tlms"].map(|name| place.join(name));
        case.compare("C", &output(&mut command(program, inputs))?)?;
    }
    Ok(())
}
