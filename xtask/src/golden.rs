//! `cargo xtask golden`: makes the golden results anew, for a change that is meant to change them.

use crate::Outcome;
use crate::shell::{cargo, run as sh};

/// What tests/tests/golden.rs and device.rs look at: they write what they otherwise compare.
const WRITE: &str = "ONESCAN_GOLDEN";

/// The command. The models stay unless asked for: they are large, and rarely the reason.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    // The device's inputs are compiled in, so its results are another run's.
    let runs = match arguments {
        [] => [("golden", "results"), ("device", "results")],
        [flag] if flag == "--model" => [("golden", "model"), ("device", "results")],
        [flag] if flag == "--device" => [("device", "device"), ("device", "results")],
        _ => return Err("expected nothing, --model or --device".into()),
    };
    let test = ["test", "--release", "--package", "onescan-tests", "--test"];
    for (name, what) in runs {
        sh(cargo(test).arg(name).env(WRITE, what))?;
    }
    println!("now read `git diff --stat fixtures`, and say in the commit why they changed");
    Ok(())
}
