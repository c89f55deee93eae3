//! `cargo xtask fuzz`: everything that reads a file, fed with damaged ones.

use crate::Outcome;
use crate::shell::{cargo, command, output, root, run as sh, target};
use std::fs;

/// The command: `[SECONDS=60] [TARGET…]`, all targets if none is named.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    let (seconds, wanted) = match arguments {
        [first, rest @ ..] if first.parse::<u32>().is_ok() => (first.as_str(), rest),
        all => ("60", all),
    };
    output(&mut command("rustup", ["run", "nightly", "rustc", "--version"])).map_err(|_| {
        "cargo-fuzz needs the nightly compiler: rustup toolchain install nightly".to_string()
    })?;
    // The library of the fuzzer is C++.
    output(&mut command("c++", ["--version"]))
        .map_err(|_| "libfuzzer needs a C++ compiler: apt-get install g++".to_string())?;
    let tools = target().join("tools");
    let cargo_fuzz = tools.join("bin/cargo-fuzz");
    if !cargo_fuzz.exists() {
        sh(cargo(["install", "--quiet", "--locked", "cargo-fuzz", "--root"]).arg(&tools))?;
    }
    let fuzz = root().join("fuzz");
    // The versions that the workspace is tested with.
    fs::copy(root().join("Cargo.lock"), fuzz.join("Cargo.lock"))
        .map_err(|e| format!("{}: {e}", fuzz.display()))?;
    let mut targets: Vec<String> = fs::read_dir(fuzz.join("fuzz_targets"))
        .map_err(|e| format!("{}: {e}", fuzz.display()))?
        .filter_map(|entry| Some(entry.ok()?.path().file_stem()?.to_string_lossy().into_owned()))
        .collect();
    targets.sort();
    if let Some(unknown) = wanted.iter().find(|name| !targets.contains(name)) {
        return Err(format!("no target {unknown}; there are {}", targets.join(", ")));
    }
    targets.retain(|name| wanted.is_empty() || wanted.contains(name));
    for name in targets {
        println!("\n=== {name}");
        // Found inputs go to the first directory, which is nobody's but this machine's.
        let corpus = fuzz.join("corpus").join(&name);
        fs::create_dir_all(&corpus).map_err(|e| format!("{}: {e}", corpus.display()))?;
        let mut fuzzer = command("rustup", ["run", "nightly"]);
        // Not the stable cargo that runs this.
        fuzzer.env_remove("CARGO");
        fuzzer.arg(&cargo_fuzz).args(["run", "--target-dir"]).arg(target().join("fuzz"));
        fuzzer.arg(&name).arg(&corpus);
        let seeds = fuzz.join("seeds").join(&name);
        if seeds.exists() {
            fuzzer.arg(seeds);
        }
        fuzzer.args(["--", &format!("-max_total_time={seconds}"), "-timeout=10"]);
        fuzzer.args(["-rss_limit_mb=4096", "-print_final_stats=1"]);
        sh(&mut fuzzer)?;
    }
    Ok(())
}
