//! `cargo xtask determinism`: builds of every kind give the same fit, to the last bit.

use crate::golden::Case;
use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::{Outcome, no_arguments, wasm};
use std::fs;
use std::path::Path;

/// A way to build onescan. Builds with the same flags share a directory, also with the tests.
struct Build {
    name: &'static str,
    profile: &'static str,
    /// RUSTFLAGS.
    flags: &'static str,
    /// Target directory, within the usual one.
    directory: &'static str,
    /// The program's place there.
    program: &'static str,
}

const BUILDS: &[Build] = &[
    Build { name: "debug", profile: "dev", flags: "", directory: "", program: "debug/onescan" },
    Build {
        name: "release",
        profile: "release",
        flags: "",
        directory: "",
        program: "release/onescan",
    },
    Build {
        name: "native",
        profile: "release",
        flags: "-C target-cpu=native",
        directory: "native",
        program: "release/onescan",
    },
];

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds, fits, compares. All fit the model of fixtures/golden: building a model is the host's
/// work and promises less.
pub(crate) fn check() -> Outcome {
    let fixtures = root().join("fixtures");
    let photos = fixtures.join("photos");
    let photo = [photos.join("astronaut.png"), "--landmarks".into(), photos.join("astronaut.tlms")];
    let mut found = Vec::new();
    for &Build { name, profile, flags, directory, program } in BUILDS {
        let directory = target().join(directory);
        let build = ["build", "--quiet", "--package", "onescan", "--profile", profile];
        sh(cargo(build).arg("--target-dir").arg(&directory).env("RUSTFLAGS", flags))?;
        let out = target().join("determinism").join(name);
        let mut fit = command(directory.join(program), ["--quiet", "fit"]);
        fit.arg(fixtures.join("golden/small.3dmm"))
            .args(&photo)
            .args(["--landmark-samples", "1000", "--samples", "2000", "--chains", "2", "-o"])
            .arg(&out);
        output(&mut fit)?;
        let fingerprint = fingerprint_of(&out.join("fit.json"))?;
        println!("{name:8} {fingerprint}");
        found.push(fingerprint);
        // Of this the test of the release build's program knows, and unoptimised it takes minutes.
        if name == "native" {
            let place = Case::Full.inputs()?;
            let mut fit = command(directory.join(program), ["--quiet", "fit"]);
            fit.arg(place.join("face.3dmm")).args(&photo).arg("-o").arg(&out);
            output(&mut fit)?;
            let found = fingerprint_of(&out.join("fit.json"))?;
            Case::Full.compare("native", &format!("fingerprint {found}"))?;
        }
    }
    if found.iter().all(|fingerprint| *fingerprint == found[0]) {
        wasm::check()
    } else {
        Err("the builds disagree: somewhere the core's bits depend on how it was compiled".into())
    }
}

/// The field of that name.
fn fingerprint_of(path: &Path) -> Result<String, String> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let line = text.lines().find(|line| line.trim_start().starts_with("\"fingerprint\""));
    let value = line.and_then(|line| line.split('"').nth(3));
    value.map(Into::into).ok_or_else(|| format!("{}: no fingerprint", path.display()))
}
