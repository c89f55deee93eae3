//! `cargo xtask c`: the C library, and what C programs make of it.

use crate::golden::Case;
use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::targets::install;
use crate::{Outcome, no_arguments};
use std::path::{Path, PathBuf};

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds the library (which writes its header) and runs the programs.
pub(crate) fn check() -> Outcome {
    // Not of the workspace, so no other stage looks at it.
    let (crate_, place) = (root().join("c"), target().join("c"));
    sh(cargo(["fmt", "--check"]).current_dir(&crate_))?;
    let clippy = ["clippy", "--quiet", "--release", "--target-dir"];
    sh(cargo(clippy).arg(&place).args(["--", "-D", "warnings"]).current_dir(&crate_))?;
    let library = Library::build("", place)?;
    let errors = library.link("tests/c/errors.c")?;
    let inputs = Case::Small.inputs()?;
    sh(command(errors, [inputs.join("face.3dmm")]).current_dir(&inputs))?;
    library.compare("C")
}

/// A build of the C library.
pub(crate) struct Library {
    /// Its target directory.
    place: PathBuf,
    file: PathBuf,
}

impl Library {
    /// Builds it with RUSTFLAGS, of which each choice wants its own directory.
    pub(crate) fn build(flags: &str, place: PathBuf) -> Result<Self, String> {
        let build = ["build", "--quiet", "--release", "--target-dir"];
        sh(cargo(build).arg(&place).env("RUSTFLAGS", flags).current_dir(root().join("c")))?;
        if output(&mut command("gcc", ["--version"])).is_err() {
            install(&["gcc", "libc6-dev"])?;
        }
        let file = place.join("release/libonescan.a");
        Ok(Self { place, file })
    }

    /// Compiles a program with it.
    fn link(&self, source: &str) -> Result<PathBuf, String> {
        let program = self.place.join(Path::new(source).file_stem().unwrap_or_default());
        let strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-Ic/include"];
        sh(command("gcc", strict).arg(source).arg(&self.file).arg("-o").arg(&program))?;
        Ok(program)
    }

    /// Fits the golden cases by C programs.
    pub(crate) fn compare(&self, who: &str) -> Outcome {
        for case in Case::ALL {
            let source = if case == Case::Small { "c/example.c" } else { "tests/c/full.c" };
            let place = case.inputs()?;
            let inputs = ["face.3dmm", "photo.ppm", "photo.tlms"].map(|name| place.join(name));
            case.compare(who, &output(&mut command(self.link(source)?, inputs))?)?;
        }
        Ok(())
    }
}
