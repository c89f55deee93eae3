//! The licences of other people's crates that a program contains, as they ask to be handed on.

use crate::shell::{cargo, output};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// A line for each crate in `packages` as compiled for `target`, then every text of a licence, once.
pub(crate) fn of(packages: &[&str], target: &str) -> Result<String, String> {
    let mut tree = cargo(["tree", "--edges", "normal", "--target", target, "--prefix", "none"]);
    tree.args(["--format", "{p}: {l}"]);
    for package in packages {
        tree.args(["--package", package]);
    }
    // Ours have a path, and what was listed before a mark.
    let lines = output(&mut tree)?;
    let crates: BTreeSet<_> =
        lines.lines().filter(|line| !line.is_empty() && !line.contains(" (")).collect();
    let metadata = output(&mut cargo(["metadata", "--format-version", "1", "--quiet"]))?;
    let metadata: Value =
        serde_json::from_str(&metadata).map_err(|e| format!("cargo metadata: {e}"))?;
    let mut texts: BTreeMap<Vec<String>, (String, BTreeSet<&str>)> = BTreeMap::new();
    for package in metadata["packages"].as_array().into_iter().flatten() {
        let text = |key: &str| package[key].as_str().unwrap_or_default();
        let start = format!("{} v{}: ", text("name"), text("version"));
        if !crates.iter().any(|line| line.starts_with(&start)) {
            continue;
        }
        let manifest = Path::new(text("manifest_path"));
        for licence in licences(manifest.parent().unwrap_or(manifest))? {
            // Many differ in nothing but white space.
            let words = licence.split_whitespace().map(str::to_owned).collect();
            texts.entry(words).or_insert((licence, BTreeSet::new())).1.insert(text("name"));
        }
    }
    let list: Vec<&str> = crates.into_iter().collect();
    let mut notices = vec![list.join("\n")];
    for (text, names) in texts.into_values() {
        let names: Vec<&str> = names.into_iter().collect();
        notices.push(format!("{}\n{}\n\n{}", "-".repeat(72), names.join(", "), text.trim_end()));
    }
    Ok(notices.join("\n\n") + "\n")
}

/// The texts of licences and notices in a crate's directory. What a crate offers under the GPL as
/// well, it offers under another licence, which is taken.
fn licences(place: &Path) -> Result<Vec<String>, String> {
    let fault = |e: std::io::Error| format!("{}: {e}", place.display());
    let mut texts = Vec::new();
    for entry in fs::read_dir(place).map_err(fault)? {
        let path = entry.map_err(fault)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        let begins = ["LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "NOTICE", "UNLICENSE"];
        let is_one = begins.iter().any(|begin| name.starts_with(begin)) && !name.contains("GPL");
        if is_one && path.is_file() {
            texts.push(fs::read_to_string(&path).map_err(fault)?);
        }
    }
    Ok(texts)
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_crate_is_named_and_every_text_is_there_once() {
        let notices =
            super::of(&["onescan-wasm", "onescan-faces"], "wasm32-unknown-unknown").unwrap();
        assert!(!notices.starts_with(char::is_whitespace), "each tree ends with a blank line");
        assert!(notices.lines().any(|line| line.starts_with("nalgebra v")));
        assert!(!notices.contains("onescan"), "ours are no others'");
        let heads = notices.lines().filter(|line| line.split(", ").any(|name| name == "nalgebra"));
        assert_eq!(heads.count(), 1, "nalgebra has one licence");
    }
}
