//! `cargo xtask c`: the C library, and what C programs make of it.

use crate::golden::{Case, FITS};
use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::targets::{BARE, Cross, install};
use crate::{Outcome, no_arguments};
use std::path::{Path, PathBuf};

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds the library (which writes its header) and runs the programs.
pub(crate) fn check() -> Outcome {
    // Not of the workspace, so no other check looks at it.
    let (crate_, place) = (root().join("c"), target().join("c"));
    sh(cargo(["fmt", "--check"]).current_dir(&crate_))?;
    let clippy = ["clippy", "--quiet", "--release", "--target-dir"];
    sh(cargo(clippy).arg(&place).args(["--", "-D", "warnings"]).current_dir(&crate_))?;
    let library = Library::build("", place)?;
    let errors = library.link("tests/c/errors.c")?;
    let inputs = Case::Small.inputs()?;
    sh(command(errors, [inputs.join("face.3dmm")]).current_dir(&inputs))?;
    Case::ALL.into_iter().try_for_each(|case| library.compare("C", case))
}

/// A build of the C library.
pub(crate) struct Library {
    /// Its target directory.
    place: PathBuf,
    file: PathBuf,
    /// What compiles programs for it, and what runs them: this machine or an emulator.
    compiler: String,
    emulator: Option<&'static str>,
}

/// Another processor that runs Linux, by Debian's cross compiler and QEMU.
pub(crate) struct Machine {
    /// Rust's name of it.
    pub(crate) target: &'static str,
    /// The prefix of its compiler.
    pub(crate) triple: &'static str,
    /// Debian's package of its C library.
    pub(crate) libc: &'static str,
    /// The emulator.
    pub(crate) emulator: &'static str,
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
        Ok(Self { place, file, compiler: "gcc".into(), emulator: None })
    }

    /// Builds it for another processor.
    pub(crate) fn cross(machine: &Machine) -> Result<Self, String> {
        let &Machine { target, triple, libc, emulator } = machine;
        let compiler = format!("{triple}-gcc");
        let missing = |program: &str| output(&mut command(program, ["--version"])).is_err();
        if missing(&compiler) || missing(emulator) {
            install(&[&format!("gcc-{triple}"), libc, "qemu-user"])?;
        }
        let place = crate::shell::target().join("c");
        let crate_ = root().join("c");
        let arguments = &["build", "--release"];
        Cross { target, crate_: &crate_, arguments, std: BARE, flags: "", debian_flags: "" }
            .build(&place)?;
        let place = place.join(target);
        let file = place.join("release/libonescan.a");
        Ok(Self { place, file, compiler, emulator: Some(emulator) })
    }

    /// Compiles a program with it.
    fn link(&self, source: &str) -> Result<PathBuf, String> {
        let program = self.place.join(Path::new(source).file_stem().unwrap_or_default());
        let strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-Ic/include"];
        let mut gcc = command(&self.compiler, strict);
        if self.emulator.is_some() {
            // The emulated machine has no C library of its own.
            gcc.arg("-static");
        }
        sh(gcc.arg(source).arg(&self.file).arg("-o").arg(&program))?;
        Ok(program)
    }

    /// Fits a golden case by a C program.
    pub(crate) fn compare(&self, who: &str, case: Case) -> Outcome {
        let source = if case == Case::Small { "c/example.c" } else { "tests/c/full.c" };
        let program = self.link(source)?;
        let place = case.inputs()?;
        let run = |names: [&str; 3], more: &[&str]| {
            let inputs = names.map(|name| place.join(name));
            let mut command = match self.emulator {
                Some(emulator) => command(emulator, [&program]),
                None => command::<&str>(&program, []),
            };
            output(command.args(inputs).args(more))
        };
        let photo = ["face.3dmm", "photo.ppm", "photo.tlms"];
        let found = match case {
            Case::Small | Case::Micromath => {
                run(photo, &["chain"])? + &run(["face.3dmm", "half.ppm", "half.tlms"], &[])?
            }
            Case::Full => run(photo, &[])?,
        };
        case.compare(who, &FITS, &found)
    }
}
