//! A test: modules of host and core use each other in one direction only.

use crate::shell::root;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

#[test]
fn no_room_uses_one_that_uses_it() {
    for part in ["host/src", "core/src"].map(|part| root().join(part)) {
        assert_eq!(circle(&part, "crate::"), BTreeMap::new());
        for room in entries(&part).filter(|path| path.join("mod.rs").is_file()) {
            let prefix = format!("crate::{}::", room.file_name().unwrap().display());
            assert_eq!(circle(&room, &prefix), BTreeMap::new());
        }
    }
}

/// Modules of a folder that use each other in a circle, and those that use these; `prefix` is
/// what code elsewhere calls the folder.
fn circle(folder: &Path, prefix: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut uses = BTreeMap::<String, BTreeSet<String>>::new();
    for path in entries(folder) {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let beside = if path.is_file() { named(&path, "super::") } else { Vec::new() };
        let used = named(&path, prefix).into_iter().chain(beside);
        uses.entry(name.clone()).or_default().extend(used.filter(|other| *other != name));
    }
    for _ in 0..uses.len() {
        let left: BTreeSet<String> = uses.keys().cloned().collect();
        uses.retain(|_, used| {
            used.retain(|other| left.contains(other));
            !used.is_empty()
        });
    }
    uses
}

/// What the code of a file, or of all files of a folder, names after a prefix; tests do not count.
fn named(path: &Path, prefix: &str) -> Vec<String> {
    if path.is_dir() {
        return entries(path).flat_map(|path| named(&path, prefix)).collect();
    }
    let text = fs::read_to_string(path).unwrap();
    let code = text.split("#[cfg(test)]").next().unwrap_or_default().lines();
    let code: String = code.filter(|line| !line.trim_start().starts_with("//")).collect();
    // Of a list all words, which may be too many; else the first.
    let words = |after: &str| {
        let most = if after.starts_with('{') { usize::MAX } else { 1 };
        let list = &after[..after.find(';').unwrap_or(after.len())];
        let words = list.split(|c: char| !c.is_alphanumeric() && c != '_');
        words.filter(|word| !word.is_empty()).take(most).map(String::from).collect::<Vec<_>>()
    };
    code.split(prefix).skip(1).flat_map(words).collect()
}

fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.filter(|path| !path.ends_with("tests.rs"))
}
