//! `cargo xtask determinism`: builds of every kind give the same fits, to the last bit.
//!
//! The tests fit the golden cases by the command: a release build that chooses vectors at run time.
//! What is left are other ways to compile the core, by programs that are little else and so quick
//! to build.

use crate::c::Library;
use crate::golden::Case;
use crate::shell::{cargo, output, target};
use crate::{Outcome, no_arguments, wasm};

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds, fits, compares.
pub(crate) fn check() -> Outcome {
    let small = ["run", "--quiet", "--package", "onescan-case", "--example", "fingerprint"];
    Case::Small.compare("debug", &output(&mut cargo(small))?)?;
    let native = Library::build("-C target-cpu=native", target().join("native"))?;
    native.compare("C native")?;
    wasm::check()
}
