//! `cargo xtask golden`: makes the golden results anew, for a change that is meant to change them.
//! And what the shells that compute them ask for.

use crate::Outcome;
use crate::shell::{cargo, output, root, run as sh, target};
use std::fs;
use std::path::PathBuf;

/// Of the golden lines, those that say most: the chain's fingerprint and the search's.
pub(crate) const FITS: [&str; 2] = ["fingerprint", "search"];

/// What tests/tests/golden.rs and device.rs look at: they write what they otherwise compare.
const WRITE: &str = "ONESCAN_GOLDEN";

/// The core's test that draws how often the truth is at which rank, and what tells it where.
const RANKS: (&str, &str) = ("the_truth_is_at_any_rank", "ONESCAN_RANKS");

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
    if arguments.is_empty() {
        let case = ["run", "--quiet", "--release", "--package", "onescan-case", "--example"];
        let hashes = output(cargo(case).args(["fingerprint", "--features", "micromath"]))?;
        let path = Case::Micromath.golden();
        fs::write(&path, hashes).map_err(|e| format!("{}: {e}", path.display()))?;
        let test = ["test", "--release", "--package", "onescan-core", "--lib", RANKS.0];
        sh(cargo(test).env(RANKS.1, root().join("docs/ranks.svg")))?;
    }
    println!("now read `git diff --stat fixtures docs`, and say in the commit why they changed");
    Ok(())
}

/// A fit that every shell is to come to the same bits of.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Case {
    /// That of tests/case: made for a microcontroller, and for its settings.
    Small,
    /// The same by a core with the feature `micromath`, which rounds otherwise.
    Micromath,
    /// A default chain of a full-size model.
    Full,
}

impl Case {
    /// Those of the core as it is.
    pub(crate) const ALL: [Self; 2] = [Self::Small, Self::Full];

    /// Where `face.3dmm`, `photo.ppm` and `photo.tlms` are. Those of the full-size case are made
    /// by the test that fits it by the program, if they are not there.
    pub(crate) fn inputs(self) -> Result<PathBuf, String> {
        if self != Self::Full {
            return Ok(root().join("fixtures/device"));
        }
        let place = target().join("full");
        if !place.join("photo.tlms").exists() {
            let test = ["test", "--release", "--package", "onescan-tests", "--test", "golden"];
            sh(cargo(test).arg("full_size"))?;
        }
        Ok(place)
    }

    /// The file of golden lines: a name and a hash each.
    pub(crate) fn golden(self) -> PathBuf {
        let name = match self {
            Self::Small => "device.txt",
            Self::Micromath => "micromath.txt",
            Self::Full => "full.txt",
        };
        root().join("fixtures/golden").join(name)
    }

    /// Compares lines with the golden ones of their names; at least those called `names` must be
    /// there.
    pub(crate) fn compare(self, who: &str, names: &[&str], found: &str) -> Outcome {
        let path = self.golden();
        let golden = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        let name = |line: &str| line.split(' ').next().unwrap_or_default().to_owned();
        for line in found.lines() {
            let expected = golden.lines().find(|expected| name(expected) == name(line));
            if expected != Some(line) {
                let expected = expected.unwrap_or("nothing of that name");
                return Err(format!("{who} computes {line}, every other target {expected}"));
            }
        }
        let size = if self == Self::Full { "full" } else { "small" };
        for wanted in names {
            let line = found.lines().find(|line| name(line) == *wanted);
            let line = line.ok_or_else(|| format!("{who} says nothing of {wanted}"))?;
            println!("{who:18} {size:5} {line}");
        }
        Ok(())
    }
}
