//! Writes include/onescan.h, if the library's face has changed.

use std::env;
use std::path::Path;

fn main() {
    let place = env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
    println!("cargo::rerun-if-changed=src/lib.rs");
    println!("cargo::rerun-if-changed=cbindgen.toml");
    cbindgen::generate(&place)
        .expect("a header for src/lib.rs")
        .write_to_file(Path::new(&place).join("include/onescan.h"));
}
