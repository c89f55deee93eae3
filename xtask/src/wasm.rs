//! The golden cases in WebAssembly, scalar and SIMD, run by Node.

use crate::Outcome;
use crate::golden::{Case, FITS};
use crate::shell::{command, output, root, target};
use crate::targets::{BARE, Cross, install};
use std::path::{Path, PathBuf};

const TARGET: &str = "wasm32-unknown-unknown";
/// How it is compiled, and by which flags.
pub(crate) const KINDS: [(&str, &str); 2] =
    [("scalar", ""), ("simd128", "-C target-feature=+simd128")];

/// Builds the C library and the small case's stages as modules, computes, compares.
pub(crate) fn check() -> Outcome {
    if output(&mut command("node", ["--version"])).is_err() {
        install(&["nodejs"])?;
    }
    for (kind, flags) in KINDS {
        let name = format!("wasm32 {kind}");
        let stages = output(
            command("node", ["tests/wasm/stages.mjs"])
                .arg(self::stages(kind, flags)?)
                .arg(Case::Small.golden()),
        );
        Case::Small.compare(&name, &FITS, &stages.map_err(|e| format!("{name}: {e}"))?)?;
        let library = build(
            &root().join("c"),
            // Of the library only: a crate type is no concern of its dependencies.
            &["rustc", "--release", "--crate-type", "cdylib"],
            BARE,
            flags,
            // Shared with the native library, whose build script writes the same header.
            &target().join("c"),
            "onescan",
        )?;
        for case in Case::ALL {
            let mut node = command("node", ["tests/wasm/case.mjs"]);
            node.arg(&library).arg(case.inputs()?);
            if case == Case::Small {
                node.arg("small");
            }
            case.compare(&format!("{name} C"), &FITS, &output(&mut node)?)?;
        }
    }
    Ok(())
}

/// The module that computes the small case and its stages.
pub(crate) fn stages(kind: &str, flags: &str) -> Result<PathBuf, String> {
    build(
        &root().join("tests/wasm"),
        &["build", "--release"],
        "std,panic_abort",
        flags,
        &target().join("wasm").join(kind),
        "onescan_wasm_case",
    )
}

fn build(
    crate_: &Path,
    arguments: &[&str],
    std: &str,
    flags: &str,
    place: &Path,
    name: &str,
) -> Result<PathBuf, String> {
    let debian_flags = "-C linker=wasm-ld-19";
    Cross { target: TARGET, crate_, arguments, std, flags, debian_flags }.build(place)?;
    Ok(place.join(TARGET).join(format!("release/{name}.wasm")))
}
