//! `cargo xtask golden`: makes the golden results anew, for a change that is meant to change them.

use crate::Outcome;
use crate::shell::{cargo, run as sh};

/// What tests/tests/golden.rs looks at: it writes what it otherwise compares.
const WRITE: &str = "ONESCAN_GOLDEN";

/// The command. The model stays unless asked for: it is large, and rarely the reason.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    let what = match arguments {
        [] => "results",
        [flag] if flag == "--model" => "model",
        _ => return Err("expected nothing or --model".into()),
    };
    let test = ["test", "--release", "--package", "onescan-tests", "--test", "golden"];
    sh(cargo(test).env(WRITE, what))?;
    println!("now read `git diff --stat fixtures`, and say in the commit why they changed");
    Ok(())
}
