//! A test: what the project's texts link to is there, and what its symbolic links lead to.

use crate::shell::root;
use std::path::Path;
use std::process::Command;
use std::{fs, str};

#[test]
fn every_link_leads_somewhere() {
    let listed = Command::new("git").args(["ls-files", "-z"]).current_dir(root()).output().unwrap();
    let names = str::from_utf8(&listed.stdout).unwrap().split_terminator('\0');
    let mut broken = Vec::new();
    for name in names {
        let path = root().join(name);
        // A file that is about to be deleted is listed still.
        let Ok(known) = path.symlink_metadata() else { continue };
        if known.is_symlink() && !path.exists() {
            broken.push(format!("{name} leads nowhere"));
        }
        if known.is_file() && path.extension().is_some_and(|extension| extension == "md") {
            let text = fs::read_to_string(&path).unwrap();
            let folder = path.parent().unwrap();
            broken.extend(missing(folder, &text).map(|to| format!("{name}: {to}")));
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// The relative links of a text of Markdown, in a folder, that lead nowhere.
fn missing<'a>(folder: &'a Path, text: &'a str) -> impl Iterator<Item = &'a str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let files = targets.filter_map(|to| to.split('#').next()).filter(|to| !to.is_empty());
    files.filter(move |to| !to.contains(':') && !folder.join(to).exists())
}

#[test]
fn a_broken_link_is_found() {
    let text = "[a](README.md#x) [b](nowhere.md) ![c](https://example.org/x.png) [d](#here)";
    assert_eq!(missing(&root(), text).collect::<Vec<_>>(), ["nowhere.md"]);
}
