//! `cargo xtask rough`: how well fits to rough pictures recover faces of known truth.

use crate::Outcome;
use crate::shell::{cargo, root, run as sh};
use std::path::PathBuf;

/// Where a set too large for the repository lies beside it.
const BESIDE: &str = "../shared/data/rough";

/// The directory of pictures that arguments name, or the one beside; `None`, which is said, if that is
/// not there.
pub(crate) fn directory(arguments: &[String]) -> Result<Option<PathBuf>, String> {
    let directory = match arguments {
        [] => root().join(BESIDE),
        [directory] => PathBuf::from(directory),
        _ => return Err("expected one directory of pictures PERSON_YAW.jpg and .tlms".into()),
    };
    if !directory.is_dir() {
        if !arguments.is_empty() {
            return Err(format!(
                "{}: no such directory; expected one of pictures PERSON_YAW.jpg and .tlms",
                directory.display()
            ));
        }
        println!("skipped: no {}; name another directory of pictures", directory.display());
        return Ok(None);
    }
    directory.canonicalize().map(Some).map_err(|e| e.to_string())
}

/// The command: the test fits all pictures of the directory and prints what they come to.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    let Some(directory) = directory(arguments)? else { return Ok(()) };
    let test = ["test", "--release", "--package", "onescan-tests", "--test", "rough"];
    sh(cargo(test).args(["--", "--nocapture"]).env("ONESCAN_ROUGH", directory))
}
