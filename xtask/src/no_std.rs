//! `cargo xtask no-std`: the core needs neither `std` nor a heap, and no build of the workspace
//! makes it compute with other maths than its own.

use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::{Outcome, no_arguments};
use std::fs;
use std::path::Path;

/// A Cortex-M7, used if rustup has it.
const DEVICE: &str = "thumbv7em-none-eabihf";

/// The core in a program of its own: a second panic handler (std has the first) or a missing
/// allocator stops the compiler, so this proves the point even where no bare-metal target is
/// installed.
const PROGRAM: &str = "//! Links the core without std and without a heap.
#![no_std]
use onescan_core as _;
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
";

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// All of it.
pub(crate) fn check() -> Outcome {
    maths()?;
    links_alone()?;
    let installed = output(&mut command("rustup", ["target", "list", "--installed"]));
    if installed.is_ok_and(|list| list.lines().any(|target| target == DEVICE)) {
        sh(&mut cargo(["build", "--package", "onescan-core", "--target", DEVICE]))
    } else {
        println!("{DEVICE} is not installed, so the core is not compiled for it");
        Ok(())
    }
}

/// Bits depend on who computes sines. Cargo gives a crate that several packages share the
/// features of all of them, so with the host's crates in the build `num-traits` has `std` and
/// with it the platform's maths. That reaches the core by two doors only, and both are shut:
/// nalgebra computes through simba, whose `libm_force` overrules `std`; and the core itself
/// calls `libm` in math.rs, nowhere else, and never through `num-traits`.
fn maths() -> Outcome {
    let alone = features(&["--package", "onescan-core"])?;
    if let Some(line) = alone.lines().find(|line| has(line, "std") || has(line, "alloc")) {
        return Err(format!(
            "the core alone builds a crate with std or alloc: {line}\n\
             (cargo tree -p onescan-core -e features,normal,no-proc-macro -i CRATE says who asks)"
        ));
    }
    for (who, lines) in
        [("the core alone", &alone), ("the workspace", &features(&["--workspace"])?)]
    {
        let simba = lines.lines().find(|line| line.starts_with("simba "));
        if !simba.is_some_and(|line| has(line, "libm_force")) {
            return Err(format!("{who} builds nalgebra without libm-force: {simba:?}"));
        }
        if lines.lines().any(|line| line.starts_with("onescan-core ") && has(line, "micromath")) {
            return Err(format!("{who} builds the core with the feature micromath: other bits"));
        }
    }
    only_in_math_rs(&root().join("core/src"))
}

/// Crates with their features, `name version|feature,feature`.
fn features(packages: &[&str]) -> Result<String, String> {
    let tree = ["tree", "--edges", "normal,no-proc-macro", "--prefix", "none", "--format"];
    output(cargo(tree).arg("{p}|{f}").args(packages))
}

fn has(line: &str, feature: &str) -> bool {
    line.split_once('|')
        .is_some_and(|(_, features)| features.split([',', ' ']).any(|found| found == feature))
}

fn only_in_math_rs(directory: &Path) -> Outcome {
    let fault = |e: std::io::Error| format!("{}: {e}", directory.display());
    for entry in fs::read_dir(directory).map_err(fault)? {
        let path = entry.map_err(fault)?.path();
        if path.is_dir() {
            only_in_math_rs(&path)?;
        } else if !path.ends_with("math.rs") {
            let text = fs::read_to_string(&path).map_err(fault)?;
            for door in
                ["libm::", "micromath::", "num_traits", "ComplexField", "RealField", ".mul_add("]
            {
                if let Some(line) = text.lines().position(|line| line.contains(door)) {
                    let (path, line) = (path.display(), line + 1);
                    return Err(format!("{path}:{line}: {door} belongs into math.rs alone"));
                }
            }
        }
    }
    Ok(())
}

/// Compiles [`PROGRAM`] to a static library, with the workspace's own lock file.
fn links_alone() -> Outcome {
    let place = target().join("no-std");
    let core = root().join("core");
    let manifest = format!(
        "[package]\nname = \"no-std\"\nedition = \"2024\"\n\
         [lib]\npath = \"lib.rs\"\ncrate-type = [\"staticlib\"]\n\
         [dependencies]\nonescan-core = {{ path = \"{}\" }}\n\
         [profile.dev]\npanic = \"abort\"\n[workspace]\n",
        core.display()
    );
    fs::create_dir_all(&place)
        .and_then(|()| fs::write(place.join("Cargo.toml"), manifest))
        .and_then(|()| fs::write(place.join("lib.rs"), PROGRAM))
        .and_then(|()| fs::copy(root().join("Cargo.lock"), place.join("Cargo.lock")))
        .map_err(|e| format!("{}: {e}", place.display()))?;
    sh(cargo(["build", "--quiet", "--target-dir"]).arg(place.join("target")).current_dir(&place))
}
