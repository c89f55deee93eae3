//! Compiling for other machines: by rustup's targets or, where rustup has one not and cannot
//! load it, by Debian's compiler with a standard library built on the spot.

use crate::Outcome;
use crate::shell::{cargo, command, output, run as sh};
use std::path::Path;

const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_LINKER: &str = "/usr/bin/ld.lld-19";

/// The standard library of a machine without an operating system.
pub(crate) const BARE: &str = "core,alloc,compiler_builtins";

/// A crate compiled for another machine.
pub(crate) struct Cross<'a> {
    /// The machine.
    pub(crate) target: &'a str,
    /// The crate's directory.
    pub(crate) crate_: &'a Path,
    /// Cargo's command and what goes with it.
    pub(crate) arguments: &'a [&'a str],
    /// What Debian's compiler must build of the standard library.
    pub(crate) std: &'a str,
    /// Flags of the compiler.
    pub(crate) flags: &'a str,
    /// Those that make Debian's compiler find a linker.
    pub(crate) debian_flags: &'a str,
}

impl Cross<'_> {
    /// Compiles into a target directory.
    pub(crate) fn build(&self, place: &Path) -> Outcome {
        let &Self { target, crate_, arguments, std, flags, debian_flags } = self;
        let options = ["--quiet", "--target", target, "--target-dir"];
        let has = || {
            let installed = output(&mut command("rustup", ["target", "list", "--installed"]));
            installed.is_ok_and(|list| list.lines().any(|line| line == target))
        };
        if has() || sh(&mut command("rustup", ["target", "add", target])).is_ok() && has() {
            let mut cargo = cargo(arguments);
            cargo.args(options).arg(place).current_dir(crate_).env("RUSTFLAGS", flags);
            return sh(&mut cargo);
        }
        println!("rustup cannot load {target}: trying Debian's compiler");
        if !Path::new(DEBIAN_RUSTC).exists() || !Path::new(DEBIAN_LINKER).exists() {
            install(&["rustc-web", "cargo-web", "rust-web-src", "lld-19"])?;
        }
        sh(command(DEBIAN_CARGO, arguments)
            .args(options)
            .arg(place)
            .args(["-Z", &format!("build-std={std}")])
            .current_dir(crate_)
            .env_remove("RUSTUP_TOOLCHAIN")
            .env("RUSTC", DEBIAN_RUSTC)
            .env("RUSTC_BOOTSTRAP", "1")
            .env("RUSTFLAGS", format!("{flags} {debian_flags}")))
    }
}

/// Installs Debian packages, or says what to install.
pub(crate) fn install(packages: &[&str]) -> Outcome {
    let names = packages.join(" ");
    sh(&mut command("apt-get", ["update"]))
        .and_then(|()| {
            let install = ["install", "--yes", "--no-install-recommends"];
            sh(command("apt-get", install).args(packages))
        })
        .map_err(|e| format!("{e}\ninstall by hand what Debian calls {names}"))
}
