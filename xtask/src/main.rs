//! Developer commands: `cargo xtask help`.

mod bench;
mod c;
mod calibration;
mod deny;
mod determinism;
mod device;
mod fuzz;
mod golden;
mod hdf5;
#[cfg(test)]
mod links;
mod no_std;
mod notices;
mod package;
mod page;
#[cfg(test)]
mod rooms;
mod rough;
mod scale;
mod shell;
mod synthetic;
mod targets;
mod test;
mod wasm;

use std::process::ExitCode;

/// What a command comes to; an error is what a person reads last.
type Outcome = Result<(), String>;

struct Command {
    name: &'static str,
    usage: &'static str,
    about: &'static str,
    run: fn(&[String]) -> Outcome,
}

const COMMANDS: &[Command] = &[
    Command {
        name: "test",
        usage: "test",
        about: "everything that must hold, in order, to the first failure; what CI runs",
        run: test::run,
    },
    Command {
        name: "no-std",
        usage: "no-std",
        about: "the core needs neither std nor a heap, and computes with its own maths",
        run: no_std::run,
    },
    Command {
        name: "package",
        usage: "package",
        about: "what crates.io would get: complete, and compiles by itself",
        run: package::run,
    },
    Command {
        name: "deny",
        usage: "deny",
        about: "licences, bans and sources of all crates (deny.toml)",
        run: deny::run,
    },
    Command {
        name: "msrv",
        usage: "msrv",
        about: "compiles what is published by the oldest compiler it promises to need",
        run: package::oldest,
    },
    Command {
        name: "determinism",
        usage: "determinism",
        about: "the golden fits by debug, native, WebAssembly and emulated builds: equal fingerprints",
        run: determinism::run,
    },
    Command {
        name: "c",
        usage: "c",
        about: "the C library and its header, and C programs that fit to the golden fingerprint",
        run: c::run,
    },
    Command {
        name: "hdf5",
        usage: "hdf5",
        about: "models for other programs, looked at by HDF5's own library (Python's h5py)",
        run: hdf5::run,
    },
    Command {
        name: "scale",
        usage: "scale",
        about: "an experiment's jobs by GNU parallel, Dask and a SLURM array: the same bytes",
        run: scale::run,
    },
    Command {
        name: "device",
        usage: "device",
        about: "fits on emulated Cortex-M7 and M3: golden bits, within 256 KB of RAM and 512 of flash",
        run: device::run,
    },
    Command {
        name: "wasm",
        usage: "wasm",
        about: "the web page and its npm package, into wasm/dist",
        run: page::run,
    },
    Command {
        name: "serve",
        usage: "serve [PORT=8080]",
        about: "the same, then serves it on this machine",
        run: page::serve,
    },
    Command {
        name: "browser",
        usage: "browser",
        about: "tries the page and the package in Chromium and in Node",
        run: page::test,
    },
    Command {
        name: "golden",
        usage: "golden [--model | --device]",
        about: "makes fixtures/golden anew; --model its model too, --device fixtures/device",
        run: golden::run,
    },
    Command {
        name: "synthetic",
        usage: "synthetic [--schedule NAME]",
        about: "fits faces of known truth and rewrites the table in docs/synthetic.md",
        run: synthetic::run,
    },
    Command {
        name: "rough",
        usage: "rough [DIR]",
        about: "fits rough pictures of the sixty people: how near the truth, how well told apart",
        run: rough::run,
    },
    Command {
        name: "calibration",
        usage: "calibration [--faces N] [--patch N] [DIR]",
        about: "samples posteriors of known truth: how often their intervals hold it",
        run: calibration::run,
    },
    Command {
        name: "bench",
        usage: "bench",
        about: "criterion's benchmarks of each stage, then onescan bench",
        run: bench::run,
    },
    Command {
        name: "fuzz",
        usage: "fuzz [SECONDS=60] [TARGET…]",
        about: "runs the fuzz targets, each so long",
        run: fuzz::run,
    },
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let name = arguments.first().map_or("help", String::as_str);
    if ["help", "--help", "-h"].contains(&name) {
        for Command { usage, about, .. } in COMMANDS {
            println!("cargo xtask {usage:28} {about}");
        }
        return ExitCode::SUCCESS;
    }
    let Some(command) = COMMANDS.iter().find(|command| command.name == name) else {
        eprintln!("xtask: no command {name}; cargo xtask help lists them");
        return ExitCode::from(2);
    };
    match (command.run)(&arguments[1..]) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("xtask {name}: {message}");
            ExitCode::FAILURE
        }
    }
}

/// Refuses arguments where a command takes none.
fn no_arguments(arguments: &[String]) -> Outcome {
    match arguments.first() {
        None => Ok(()),
        Some(argument) => Err(format!("unexpected argument {argument}")),
    }
}
