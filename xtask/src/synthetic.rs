//! `cargo xtask synthetic`: how well fits recover faces of known truth.

use crate::Outcome;
use crate::shell::{cargo, root, run as sh, target};
use std::fs;
use std::path::Path;

/// The schedules that have a table, as `onescan fit` names them, and their tests.
const SCHEDULES: [(&str, &str); 2] = [("mode", "a_search"), ("paper", "the_papers_chain")];

/// The command: the test writes its table where this says, this puts it into the page, below the
/// line that names the schedule.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    let schedule = match arguments {
        [] => SCHEDULES[0].0,
        [option, schedule] if option == "--schedule" => schedule.as_str(),
        _ => return Err("expected --schedule mode or --schedule paper".into()),
    };
    let Some((_, name)) = SCHEDULES.iter().find(|(known, _)| *known == schedule) else {
        return Err(format!("no table of --schedule {schedule}; expected mode or paper"));
    };
    let page = root().join("docs/synthetic.md");
    let table = target().join("synthetic-table.md");
    fs::create_dir_all(target()).map_err(|e| e.to_string())?;
    let test = ["test", "--release", "--package", "onescan-tests", "--test", "synthetic", name];
    sh(cargo(test).env("ONESCAN_TABLE", &table))?;
    let read =
        |path: &Path| fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()));
    let (old, table) = (read(&page)?, read(&table)?);
    let heading = format!("## `--schedule {schedule}`");
    let at = old
        .find(&heading)
        .ok_or_else(|| format!("{}: no line {heading}, where the table goes", page.display()))?;
    let (above, below) = old.split_at(at);
    let row = |line: &&str| line.starts_with('|');
    let before = below.lines().take_while(|line| !row(line));
    let after = below.lines().skip_while(|line| !row(line)).skip_while(row);
    let lines: Vec<_> = before.chain(table.trim_end().lines()).chain(after).collect();
    fs::write(&page, above.to_owned() + &lines.join("\n") + "\n").map_err(|e| e.to_string())?;
    println!("wrote the table of {}", page.display());
    Ok(())
}
