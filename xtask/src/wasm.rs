//! The case of tests/case in WebAssembly, scalar and SIMD, run by Node: the golden fingerprint.

use crate::Outcome;
use crate::shell::{command, output, root, target};
use crate::targets::{BARE, Cross, install};
use std::fs;

const TARGET: &str = "wasm32-unknown-unknown";

/// Builds the C library as a module, fits, compares.
pub(crate) fn check() -> Outcome {
    if output(&mut command("node", ["--version"])).is_err() {
        install(&["nodejs"])?;
    }
    let golden = root().join("fixtures/golden/device.txt");
    let golden = fs::read_to_string(&golden).map_err(|e| format!("{}: {e}", golden.display()))?;
    let expected = golden.lines().last().unwrap_or_default();
    for (name, flags) in [("scalar", ""), ("simd128", "-C target-feature=+simd128")] {
        // Shared with the native library, whose build script writes the same header.
        let place = target().join("c");
        let module = Cross {
            target: TARGET,
            crate_: &root().join("c"),
            // Of the library only: a crate type is no concern of its dependencies.
            arguments: &["rustc", "--release", "--crate-type", "cdylib"],
            std: BARE,
            flags,
            debian_flags: "-C linker=wasm-ld-19",
        };
        module.build(&place)?;
        let library = place.join(TARGET).join("release/onescan.wasm");
        let mut node = command("node", ["tests/wasm/case.mjs"]);
        let found = output(node.arg(library).arg(root().join("fixtures/device")))?;
        println!("wasm32 {name:8} {}", found.trim_end());
        if found.trim_end() != expected {
            return Err(format!("WebAssembly computes {found}every other target {expected}"));
        }
    }
    Ok(())
}
