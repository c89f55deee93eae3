//! `cargo xtask fuzz`: everything that reads a file, fed with damaged ones.
//!
//! libFuzzer needs the code to count where it comes along, which LLVM adds by options that the stable
//! compiler takes; cargo-fuzz and a nightly compiler would add sanitizers for unsafe code, of which there is
//! next to none.

use crate::Outcome;
use crate::shell::{cargo, command, output, root, run as sh, target};
use std::fs;

/// As cargo-fuzz has it, without a sanitizer.
const FLAGS: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares --cfg fuzzing -Cdebug-assertions -Coverflow-checks \
    -Ccodegen-units=1";

/// The command: `[SECONDS=60] [TARGET…]`, all targets if none is named.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    let (seconds, wanted) = match arguments {
        [first, rest @ ..] if first.parse::<u32>().is_ok() => (first.as_str(), rest),
        all => ("60", all),
    };
    // The library of the fuzzer is C++.
    output(&mut command("c++", ["--version"]))
        .map_err(|_| "libfuzzer needs a C++ compiler: apt-get install g++".to_string())?;
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
    // Named, so that what runs within the compiler does not count.
    let host = output(&mut command("rustc", ["--print", "host-tuple"]))?;
    let (host, built) = (host.trim(), target().join("fuzz"));
    let mut build = cargo(["build", "--release", "--target", host, "--manifest-path"]);
    build.arg(fuzz.join("Cargo.toml")).arg("--target-dir").arg(&built).env("RUSTFLAGS", FLAGS);
    for name in &targets {
        build.args(["--bin", name]);
    }
    sh(&mut build)?;
    for name in targets {
        println!("\n=== {name}");
        // Found inputs go to the first directory, which is nobody's but this machine's.
        let [corpus, found] = ["corpus", "artifacts"].map(|place| fuzz.join(place).join(&name));
        for place in [&corpus, &found] {
            fs::create_dir_all(place).map_err(|e| format!("{}: {e}", place.display()))?;
        }
        let program = built.join(host).join("release").join(&name);
        let mut fuzzer = command(program, [&corpus]);
        let seeds = fuzz.join("seeds").join(&name);
        if seeds.exists() {
            fuzzer.arg(seeds);
        }
        fuzzer.args([&format!("-max_total_time={seconds}"), "-timeout=10", "-rss_limit_mb=2048"]);
        fuzzer.args(["-malloc_limit_mb=1500", "-print_final_stats=1"]);
        fuzzer.arg(format!("-artifact_prefix={}/", found.display()));
        sh(&mut fuzzer)?;
    }
    Ok(())
}
