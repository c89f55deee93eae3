//! `cargo xtask package`: what crates.io would get. The packages hold their licences and all that
//! they are compiled with, and compile without the workspace around them. And `cargo xtask msrv`.

use crate::shell::{cargo, command, root, run as sh, target};
use crate::{Outcome, no_arguments};
use std::fs;
use std::path::Path;

/// The published crates, and what must be in each beside its sources.
const PACKAGES: [(&str, &[&str]); 2] =
    [("onescan-core", &[]), ("onescan", &["demo/template.ply", "networks/LICENSE"])];
/// What is in all of them, as in the workspace's root.
const LICENCES: [&str; 2] = ["LICENSE-APACHE", "LICENSE-MIT"];

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Packs, unpacks, looks, compiles. Cargo's own verification does the same, but compiles all crates
/// that ours depend on once more, which takes minutes; here they are those of the lints.
pub(crate) fn check() -> Outcome {
    let mut package = cargo(["package", "--quiet", "--no-verify", "--allow-dirty"]);
    for (name, _) in PACKAGES {
        package.args(["--package", name]);
    }
    sh(&mut package)?;
    let version = env!("CARGO_PKG_VERSION");
    let place = target().join("package/unpacked");
    let fault = |path: &Path, e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
    if place.exists() {
        fs::remove_dir_all(&place).map_err(|e| fault(&place, &e))?;
    }
    fs::create_dir_all(&place).map_err(|e| fault(&place, &e))?;
    for (name, files) in PACKAGES {
        let packed = target().join(format!("package/{name}-{version}.crate"));
        sh(command("tar", ["-xzf"]).arg(packed).arg("-C").arg(&place))?;
        let unpacked = place.join(format!("{name}-{version}"));
        for licence in LICENCES {
            let [ours, packed] =
                [&root(), &unpacked].map(|place| fs::read(place.join(licence)).unwrap_or_default());
            if ours.is_empty() || ours != packed {
                return Err(format!("{name}: {licence} is not the workspace's"));
            }
        }
        for file in files.iter().map(|file| unpacked.join(file)) {
            // A link would lead to nowhere.
            if !fs::symlink_metadata(&file).is_ok_and(|file| file.is_file() && file.len() > 0) {
                return Err(fault(&file, &"is not a file in the package"));
            }
        }
        // Not of the workspace in whose directory it lies.
        let manifest = unpacked.join("Cargo.toml");
        let text = fs::read_to_string(&manifest).map_err(|e| fault(&manifest, &e))?;
        fs::write(&manifest, text + "\n[workspace]\n").map_err(|e| fault(&manifest, &e))?;
    }
    let core = place.join(format!("onescan-core-{version}"));
    let patch = format!("patch.crates-io.onescan-core.path={:?}", core.display().to_string());
    let mut check = cargo(["check", "--quiet", "--release", "--config", &patch, "--target-dir"]);
    sh(check.arg(target()).current_dir(place.join(format!("onescan-{version}"))))
}

/// `cargo xtask msrv`: the published crates by the oldest compiler that they promise to need, which
/// rustup loads.
pub(crate) fn oldest(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    let version = env!("CARGO_PKG_RUST_VERSION");
    sh(&mut command("rustup", ["toolchain", "install", "--profile", "minimal", version]))?;
    // Not the cargo that runs this.
    let mut check = command("rustup", ["run", version, "cargo", "check", "--quiet"]);
    check.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").arg("--target-dir");
    check.arg(target().join("msrv"));
    for (name, _) in PACKAGES {
        check.args(["--package", name]);
    }
    sh(&mut check)
}
