//! `cargo xtask test`: everything that must hold, in order, to the first failure.

use crate::hdf5;
use crate::shell::{cargo, run as sh, target};
use crate::{Outcome, c, deny, determinism, device, no_arguments, no_std, package, page, scale};
use std::fs;
use std::process::exit;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread::spawn;
use std::time::{Duration, Instant};

/// What a check that hangs is stopped after: several times what the longest takes.
const LIMIT: Duration = Duration::from_secs(40 * 60);

struct Check {
    name: &'static str,
    run: fn() -> Outcome,
}

/// Cheap and telling ones first.
const CHECKS: &[Check] = &[
    Check { name: "format", run: || sh(&mut cargo(["fmt", "--all", "--check"])) },
    Check { name: "lints", run: lints },
    Check { name: "licences", run: deny::check },
    Check { name: "packages", run: package::check },
    Check { name: "docs", run: docs },
    Check { name: "no std", run: no_std::check },
    Check { name: "tests", run: || sh(&mut cargo(["test", "--workspace", "--release"])) },
    Check { name: "determinism", run: determinism::check },
    Check { name: "HDF5", run: hdf5::check },
    Check { name: "scale", run: scale::check },
    Check { name: "C", run: c::check },
    Check { name: "device", run: device::check },
    Check { name: "browser", run: page::check },
    Check { name: "demo", run: demo },
];

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    let start = Instant::now();
    let mut times = Vec::new();
    for Check { name, run } in CHECKS {
        println!("\n=== {name}");
        let start = Instant::now();
        let (done, ended) = channel::<()>();
        spawn(move || {
            if ended.recv_timeout(LIMIT) == Err(RecvTimeoutError::Timeout) {
                eprintln!("xtask test: {name} has not ended after {} s", LIMIT.as_secs());
                exit(1);
            }
        });
        let outcome = run();
        drop(done);
        times.push((name, start.elapsed()));
        if let Err(message) = outcome {
            show(&times);
            return Err(format!("{name} failed\n{message}"));
        }
    }
    show(&times);
    println!("all good in {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

fn show(times: &[(&&str, Duration)]) {
    println!();
    for (name, time) in times {
        println!("{name:12} {:6.1} s", time.as_secs_f64());
    }
}

fn lints() -> Outcome {
    // In the profile of the tests: macros and build scripts are compiled once.
    let clippy = ["clippy", "--workspace", "--all-targets", "--release", "--", "-D", "warnings"];
    sh(&mut cargo(clippy))
}

fn docs() -> Outcome {
    sh(cargo(["doc", "--workspace", "--no-deps", "--release"]).env("RUSTDOCFLAGS", "-D warnings"))
}

/// What a newcomer runs first does what the README says.
fn demo() -> Outcome {
    let out = target().join("demo");
    let _ = fs::remove_dir_all(&out);
    let run = cargo(["run", "--release", "--", "demo", "--out"]).arg(&out).status();
    if !run.map_err(|e| e.to_string())?.success() {
        return Err("the demo failed".into());
    }
    for file in ["report.html", "summary.json"] {
        let length = fs::metadata(out.join(file)).map_or(0, |file| file.len());
        if length == 0 {
            return Err(format!("the demo wrote no {file} into {}", out.display()));
        }
    }
    Ok(())
}
