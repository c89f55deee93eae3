//! `cargo xtask calibration`: how often the posterior's intervals hold the truth.

use crate::Outcome;
use crate::rough::directory;
use crate::shell::{cargo, run as sh};

/// The command: the test samples posteriors of known truth and prints what their intervals hold.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    let mut test =
        cargo(["test", "--release", "--package", "onescan-tests", "--test", "calibration"]);
    test.args(["--", "--nocapture"]);
    let mut rest = arguments;
    while let [option, number, after @ ..] = rest {
        let name = match option.as_str() {
            "--faces" => "ONESCAN_FACES",
            "--patch" => "ONESCAN_PATCH",
            _ => break,
        };
        if !number.parse::<u32>().is_ok_and(|number| number >= 1) {
            return Err(format!("{option} {number}: expected a whole number of at least 1"));
        }
        test.env(name, number);
        rest = after;
    }
    let Some(directory) = directory(rest)? else { return Ok(()) };
    sh(test.env("ONESCAN_ROUGH", directory))
}
