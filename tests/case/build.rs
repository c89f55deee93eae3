//! Landmarks of the case from their file to a Rust array.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

fn main() {
    let fixture = Path::new(&env::var("CARGO_MANIFEST_DIR").expect("set by cargo"))
        .join("../../fixtures/device/photo.tlms");
    println!("cargo::rerun-if-changed={}", fixture.display());
    let text = fs::read_to_string(&fixture).expect("fixtures/device/photo.tlms");
    let mut entries = String::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, "1", x, y] = words[..] else { panic!("photo.tlms: {line}") };
        writeln!(entries, "({name:?}, [{x}_f32, {y}_f32]),").expect("memory takes text");
    }
    let out = Path::new(&env::var("OUT_DIR").expect("set by cargo")).join("landmarks.rs");
    fs::write(out, format!("&[\n{entries}]\n")).expect("OUT_DIR is there to be written to");
}
