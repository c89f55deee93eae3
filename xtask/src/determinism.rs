//! `cargo xtask determinism`: builds of every kind give the same fits, to the last bit.
//!
//! The tests fit the golden cases by the command: a release build that chooses vectors at run time.
//! What is left are other ways to compile the core, by programs that are little else and so quick
//! to build; and other processors, which compute the small case emulated.

use crate::c::{Library, Machine};
use crate::golden::{Case, FITS};
use crate::shell::{cargo, output, target};
use crate::{Outcome, no_arguments, wasm};

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds, fits, compares.
pub(crate) fn check() -> Outcome {
    let small = ["run", "--quiet", "--package", "onescan-case", "--example", "fingerprint"];
    Case::Small.compare("debug", &FITS, &output(&mut cargo(small))?)?;
    let native = Library::build("-C target-cpu=native", target().join("native"))?;
    Case::ALL.into_iter().try_for_each(|case| native.compare("C native", case))?;
    for machine in &MACHINES {
        Library::cross(machine)?.compare(machine.triple, Case::Small)?;
    }
    wasm::check()
}

/// Of 32 and of 64 bits, with vectors that the compiler may use unasked and without.
const MACHINES: [Machine; 3] = [
    Machine {
        target: "aarch64-unknown-linux-gnu",
        triple: "aarch64-linux-gnu",
        libc: "libc6-dev-arm64-cross",
        emulator: "qemu-aarch64",
    },
    Machine {
        target: "i686-unknown-linux-gnu",
        triple: "i686-linux-gnu",
        libc: "libc6-dev-i386-cross",
        emulator: "qemu-i386",
    },
    Machine {
        target: "riscv64gc-unknown-linux-gnu",
        triple: "riscv64-linux-gnu",
        libc: "libc6-dev-riscv64-cross",
        emulator: "qemu-riscv64",
    },
];
