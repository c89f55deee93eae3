//! `cargo xtask bench`: the speed of each stage and of the whole step.

use crate::shell::{cargo, run as sh};
use crate::{Outcome, no_arguments};

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    sh(&mut cargo(["bench", "--workspace", "--benches"]))?;
    sh(&mut cargo(["run", "--release", "--", "bench"]))
}
