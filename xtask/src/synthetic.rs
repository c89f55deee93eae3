//! `cargo xtask synthetic`: how well fits recover faces of known truth.

use crate::shell::{cargo, root, run as sh, target};
use crate::{Outcome, no_arguments};
use std::fs;
use std::path::Path;

/// The command: the test writes its table where this says.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    let page = root().join("docs/synthetic.md");
    let table = target().join("synthetic-table.md");
    fs::create_dir_all(target()).map_err(|e| e.to_string())?;
    let test = ["test", "--release", "--package", "onescan-tests", "--test", "synthetic"];
    sh(cargo(test).env("ONESCAN_TABLE", &table))?;
    let read =
        |path: &Path| fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()));
    let (old, table) = (read(&page)?, read(&table)?);
    let row = |line: &&str| line.starts_with('|');
    let before = old.lines().take_while(|line| !row(line));
    let after = old.lines().skip_while(|line| !row(line)).skip_while(row);
    let lines: Vec<_> = before.chain(table.trim_end().lines()).chain(after).collect();
    fs::write(&page, lines.join("\n") + "\n").map_err(|e| e.to_string())?;
    println!("wrote the table of {}", page.display());
    Ok(())
}
