//! `cargo xtask synthetic`: how well fits recover faces of known truth.

use crate::shell::{cargo, root, run as sh};
use crate::{Outcome, no_arguments};

/// The command: the test writes its table where this says.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    let table = root().join("docs/synthetic.md");
    let test = ["test", "--release", "--package", "onescan-tests", "--test", "synthetic"];
    sh(cargo(test).env("ONESCAN_TABLE", &table))?;
    println!("wrote {}", table.display());
    Ok(())
}
