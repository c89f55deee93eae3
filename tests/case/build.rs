//! Landmarks of the case from their files to Rust arrays.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

fn main() {
    let fixtures = Path::new(&env::var("CARGO_MANIFEST_DIR").expect("set by cargo"))
        .join("../../fixtures/device");
    for photo in ["photo", "half"] {
        let fixture = fixtures.join(photo).with_extension("tlms");
        println!("cargo::rerun-if-changed={}", fixture.display());
        let text = fs::read_to_string(&fixture).expect("landmarks in fixtures/device");
        let mut entries = String::new();
        for line in text.lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let [name, "1", x, y] = words[..] else { panic!("{photo}.tlms: {line}") };
            writeln!(entries, "({name:?}, [{x}_f32, {y}_f32]),").expect("memory takes text");
        }
        let out = Path::new(&env::var("OUT_DIR").expect("set by cargo")).join(photo);
        fs::write(out.with_extension("rs"), format!("&[\n{entries}]\n"))
            .expect("OUT_DIR is there to be written to");
    }
}
